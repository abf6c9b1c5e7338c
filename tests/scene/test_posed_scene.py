"""The world query: first hits of rays among ground, obstacles, and vehicles, and occlusion."""

import numpy as np
import pytest
import trimesh

from hulldown.camera.cameras import NEAR_M, Cameras
from hulldown.camera.intrinsics import Intrinsics
from hulldown.geometry.meshes import Mesh
from hulldown.geometry.transforms import axis_rotation, rigid_matrix, rotation_z
from hulldown.scene.camera_pencils import PixelRays
from hulldown.scene.ground import Plane
from hulldown.scene.instances import InstancedScene
from hulldown.scene.posed_scene import Scene
from hulldown.scene.posed_vehicle import PosedVehicle
from hulldown.scene.ray_caster import RayCaster
from hulldown.scene.rays import RayList, SurfaceKind
from hulldown.tests.annotate.test_visibility import TANK
from hulldown.tests.builders.shapes import box, vertices_at

TILT = axis_rotation(np.array([0.6, 0.0, 0.8]), 0.7)
VEHICLES = [
    PosedVehicle(TANK, rigid_matrix(TILT, [0.0, 0.0, 1.0])[None], {"turret": 0.8, "gun": 0.2}),
    PosedVehicle(TANK, rigid_matrix(rotation_z(1.0), [9.0, 4.0, 0.5])[None], {}),
]
GROUND = Mesh(np.array([[-20.0, -20, 0], [20, -20, 1], [20, 20, 0], [-20, 20, 2]]), np.array([[0, 1, 2], [0, 3, 2]]))
STRETCHED = rigid_matrix(TILT, np.array([[-6.0, 3, 2], [4, -7, 1], [-5, -5, 1]]))
STRETCHED[:, :3, :3] *= np.array([[1.0, 2.0, 0.5], [-1.0, 1.0, 3.0], [1.0, 1.0, 0.0]])[:, None]  # mirrored, flat
WOOD = InstancedScene([box((-1, -1, -1), (1, 1, 1)), box((-0.5, -0.5, 0), (0.5, 0.5, 4))], [0, 1, 0], STRETCHED)
WORLD = Scene(RayCaster(GROUND), WOOD, VEHICLES)


def in_the_world() -> tuple[trimesh.Trimesh, np.ndarray]:
    """Everything as triangles of one trimesh, with kind, index, face, and part of each."""
    things = [(SurfaceKind.GROUND, 0, GROUND.vertices, GROUND.faces)]
    for i, (mesh, pose) in enumerate(zip((0, 1, 0), STRETCHED, strict=True)):
        vertices = trimesh.transform_points(WOOD.meshes[mesh].vertices, pose)
        things.append((SurfaceKind.OBSTACLE, i, vertices, WOOD.meshes[mesh].faces))
    for i, vehicle in enumerate(VEHICLES):
        vertices = trimesh.transform_points(vertices_at(TANK.shape, vehicle.articulation), vehicle.world_from_vehicle[0])
        things.append((SurfaceKind.VEHICLE, i, vertices, TANK.shape.mesh.faces))
    made = trimesh.util.concatenate([trimesh.Trimesh(v, f, process=False) for _, _, v, f in things])
    parts = TANK.shape.vertex_part[TANK.shape.mesh.faces].max(axis=1)
    named = [
        [kind, which, face, parts[face] if kind == SurfaceKind.VEHICLE else -1]
        for kind, which, _, faces in things
        for face in range(len(faces))
    ]
    return made, np.array(named)


def rays(n: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(0)
    origin = rng.uniform([-15, -15, 3], [15, 15, 9], (n, 3))
    along = rng.uniform([-9, -9, 0], [9, 9, 2], (n, 3)) - origin
    return origin, along / np.linalg.norm(along, axis=1, keepdims=True)


def nearest_triangle(origin: np.ndarray, along: np.ndarray, triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Distance and index of the first triangle along each ray, by float64 arithmetic on each; inf and -1 for a miss."""
    nearest, index = np.full(len(along), np.inf), np.full(len(along), -1)
    for k, (a, b, c) in enumerate(triangles):
        normal = np.cross(b - a, c - a)
        with np.errstate(divide="ignore", invalid="ignore"):
            t = ((a - origin) @ normal) / (along @ normal)
        at = origin + np.where(np.isfinite(t), t, 0)[:, None] * along
        inside = np.all([np.cross(q - p, at - p) @ normal >= 0 for p, q in ((a, b), (b, c), (c, a))], axis=0)
        closer = inside & (t > 0.0) & (t < nearest)
        nearest[closer], index[closer] = t[closer], k
    return nearest, index


def test_the_nearest_hit_is_that_of_all_triangles_in_the_world():
    everything, named = in_the_world()
    origin, along = rays(3000)
    distance, triangle = nearest_triangle(origin, along, np.array(everything.triangles))
    hits = WORLD.first_hits(RayList(origin, along))
    # Rays that graze an edge may differ between float32 frames.
    same = np.isclose(hits.distance, distance, atol=1e-4) | (np.isinf(distance) & ~hits.hit)
    assert same.mean() > 0.995
    met = np.flatnonzero(same & hits.hit)
    found = np.stack([hits.kind, hits.instance, hits.face, hits.part], axis=1)[met]
    assert set(found[:, 3]) == {-1, 0, 1, 2}
    assert set(found[:, 0]) == {SurfaceKind.GROUND, SurfaceKind.OBSTACLE, SurfaceKind.VEHICLE}
    assert {tuple(row) for row in found[:, :2]} == {(1, 0), (2, 0), (2, 1), (2, 2), (3, 0), (3, 1)}
    # The flat instance has two coincident faces.
    assert (found == named[triangle[met]])[(found[:, :2] != [2, 2]).any(axis=1)].all(axis=1).mean() > 0.995
    normal, oracle = hits.normal[met], np.array(everything.face_normals)[triangle[met]]
    assert (np.einsum("ij,ij->i", normal, along[met]) <= 0).all()
    assert (np.abs(np.einsum("ij,ij->i", normal, oracle)) > 1 - 1e-9).mean() > 0.995
    missed = ~hits.hit
    assert missed.any()
    assert (hits.kind[missed] == SurfaceKind.NOTHING).all()
    assert (hits.instance[missed] == -1).all()
    assert (hits.part[missed] == -1).all()
    assert np.isnan(hits.normal[missed]).all()


def test_occluded_rays_have_a_closer_hit():
    origin, along = rays(2000)
    hits = WORLD.first_hits(RayList(origin, along))
    reach = np.random.default_rng(1).uniform(1.0, 15.0, len(along))
    np.testing.assert_array_equal(WORLD.occlusion(RayList(origin, along), max_distance=reach), hits.distance <= reach)


@pytest.mark.parametrize(
    ("intrinsics", "position"),
    [
        (Intrinsics(200, 131, 1.2), [14.0, 9.0, 6.0]),
        (Intrinsics(150, 90, 1.0, (110.0, 95.0, 40.0, 50.0), (-0.2, 0.05, 0.01, -0.01, 0.0)), [-12.0, 8.0, 3.0]),
        (Intrinsics(130, 70, 2.9), [-6.0, 3.0, 2.4]),  # inside an instance, with a wide view
        (Intrinsics(1, 1, 0.1), [14.0, 9.0, 6.0]),
    ],
)
def test_a_camera_sees_the_hits_of_its_pixels_rays(intrinsics, position):
    toward = np.array([0.0, 0.0, 1.0]) - position
    across = np.cross(toward, [0.0, 0.0, 1.0])
    axes = np.stack([across, np.cross(toward, across), toward])
    camera = Cameras(intrinsics, rigid_matrix((axes / np.linalg.norm(axes, axis=1)[:, None]).T, np.array(position)))
    pixel = np.indices((intrinsics.height, intrinsics.width))[::-1].reshape(2, -1).T + 0.5
    along = camera.rays(pixel)[1]
    before = NEAR_M / (along @ camera.world_from_camera[:3, 2])
    rays = WORLD.first_hits(RayList(camera.position + before[:, None] * along, along))
    for threads in (1, 3):
        seen = WORLD.first_hits(PixelRays(camera), threads=threads)
        same = (seen.kind == rays.kind) & (seen.instance == rays.instance) & (seen.face == rays.face)
        assert same.mean() > 0.9995  # rays that graze an edge differ in their last digit
        assert np.allclose(seen.distance[same], (before + rays.distance)[same], rtol=1e-6)
        np.testing.assert_array_equal(seen.part[same], rays.part[same])
        np.testing.assert_array_equal(seen.normal[same], rays.normal[same])
    assert len(pixel) == 1 or set(seen.kind) >= {SurfaceKind.GROUND, SurfaceKind.OBSTACLE}


def test_the_plane_is_hit_from_both_sides_at_its_distance_and_not_along_it():
    rays = RayList([[0, 0, 3.0], [0, 0, 0.0], [0, 0, 3.0]], [[3, 0, -4.0], [0, 0, 1.0], [1, 0, 0.0]])
    hits = Scene(Plane(1.0)).first_hits(rays)
    assert hits.distance.tolist() == [2.5, 1.0, np.inf]
    assert hits.normal[:2].tolist() == [[0, 0, 1], [0, 0, -1]]
