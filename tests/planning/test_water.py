"""Nothing is placed below water of any shape, or where no light comes."""

from collections import Counter

import numpy as np
import pytest

from hulldown.annotate.visibility import measure_visibility
from hulldown.assets.plan_assets import Assets
from hulldown.camera.cameras import Cameras
from hulldown.camera.intrinsics import Intrinsics
from hulldown.camera.shell import camera_pose
from hulldown.geometry.meshes import Mesh
from hulldown.geometry.transforms import axis_rotation, rigid_matrix, rotation_z
from hulldown.placement.clearance import CameraRoom
from hulldown.placement.terrain import Terrain
from hulldown.plan.rejection import Rejection
from hulldown.planning.search.stage import make_stage
from hulldown.scene.instances import InstancedScene
from hulldown.scene.obstacles import Obstacles
from hulldown.scene.posed_scene import Scene
from hulldown.scene.posed_vehicle import PosedVehicle, VehicleCaster
from hulldown.tests.builders.planning_assets import bare, hills, plan, small_config, vehicle, with_water
from hulldown.tests.builders.shapes import box, sheet

TANK = vehicle("t72")
NOTHING = InstancedScene([], [], [])
VALLEYS = hills("valleys", size=160.0, trees=20)


def river():
    """Along x through the scenery, one meter lower at its end."""
    corners = np.array([[-80.0, -14, 0.5], [80, -14, -0.5], [80, 14, -0.5], [-80, 14, 0.5]])
    return Mesh(corners, np.array([[0, 1, 2], [0, 2, 3]]), "river")


LAKE = with_water(VALLEYS, sheet((-80, -80), (80, 80), 0.3))
# A plane modeled upright in the file's xz, and made level by its object.
UPRIGHT = Mesh(sheet((-80, 15), (80, 80)).vertices[:, [0, 2, 1]], np.array([[0, 2, 1], [0, 3, 2]]), "upright")
TURNED = rigid_matrix(axis_rotation([1.0, 0, 0], np.pi / 2), [0.0, 95.0, 1.0])
PONDS = [rigid_matrix(rotation_z(k), [16 * k - 64, -25, 1.5]) @ np.diag([6, 8, 1, 1]) for k in range(9)]
WATERS = {
    "lakes at two heights": with_water(LAKE, sheet((-80, -80), (0, 80), 1.0)),
    "river, plane turned by its object, ponds as instances, box of water": with_water(
        with_water(with_water(with_water(VALLEYS, river()), UPRIGHT, TURNED), sheet((-1, -1), (1, 1)), *PONDS),
        box((-80, -80, -9), (80, -40, 0.3)),
    ),
}


def config_for(scenery, *, images, **sections):
    return small_config(
        assets={"vehicles": [{"path": "t72.blend", "category": "tank"}], "sceneries": [{"path": f"{scenery.name}.blend"}]},
        budget={"images_per_class": images, "images_per_position": 1},
        **sections,
    )


def assets_of(scenery):
    return Assets({"t72": TANK}, {"t72": "tank"}, {scenery.name: scenery}, ("noon",))


def heights_of_water(scenery, xy):
    """The topmost water by plain arithmetic; nan outside it."""
    height = np.full(len(xy), np.nan)
    for i in np.flatnonzero(scenery.instance_is_water):
        mesh, pose = scenery.obstacle_meshes[scenery.instance_mesh[i]], scenery.world_from_instance[i]
        for a, b, c in (mesh.triangles @ pose[:3, :3].T + pose[:3, 3]).tolist():
            matrix = np.array([np.subtract(b, a)[:2], np.subtract(c, a)[:2]]).T
            if abs(np.linalg.det(matrix)) < 1e-9:
                continue
            s, t = np.linalg.solve(matrix, (xy - np.array(a)[:2]).T)
            inside = (s >= 0) & (t >= 0) & (s + t <= 1)
            z = a[2] + s * (b[2] - a[2]) + t * (c[2] - a[2])
            height[inside] = np.fmax(height[inside], z[inside])
    return height


@pytest.mark.parametrize("name", WATERS)
def test_no_vehicle_and_no_camera_is_below_water(name):
    scenery = WATERS[name]
    rows = list(plan(config_for(scenery, images=50), assets_of(scenery)))
    rejected = sum((Counter(row.rejected) for row in rows), Counter())
    assert rejected["water"] > 5
    # All corners of the footprint are sampled, so no vertex of the underside is below.
    feet = TANK.mesh.vertices[TANK.mesh.vertices[:, 2] < 1e-9]
    for row in rows:
        points = feet @ row.target.world_from_vehicle[:3, :3].T + row.target.world_from_vehicle[:3, 3]
        assert not (heights_of_water(scenery, points[:, :2]) - points[:, 2] > 1e-6).any()
        eye = row.world_from_camera[None, :3, 3]
        assert not (eye[:, 2] - heights_of_water(scenery, eye[:, :2]) < 0.5).any()


def test_a_fording_vehicle_is_in_water_up_to_its_depth():
    config = config_for(LAKE, images=60, placement={"fording_depth": 1.0})
    rows = list(plan(config, assets_of(LAKE)))
    depth = np.array([0.3 - row.target.world_from_vehicle[2, 3] for row in rows])
    assert depth.max() <= 1.1  # depth of the origin; a wheel may be higher
    assert (depth > 0.3).sum() > 5


def test_a_camera_is_above_water_by_the_clearance_and_the_near_plane():
    room = CameraRoom(Terrain(-3.0), Obstacles(NOTHING), water=Terrain(sheet((-9, -9), (9, 9), 0.0)))
    places = np.array([[0, 0, 0.6], [0, 0, 0.4], [0, 0, -1.0], [20.0, 0, -1.0], [0, 0, 0.1]])
    wet, dry = Rejection.CAMERA_WATER, Rejection.NONE
    assert room.clearance_rejections(places, ground_clearance=0.5).tolist() == [dry, wet, wet, dry, wet]
    assert room.clearance_rejections(places).tolist() == [dry, dry, wet, dry, wet]


def test_water_hides_submerged_parts_like_an_opaque_surface():
    """One meter of a tank of 2.3 m is below the water of a ford: about half is hidden, seen from the side."""
    ford, lens = with_water(bare("ford"), sheet((-50, -50), (50, 50), 1.0)), Intrinsics(640, 480, 0.7)
    camera = Cameras(lens, camera_pose([0.0, 0.0, 1.0], 30.0, 0.0, 0.1)[None])
    for world, low, high in ((Scene.from_scenery(ford), 0.4, 0.8), (Scene(), 0.0, 0.0)):
        seen = measure_visibility([PosedVehicle(VehicleCaster(TANK), np.eye(4)[None], {})], camera, world=world, rays=900)
        assert low <= 1.0 - seen.fraction[0] <= high


def test_water_is_not_an_obstacle_with_clearance():
    shore = with_water(bare("shore"), sheet((0, -50), (50, 50), -0.01))
    (site,) = make_stage(config_for(shore, images=1), assets_of(shore)).sites
    assert site.obstacles.blocked_box_mask(np.full((1, 3), 6.0), np.eye(4)[None]).tolist() == [False]


def house(*, open_front=False, size=12.0):
    """A box without thickness around the origin; `open`: without its wall toward +x."""
    walls = box((-size / 2, -size / 2, -0.1), (size / 2, size / 2, size / 2))
    across = walls.triangles[..., 0].min(axis=1) == size / 2
    return Mesh(walls.vertices, walls.faces[~across] if open_front else walls.faces, "house")


def shaft():
    """Walls 60 m high around the origin, 3 m apart, open at the top."""
    walls = box((-1.5, -1.5, -0.1), (1.5, 1.5, 60.0))
    return Mesh(walls.vertices, walls.faces[walls.triangles[..., 2].min(axis=1) < 60.0], "shaft")


@pytest.mark.parametrize(
    ("mesh", "lit"),
    [
        pytest.param(shaft(), True, id="a shaft that the sky is straight above"),
        pytest.param(house(), False, id="a closed house"),
        pytest.param(house(open_front=True), True, id="a garage without its door"),
        pytest.param(sheet((-30, -30), (30, 30), 5.0), True, id="a roof on posts"),
        pytest.param(sheet((-250, -250), (250, 250), 6.0), False, id="a sheet over the whole scenery"),
        pytest.param(box((-99, -99, -300), (999, 999, 300)), True, id="a sky dome nearby on one side"),
        pytest.param(house(size=400.0), True, id="a sky dome"),
    ],
)
def test_a_vehicle_under_a_roof_is_lit_unless_it_is_enclosed(mesh, lit):
    room = Obstacles(InstancedScene([mesh], [0], [np.eye(4)]))
    assert room.skylit_mask(np.array([[0.0, 0.0, 2.5]])).tolist() == [lit]


@pytest.mark.parametrize(("ground", "lit"), [(400.0, False), (150.0, True)])
def test_a_hollow_hill_is_dark_inside_and_a_dome_around_the_ground_is_not(ground, lit):
    """Their roof and walls are 150 m from the vehicle."""
    extent = np.array([[-ground, -ground], [ground, ground]])
    hill = Obstacles(InstancedScene([house(size=300.0)], [0], [np.eye(4)]), extent=extent)
    assert hill.skylit_mask(np.array([[0.0, 0.0, 2.5]])).tolist() == [lit]


def test_a_house_of_many_objects_encloses():
    walls = house()
    parts = [Mesh(walls.vertices, walls.faces[2 * k : 2 * k + 2], "wall") for k in range(6)]
    room = Obstacles(InstancedScene(parts, list(range(6)), [np.eye(4)] * 6))
    assert room.skylit_mask(np.array([[0.0, 0.0, 2.5], [0.0, 0.0, 7.0]])).tolist() == [False, True]


def test_a_dome_around_everything_rejects_no_camera():
    """An unnamed sky dome enclosed every vehicle and every camera."""
    room = CameraRoom(Terrain(VALLEYS.ground), Obstacles(InstancedScene([house(size=900.0)], [0], [np.eye(4)])))
    assert room.clearance_rejections(np.array([[0.0, 0, 20.0]]), obstacle_clearance=1.0).tolist() == [Rejection.NONE]
