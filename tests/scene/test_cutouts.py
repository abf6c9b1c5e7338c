from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hulldown.geometry.alpha import TEXEL_GRADES, AlphaMap, Cut, Cutouts, Extension, shrink_alpha_texels
from hulldown.geometry.meshes import Mesh, merge_meshes_with_sources
from hulldown.geometry.seen_surface import faces_with_area, seen_mesh_and_source_faces
from hulldown.geometry.transforms import rigid_matrix, rotation_z
from hulldown.scene.cutouts import make_ray_caster
from hulldown.scene.ground import Ground
from hulldown.scene.instances import InstancedScene
from hulldown.scene.obstacles import Obstacles
from hulldown.scene.posed_scene import Scene
from hulldown.scene.posed_vehicle import PosedVehicle, VehicleCaster
from hulldown.scene.rays import RayList
from hulldown.tests.builders.shapes import vehicle_of

SQUARE = np.array([[0.0, 0, 0], [1, 0, 0], [1, 0, 1], [0, 0, 1]])
HALVES = np.array([[0, 1, 2], [0, 2, 3]])
CORNERS = np.array([[0.0, 0], [1, 0], [1, 1], [0, 1]])
CHECKS = AlphaMap((np.indices((4, 4)).sum(axis=0) % 2 * 255).astype(np.uint8), smooth=False)
HARD = (TEXEL_GRADES > 0.4).astype(np.float32)
SOFT = AlphaMap(np.random.default_rng(0).integers(0, 256, (8, 8)).astype(np.uint8))


def card(alpha: AlphaMap = CHECKS, *, y: float = 0.0, uv: np.ndarray = CORNERS) -> Mesh:
    """A square of 1 m across y."""
    cut = Cutouts(np.arange(2), uv[HALVES].astype(np.float32), np.zeros(2, int), (alpha,))
    return Mesh(SQUARE + np.array([0.0, y, 0.0]), HALVES, "card", cut)


def through(n: int = 4000) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rays along y, and their positions on the cards."""
    at = np.random.default_rng(1).random((n, 2))
    return np.column_stack([at[:, 0], np.full(n, -3.0), at[:, 1]]), np.tile([0.0, 1.0, 0.0], (n, 1)), at


def on_checks(at: np.ndarray) -> np.ndarray:
    """Whether `CHECKS` is opaque there."""
    return np.floor(at * 4).sum(axis=1) % 2 == 1


WALL = Mesh(SQUARE + np.array([0.0, 1.0, 0.0]), HALVES)
NET = vehicle_of(merge_meshes_with_sources([card(y=-1.0), Mesh(SQUARE + np.array([2.0, 0.0, 0.0]), HALVES)])[0], name="net")
VEHICLE = PosedVehicle(VehicleCaster(NET), np.eye(4)[None], {})
# The flat one is cast as a separate mesh.
POSES = np.stack([np.eye(4), rigid_matrix(np.eye(3), [0.0, 2.0, 0.0]), np.diag([1.0, 1e-9, 1.0, 1.0])])
POSES[2, 1, 3] = -1.0


@pytest.mark.parametrize(
    ("thing", "distance"),
    [
        (Ground(make_ray_caster(card())), 3.0),
        (InstancedScene([card()], [0, 0, 0], POSES), 2.0),
        (VEHICLE, 2.0),
        (Scene(vehicles=[VEHICLE]), 2.0),
        (Scene(obstacles=InstancedScene([card()], [0], POSES[2:])), 2.0),
    ],
)
def test_rays_hit_opaque_texels_and_pass_clear_ones(thing, distance: float):
    origins, along, at = through()
    rays = RayList(origins, along)
    hits = thing.first_hits(rays)
    np.testing.assert_array_equal(hits.hit, on_checks(at))
    np.testing.assert_allclose(hits.distance[hits.hit], distance)
    np.testing.assert_array_equal(thing.occlusion(rays), on_checks(at))
    assert not thing.occlusion(rays, max_distance=distance - 0.1).any()


def test_faces_of_a_mesh_with_and_without_holes_keep_their_numbers():
    origins, along, at = through()
    hits = make_ray_caster(merge_meshes_with_sources([card(), WALL])[0]).cast(origins, along)
    np.testing.assert_array_equal(hits.face, np.where(on_checks(at), 0, 2) + (at[:, 1] > at[:, 0]))
    np.testing.assert_allclose(hits.distance, np.where(on_checks(at), 3.0, 4.0))
    hits = InstancedScene([card()], [0, 0, 0], POSES).first_hits(RayList(origins, along))
    np.testing.assert_array_equal(hits.instance, np.where(on_checks(at), 2, -1))


def test_transmittance_multiplies_and_half_occludes():
    origins, along, at = through()
    mesh, _ = merge_meshes_with_sources([card(SOFT), card(SOFT, y=1e-5), card(SOFT, y=0.5)])
    opacity = SOFT.opacity(at)
    caster = make_ray_caster(mesh)
    expected = (1.0 - opacity.astype(float)) ** 3
    found = caster.transmittance(origins, along)
    np.testing.assert_allclose(found, np.where(expected < 1e-3, 0.0, expected), atol=1e-3)
    near = np.abs(opacity - 0.5) < 1e-4
    np.testing.assert_array_equal(caster.occluded(origins, along)[~near], (opacity >= 0.5)[~near])


def test_layers_10_micrometers_apart_all_count():
    layers = 40
    half = AlphaMap(np.full((1, 1), 0.1, dtype=np.float32))
    mesh, _ = merge_meshes_with_sources([card(half, y=1e-5 * i) for i in range(layers)])
    for turn in (0.0, 0.7):
        pose = rigid_matrix(rotation_z(turn), [3.0, -2.0, 1.0])
        scene = InstancedScene([mesh], [0], pose[None])
        origins, along, _ = through(500)
        moved = origins @ pose[:3, :3].T + pose[:3, 3], along @ pose[:3, :3].T
        found = scene.transmittance(RayList(*moved))
        np.testing.assert_allclose(found, 0.9**layers, rtol=1e-6)


@pytest.mark.parametrize("slant", [1.0, 0.1, 1e-2, 1e-3])
def test_a_slanting_ray_hits_each_face_once(slant: float):
    mesh = card(AlphaMap(np.full((1, 1), 0.5, dtype=np.float32)))
    rng = np.random.default_rng(2)
    on = np.column_stack([rng.uniform(0.2, 0.8, 500), np.zeros(500), rng.uniform(0.2, 0.8, 500)])
    along = np.tile([1.0, slant, 0.3], (500, 1))
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    found = make_ray_caster(mesh).transmittance(on - along, along)
    np.testing.assert_array_equal(found, 0.5)


def test_a_ray_within_a_card_terminates():
    found = make_ray_caster(card(SOFT)).transmittance([[-1.0, 0.0, 0.5], [-1.0, 1e-9, 0.3]], [[1.0, 0, 0]] * 2)
    assert ((found >= 0.0) & (found <= 1.0)).all()


@pytest.mark.parametrize("extension", Extension)
@pytest.mark.parametrize("smooth", [False, True])
def test_faces_classified_opaque_or_clear_are_so_everywhere(extension: Extension, smooth: bool):
    rng = np.random.default_rng(3)
    texels = np.repeat(np.repeat(rng.integers(0, 2, (3, 5)) * 255, 4, axis=0), 4, axis=1).astype(np.uint8)
    alpha = AlphaMap(texels, extension, smooth, HARD)
    low = rng.uniform(-1.5, 1.5, (400, 1, 2))
    uv = (low + rng.uniform(0, 0.4, (400, 3, 2))).astype(np.float32)
    cuts = Cutouts(np.arange(400), uv, np.zeros(400, int), (alpha,)).face_cuts()
    weight = rng.dirichlet([0.3] * 3, (400, 200))
    opacity = alpha.opacity((weight @ uv.astype(float)).reshape(-1, 2)).reshape(400, 200)
    assert set(cuts) == set(Cut)
    assert (opacity[cuts == Cut.OPAQUE] == 1).all()
    assert (opacity[cuts == Cut.CLEAR] == 0).all()


def test_opacity_exactly_at_the_threshold():
    half = np.full((1, 1), 0.5, dtype=np.float32)
    origins, along, _ = through(5)
    assert make_ray_caster(card(AlphaMap(half))).occluded(origins, along).all()
    for curve, hides in ((TEXEL_GRADES >= 0.5, True), (TEXEL_GRADES > 0.5, False), (TEXEL_GRADES < 0.5, False)):
        alpha = AlphaMap(half, curve=curve.astype(np.float32))
        assert (make_ray_caster(card(alpha)).occluded(origins, along) == hides).all()


def test_boxes_touch_the_opaque_parts_of_a_card():
    scene = InstancedScene([card()], [0], rigid_matrix(rotation_z(0.4), [5.0, 2.0, 0.0])[None])
    at = np.random.default_rng(4).uniform(0.02, 0.98, (500, 2))
    world_from_box = np.tile(scene.world_from_instance[0], (500, 1, 1))
    world_from_box[:, :3, 3] += (at[:, :1] * world_from_box[:, :3, 0]) + at[:, 1:] * world_from_box[:, :3, 2]
    touched = Obstacles(scene).blocked_box_mask(np.full((500, 3), 0.05), world_from_box)
    # A box of 0.1 m around a point of a checkerboard of 0.25 m, far from the edges of its fields.
    opaque = on_checks(at)
    inner = (np.abs(at * 4 - np.rint(at * 4)) > 0.25).all(axis=1)
    np.testing.assert_array_equal(touched[inner], opaque[inner])
    assert touched[opaque].all()
    whole = Obstacles(InstancedScene([replace(card(), cutouts=None)], [0], scene.world_from_instance))
    assert whole.blocked_box_mask(np.full((500, 3), 0.05), world_from_box).all()


@pytest.mark.parametrize(("longest", "shape"), [(8, (8, 8)), (5, (5, 5)), (1, (1, 1))])
def test_downsampled_textures_keep_their_mean_opacity(longest: int, shape: tuple[int, int]):
    alpha = replace(SOFT, curve=HARD)
    texels = shrink_alpha_texels(alpha, longest)
    assert texels.shape == shape
    assert AlphaMap(texels).texel_opacity().mean() == pytest.approx(alpha.texel_opacity().mean(), abs=1 / 255)


@pytest.mark.parametrize("smooth", [False, True])
def test_the_seen_surface_ends_where_texels_do_and_lacks_what_draws_nothing(smooth):
    texels = np.zeros((16, 16), dtype=np.uint8)
    texels[4:8, 2:12] = 255
    corners = np.array([[0.0, 0, 0], [4, 0, 0], [4, 2, 0], [0, 2, 0], [9, 9, 9], [5, 5, 5]])
    faces = np.array([[0, 1, 2], [0, 2, 3], [0, 5, 4]])  # the last is a line
    uv = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], dtype=np.float32)[faces[:2]]
    alpha = AlphaMap(texels, smooth=smooth)
    sheet = Mesh(corners, faces, "net", Cutouts(np.arange(2), uv, np.zeros(2, dtype=int), (alpha,)))
    assert faces_with_area(sheet).tolist() == [0, 1]
    surface, face = seen_mesh_and_source_faces(sheet.take_mesh_faces(np.array([0, 1])))
    np.testing.assert_allclose(surface.bounds, [[0.5, 0.5, 0], [3.0, 1.0, 0]], atol=4 / 16 / 8)
    assert set(face.tolist()) == {0, 1}
    on_map = Mesh(corners + np.array([477123.0, 5412345.0, 0.0]), faces, "net")
    assert faces_with_area(on_map).tolist() == [0, 1]
    clear = AlphaMap(np.full((1, 1), 100, dtype=np.uint8))
    ghost = Mesh(corners, faces[:2], "ghost", Cutouts(np.arange(2), uv, np.zeros(2, dtype=int), (clear,)))
    assert seen_mesh_and_source_faces(ghost) is None
