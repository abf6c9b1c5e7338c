"""Boxes compared with exact arithmetic, with every vertex, with pixels, and behind lenses with very many points."""

from __future__ import annotations

import math
from dataclasses import replace
from fractions import Fraction
from functools import cache

import numpy as np
import trimesh
from hypothesis import assume, given
from hypothesis import strategies as st

from hulldown.annotate.boxes import FAR, VehicleBoxes, surface_box
from hulldown.annotate.clusters import SMALL
from hulldown.annotate.masks import mask_box
from hulldown.annotate.posing import PosedParts, move
from hulldown.annotate.silhouettes import vehicle_masks
from hulldown.assets.vehicle import VehicleShape
from hulldown.camera.intrinsics import Intrinsics
from hulldown.camera.projection import NEAR, Camera
from hulldown.geometry.meshes import Mesh
from hulldown.geometry.transforms import apply, rigid
from hulldown.scene.posed_vehicle import PosedVehicle, VehicleTarget
from hulldown.tests.oracles.clipping import clipped
from hulldown.tests.oracles.curves import LENSES, dense_extent
from hulldown.tests.shapes import random_rotations, vehicle_of, vertices_at

PIXEL_ERROR = 1e-6  # the promised error; relative for boxes with more digits than a pixel's
View = tuple[VehicleShape, np.ndarray, Camera, dict[str, float]]  # with the vehicle's pose and articulation
FIELDS_OF_VIEW = [math.radians(degrees) for degrees in (0.1, 1.0, 30.0, 60.0, 120.0, 179.0)]


def random_rotation(rng: np.random.Generator) -> np.ndarray:
    return random_rotations(rng, 1)[0]


def random_vehicle(rng: np.random.Generator) -> VehicleShape:
    """Up to three parts, each a triangle soup, a subdivided box, a ball, or a flat plate."""
    meshes = []
    for kind in rng.choice(["soup", "box", "ball", "plate"], rng.integers(1, 4)):
        vertices, faces = soup(rng) if kind in ("soup", "plate") else solid(rng.integers(4), ball=kind == "ball")
        stretched = vertices * rng.uniform(0.2, 4.0, 3) * ([1.0, 1.0, 0.0] if kind == "plate" else 1.0)
        meshes.append(Mesh(stretched @ random_rotation(rng).T + rng.normal(size=3), faces))
    return turning(rng, *meshes)


def turning(rng: np.random.Generator, *meshes: Mesh) -> VehicleShape:
    shape = vehicle_of(*meshes, pivots=rng.normal(size=(3, 3)) * [[0], [1], [1]])
    limits = np.tile([-math.pi, math.pi], (3, 1))[: len(meshes)]
    return replace(shape, part_axis=random_rotations(rng, len(meshes))[:, 0], part_limits=limits)


def soup(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    n, faces = int(rng.integers(3, 12)), int(rng.integers(1, rng.choice([4, 300])))  # few faces leave vertices unused
    return rng.normal(size=(n, 3)), rng.integers(0, n, size=(faces, 3))


def solid(subdivisions: int, *, ball: bool) -> tuple[np.ndarray, np.ndarray]:
    mesh = trimesh.creation.box()
    for _ in range(subdivisions):
        mesh = mesh.subdivide()
    vertices = np.asarray(mesh.vertices)
    return vertices / np.linalg.norm(vertices, axis=1, keepdims=True) if ball else vertices, np.asarray(mesh.faces)


@cache
def large_vehicle() -> tuple[VehicleShape, VehicleBoxes]:
    """A vehicle of so many triangles that boxes cut by the frame are found by branch and bound."""
    parts = [Mesh(vertices * size, faces) for size in (2.0, 1.3) for vertices, faces in [solid(6, ball=size < 2.0)]]
    shape = turning(np.random.default_rng(0), *parts)
    assert len(shape.mesh.faces) > 2 * SMALL
    return shape, VehicleBoxes(shape)


def random_camera(rng: np.random.Generator, target: np.ndarray) -> Camera:
    """Cameras roughly towards the target, from inside it to far away, with any field of view and image size."""
    distance = 10.0 ** rng.uniform(-2.0, 2.5)
    rotation = random_rotation(rng)
    aside = rng.normal(size=3) * distance * rng.choice([0.0, 0.05, 0.5])
    width, height = (int(n) for n in rng.choice([1, 16, 640, 1920], size=2))
    position = target - distance * rotation[:, 2] + aside
    return Camera(Intrinsics(width, height, float(rng.choice(FIELDS_OF_VIEW))), rigid(rotation, position))


def random_view(seed: int) -> View:
    rng = np.random.default_rng(seed)
    shape = random_vehicle(rng)
    origin = rng.normal(size=3) * rng.choice([0.0, 1.0, 1e4])
    pose = rigid(random_rotation(rng), origin)
    articulation = {name: float(rng.uniform(-3.0, 3.0)) for name in shape.part_names[1:] if rng.random() < 0.8}
    return shape, pose, random_camera(rng, origin), articulation


def exact_box(
    vertices: np.ndarray, faces: np.ndarray, camera: Camera, *, frame: bool, slack: float
) -> tuple[Fraction, ...] | None:
    """Clip every triangle in rational arithmetic, its planes moved outwards by `slack`; (u0, v0, u1, v1) or None."""
    axes = [[Fraction(float(n)) for n in column] for column in camera.world_from_camera[:3, :3].T]
    position = [Fraction(float(n)) for n in camera.position]
    points = []
    for vertex in vertices:
        apart = [Fraction(float(n)) - p for n, p in zip(vertex, position, strict=True)]
        points.append([sum(a * b for a, b in zip(axis, apart, strict=True)) for axis in axes])
    f = Fraction(camera.intrinsics.f_px)
    cx, cy = Fraction(camera.intrinsics.width, 2), Fraction(camera.intrinsics.height, 2)
    planes = [(0, 0, 1, Fraction(slack) - Fraction(NEAR))]
    if frame:
        for normal in ((f, 0, cx), (-f, 0, cx), (0, f, cy), (0, -f, cy)):
            planes.append((*normal, Fraction(slack) * max(abs(n) for n in normal)))
    us, vs = [], []
    for face in faces:
        polygon = clipped([points[i] for i in face], planes)
        us += [x / z * f + cx for x, _, z in polygon]
        vs += [y / z * f + cy for _, y, z in polygon]
    return (min(us), min(vs), max(us), max(vs)) if us else None


def assert_between(found: np.ndarray | None, least: tuple | None, most: tuple | None) -> None:
    """The box is between those of slightly smaller and larger frustums, by the rounding of float64."""
    if found is None:
        assert least is None
        return
    assert most is not None
    low, high = found[:2], found[:2] + found[2:]
    error = PIXEL_ERROR * max(1.0, *(abs(float(n)) for n in most)) ** 0.5
    assert (low >= np.array(most[:2], dtype=float) - error).all()
    assert (high <= np.array(most[2:], dtype=float) + error).all()
    if least is not None:
        assert (low <= np.array(least[:2], dtype=float) + error).all()
        assert (high >= np.array(least[2:], dtype=float) - error).all()


@given(st.integers(0, 2**32), st.booleans())
def test_clipping_equals_exact_clipping(seed: int, frame: bool) -> None:
    rng = np.random.default_rng(seed)
    n = int(rng.integers(3, 7))
    vertices = rng.normal(size=(n, 3)) * 10.0 ** rng.uniform(-2.0, 2.0)
    faces = rng.integers(0, n, size=(int(rng.integers(1, 5)), 3))
    camera = random_camera(rng, vertices[0])
    # Rounding of coordinates of this size can move a plane by this much.
    slack = 1e-13 * (np.abs(vertices - camera.position).max() + 1.0)
    found = surface_box(vertices, faces, camera, frame=frame)
    assert_between(found, *(exact_box(vertices, faces, camera, frame=frame, slack=s) for s in (-slack, slack)))


@given(st.integers(0, 2**32), st.booleans(), st.booleans())
def test_the_fast_box_equals_clipping(seed: int, frame: bool, large: bool) -> None:
    rng = np.random.default_rng(seed)
    shape, pose, camera, articulation = random_view(seed)
    boxes = VehicleBoxes(shape)
    if large:
        shape, boxes = large_vehicle()
        articulation = {name: float(rng.uniform(-3.0, 3.0)) for name in shape.part_names[1:]}
    for _ in range(4):
        assert_is_the_rule(boxes, (shape, pose, camera, articulation), frame=frame)
        # From here on, typical uses of branch and bound: a normal lens nearby, the vehicle cut by the frame.
        distance, rotation = rng.uniform(0.5, 6.0), random_rotation(rng)
        aside = rotation[:, :2] @ rng.uniform(-0.6, 0.6, 2) * distance
        position = pose[:3, 3] - distance * rotation[:, 2] + aside
        camera = Camera(Intrinsics(640, 480, float(rng.uniform(0.5, 1.5))), rigid(rotation, position))


def assert_is_the_rule(boxes: VehicleBoxes, view: View, *, frame: bool) -> None:
    shape, pose, camera, articulation = view
    found = boxes.box(pose, camera, articulation, frame=frame)
    vertices_world = apply(pose, vertices_at(shape, articulation))
    expected = surface_box(vertices_world, shape.mesh.faces, camera, frame=frame)
    # Coordinates of 1e4 m have rounding errors of 1e-12 m, which a long lens nearby magnifies to pixels.
    far = 1e-15 * np.abs(vertices_world).max() * camera.intrinsics.f_px / NEAR
    assert (expected is None) == (found is None)
    if expected is not None and found is not None:
        tolerance = (PIXEL_ERROR + far) * max(1.0, np.abs(expected).max()) ** 0.5
        assert np.abs(found - expected).max() <= tolerance


@given(st.integers(0, 2**32))
def test_hull_vertices_give_the_bits_of_all_vertices(seed: int) -> None:
    rng = np.random.default_rng(seed)
    shape = random_vehicle(rng)
    camera = Camera(Intrinsics(1920, 1080, 1.0), rigid(np.eye(3), [0.0, 0.0, -60.0]))
    pose = rigid(random_rotation(rng), rng.normal(size=3))
    parts = PosedParts(shape)
    angles = rng.uniform(-3.0, 3.0, (1, len(shape.part_names))) * (np.arange(len(shape.part_names)) > 0)
    articulation = dict(zip(shape.part_names[1:], angles[0, 1:].tolist(), strict=True))
    camera_from_parts = parts.camera_from_parts(pose[None], camera.world_from_camera[None], angles)
    x, y, z = move(parts.vertices, parts.vertex_slices, camera_from_parts)[:, 0]
    u, v = x / z * camera.intrinsics.f_px + 960.0, y / z * camera.intrinsics.f_px + 540.0
    assume(min(u.min(), v.min()) >= 0.0)
    assume(u.max() <= 1920.0)
    assume(v.max() <= 1080.0)
    expected = np.array([u.min(), v.min(), u.max() - u.min(), v.max() - v.min()])
    assert np.array_equal(VehicleBoxes(shape).box(pose, camera, articulation), expected)


@given(st.lists(st.integers(0, 2**32), max_size=5), st.integers(0, 2**32))
def test_a_batch_gives_the_bits_of_its_rows(seeds: list[int], vehicle: int) -> None:
    shape = random_vehicle(np.random.default_rng(vehicle))
    boxes = VehicleBoxes(shape)
    views = [random_view(seed) for seed in seeds]
    poses = np.array([view[1] for view in views]).reshape(-1, 4, 4)
    first = random_view(vehicle)[2].intrinsics
    cameras = [replace(view[2], intrinsics=replace(first, fov_x=view[2].intrinsics.fov_x)) for view in views]
    lenses = replace(first, fov_x=np.array([camera.intrinsics.fov_x for camera in cameras]))
    world_from_camera = np.array([camera.world_from_camera for camera in cameras]).reshape(-1, 4, 4)
    angles = [{name: 0.3 * len(view[3]) for name in shape.part_names[1:]} for view in views]
    found = boxes.boxes(poses, world_from_camera, lenses, angles)
    for i, camera in enumerate(cameras):
        for frame, rows in ((True, found.xywh), (False, found.amodal)):
            alone = boxes.box(poses[i], camera, angles[i], frame=frame)
            assert np.array_equal(rows[i], np.full(4, np.nan) if alone is None else alone, equal_nan=True)


@given(st.integers(0, 2**32))
def test_the_box_contains_the_mask_and_touches_it_on_four_sides(seed: int) -> None:
    rng = np.random.default_rng(seed)
    vertices, faces = solid(rng.integers(4), ball=seed % 2 == 1)
    shape = vehicle_of(Mesh(vertices * rng.uniform(1.0, 4.0, 3), faces))
    pose = rigid(random_rotation(rng), rng.uniform(-3.0, 3.0, 3))
    view = rigid(np.eye(3), [0.0, 0.0, -8.0])
    box = VehicleBoxes(shape).box(pose, Camera(Intrinsics(64, 48, 1.0), view))
    if box is None or box[2:].min() < 1.0:
        return
    # Eight rays a pixel and axis, since the pointed end of a surface can be between pixel centers.
    fine = Camera(Intrinsics(8 * 64, 8 * 48, 1.0), view)
    around = 8.0 * box + [-16.0, -16.0, 32.0, 32.0]
    inner = mask_box(vehicle_masks(PosedVehicle(VehicleTarget(shape), pose[None], {}), fine, xywh=around)[1])
    assert inner is not None
    inner /= 8.0
    low, high = inner[:2] - box[:2], box[:2] + box[2:] - inner[:2] - inner[2:]
    assert min(low.min(), high.min()) >= -0.5 / 8.0 - 1e-3
    assert max(low.max(), high.max()) <= 1.0


@given(st.integers(0, 2**63), st.sampled_from(sorted(LENSES)), st.sampled_from(["before", "large", "across"]))
def test_curved_boxes_are_within_a_hundredth_of_a_pixel(seed: int, name: str, kind: str) -> None:
    rng = np.random.default_rng(seed)
    width, height = ((1920, 1080), (640, 480), (1080, 1920))[rng.integers(3)]
    half = math.radians(rng.uniform(40, 120)) / 2
    while True:  # the widest view that doesn't fold
        f = width / 2 / math.tan(half)
        pinhole = (f, f * rng.uniform(0.9, 1.1), width * rng.uniform(0.35, 0.65), height * rng.uniform(0.35, 0.65))
        try:
            intrinsics = Intrinsics.calibrated(width, height, pinhole, LENSES[name])
            break
        except ValueError:
            half *= 0.9
    middle = np.array([*rng.uniform(-1, 1, 2), 1.0]) * 10 ** rng.uniform(-0.5, 1.5)
    size = 10 ** rng.uniform(-1.5, 1) * np.linalg.norm(middle) * (3 if kind == "large" else 1)
    triangles = middle + rng.normal(size=(rng.integers(1, 7), 3, 3)) * size * rng.uniform(0.05, 1, 3)
    if kind == "across":
        triangles[..., 2] += rng.uniform(-1, 1) * size - middle[2]
    faces = np.arange(3 * len(triangles)).reshape(-1, 3)
    for frame in (True, False):
        box = surface_box(triangles.reshape(-1, 3), faces, Camera(intrinsics, np.eye(4)), frame=frame)
        wanted = dense_extent(triangles, intrinsics, frame=frame)
        if box is None or wanted is None:
            assert box is None, box
            assert wanted is None, wanted
            continue
        wanted = np.clip(wanted, -FAR, FAR)
        # Next to the near plane, pixels are millions apart.
        tolerance = 0.01 if frame else 0.01 + 1e-4 * np.abs(wanted).max()
        assert np.abs(np.append(box[:2], box[:2] + box[2:]) - wanted).max() <= tolerance
