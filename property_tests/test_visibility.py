"""Visibility in any scene: complete, none, and never more with an added occluder."""

import math

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from hulldown.annotate.visibility import measure_visibility
from hulldown.camera.cameras import Cameras
from hulldown.camera.intrinsics import Intrinsics
from hulldown.camera.shell import camera_pose
from hulldown.geometry.transforms import rigid_matrix
from hulldown.scene.camera_pencils import CameraPencils
from hulldown.scene.ground import Plane
from hulldown.scene.instances import InstancedScene
from hulldown.scene.posed_scene import Scene
from hulldown.scene.posed_vehicle import PosedVehicle
from hulldown.scene.rays import RayList
from hulldown.tests.annotate.test_visibility import HERE, TANK
from hulldown.tests.builders.shapes import box, random_rotations

CUBE = box((-0.5,) * 3, (0.5,) * 3)

lenses = st.builds(
    lambda fov: Intrinsics(320, 240, math.radians(fov)), st.one_of(st.floats(0.1, 179), st.sampled_from([0.1, 179.0]))
)
seeds = st.integers(0, 2**32 - 1)
elevations = st.one_of(st.floats(0.01, math.pi / 2), st.just(math.pi / 2))
turns = st.floats(-3, 3)


def cameras(seed: int, elevation: float, n: int = 6) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return camera_pose([0, 0, 1.0], rng.uniform(6, 200, n), rng.uniform(0, 6, n), elevation)


def boulders(rng: np.random.Generator, k: int) -> InstancedScene:
    """Cubes, turned, stretched, some mirrored, anywhere within 30 m except at the target."""
    around, height = rng.uniform(0, 2 * math.pi, k), rng.uniform(0, 10, k)
    at = np.stack([np.cos(around), np.sin(around), height], 1) * np.stack([rng.uniform(6, 30, k)] * 2 + [np.ones(k)], 1)
    poses = rigid_matrix(random_rotations(rng, k), at)
    poses[:, :3, :3] *= rng.uniform(0.2, 4, (k, 1, 3)) * rng.choice([-1, 1], (k, 1, 3))
    return InstancedScene([CUBE], np.zeros(k, dtype=int), poses)


@given(lenses, seeds, elevations, turns)
def test_on_an_open_plane_everything_in_the_frame_is_visible(
    lens: Intrinsics, seed: int, elevation: float, turn: float
) -> None:
    # The target is a millimeter above the plane, since rays at the seam may go either way.
    target, world = PosedVehicle(TANK, HERE, {"turret": turn}), Scene(Plane(-1e-3))
    seen = measure_visibility([target], Cameras(lens, cameras(seed, elevation)), world=world)
    assert (seen.fraction == 1).all()
    assert (seen.hits > 0).all()


@given(lenses, seeds, st.floats(0.01, 1.2), turns)
def test_behind_a_wall_nothing_is_visible(lens: Intrinsics, seed: int, elevation: float, turn: float) -> None:
    target, poses = [PosedVehicle(TANK, HERE, {"turret": turn})], cameras(seed, elevation, 2)
    # Across the line of sight, 1 m in front of the camera.
    walls = poses.copy()
    walls[:, :3, 3] += poses[:, :3, 2]
    walls[:, :3, :3] = poses[:, :3, :3] * np.array([1000.0, 1000.0, 0.01])
    for pose, wall in zip(poses, walls, strict=True):
        world = Scene(obstacles=InstancedScene([CUBE], [0], wall[None]))
        seen = measure_visibility(target, Cameras(lens, pose[None]), world=world)
        assert seen.fraction[0] == 0


@given(lenses, seeds, elevations, turns, st.integers(1, 12))
def test_an_added_occluder_never_raises_the_fraction(
    lens: Intrinsics, seed: int, elevation: float, turn: float, k: int
) -> None:
    scene = boulders(np.random.default_rng(seed), k)
    fewer = InstancedScene([CUBE], scene.instance_mesh[:-1], scene.world_from_instance[:-1])
    options = {"rays": 64}
    target, poses = [PosedVehicle(TANK, HERE, {"turret": turn})], Cameras(lens, cameras(seed, elevation))
    free = measure_visibility(target, poses, **options)
    some = measure_visibility(target, poses, world=Scene(obstacles=fewer), **options)
    more = measure_visibility(target, poses, world=Scene(obstacles=scene), **options)
    most = measure_visibility(target, poses, world=Scene(Plane(0.2), scene), **options)
    for above, below in [(free, some), (some, more), (more, most)]:
        np.testing.assert_array_equal(above.hits, below.hits)
        assert (below.fraction <= above.fraction).all()


@given(seeds, st.integers(0, 30), st.floats(0.1, 100))
def test_rays_of_cameras_are_hidden_like_single_rays(seed: int, k: int, fov: float) -> None:
    rng = np.random.default_rng(seed)
    n, r, half = 5, 40, math.tan(math.radians(fov / 2))
    world = Scene(Plane(-1.0), boulders(rng, k), [PosedVehicle(TANK, HERE, {"turret": 0.5})])
    poses = cameras(seed, 0.3, n)
    low = rng.uniform(-half, half, (n, 2))
    pencils = CameraPencils(poses, low, rng.uniform(0, 1, (n, 2)) * (half - low), rng.uniform(0, 1, (r, 2)))
    asked = rng.random((n, r)) < 0.8
    asked[2] = False
    which = np.flatnonzero(asked)
    rays = RayList(pencils.origins, pencils.directions)
    met = world.first_hits(rays).distance
    reach = np.where(asked.ravel(), met * rng.uniform(0.9, 1.1, n * r), -np.inf)
    rays = rays.take(which)
    for hiders in (Scene(Plane(-1.0)), Scene(Plane(-1.0), world.obstacles), world):
        passed = hiders.transmittance(pencils, max_distance=reach)[which]
        np.testing.assert_array_equal(passed == 0.0, hiders.occlusion(rays, max_distance=reach[which]))


@given(seeds, st.floats(0.05, 0.8))
def test_moving_the_world_changes_almost_nothing(seed: int, elevation: float) -> None:
    shift = rigid_matrix(np.eye(3), [5e5, 5.4e6, 50.0])
    scene = boulders(np.random.default_rng(seed), 8)
    moved = InstancedScene([CUBE], scene.instance_mesh, shift @ scene.world_from_instance)
    poses, lens = cameras(seed, elevation), Intrinsics(320, 240, 0.8)
    here = measure_visibility([PosedVehicle(TANK, HERE, {})], Cameras(lens, poses), world=Scene(Plane(0.1), scene))
    there = measure_visibility(
        [PosedVehicle(TANK, shift[None], {})], Cameras(lens, shift @ poses), world=Scene(Plane(50.1), moved)
    )
    np.testing.assert_allclose(here.hits, there.hits, atol=2)
    np.testing.assert_allclose(here.fraction, there.fraction, atol=0.04)
