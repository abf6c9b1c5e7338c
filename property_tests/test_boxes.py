"""Boxes compared with exact arithmetic, with every vertex, with pixels, and behind lenses with very many points."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from fractions import Fraction
from functools import cache

import numpy as np
import trimesh
from hypothesis import assume, given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from hulldown.annotate.boxes import VehicleBoxes, surface_box
from hulldown.annotate.extremes import MAX_COORDINATE_PX
from hulldown.annotate.masks import mask_box
from hulldown.annotate.posing import PosedParts, transform_part_points
from hulldown.annotate.silhouettes import whole_and_visible_masks
from hulldown.assets.vehicle import VehicleShape
from hulldown.camera.cameras import NEAR_M, Cameras
from hulldown.camera.intrinsics import Intrinsics
from hulldown.geometry.meshes import Mesh
from hulldown.geometry.transforms import axis_rotation, rigid_matrix, transform_points
from hulldown.scene.posed_vehicle import PosedVehicle, VehicleCaster
from hulldown.tests.builders.shapes import PARTS, random_rotations, vehicle_of, vertices_at
from hulldown.tests.oracles.clipping import clipped
from hulldown.tests.oracles.curves import LENSES, dense_extent

PIXEL_ERROR = 1e-6  # the promised error; relative for boxes with more digits than a pixel's
View = tuple[np.ndarray, Cameras, dict[str, float]]  # the vehicle's pose, the camera, and angles of parts
FIELDS_OF_VIEW = [math.radians(degrees) for degrees in (0.1, 1.0, 30.0, 60.0, 120.0, 179.0)]


def numbers(low: float, high: float) -> st.SearchStrategy[float]:
    return st.floats(low, high, allow_subnormal=False)


def arrays_of(shape: tuple[int, ...], low: float = -2.0, high: float = 2.0) -> st.SearchStrategy[np.ndarray]:
    """Arrays whose elements are all drawn."""
    return arrays(float, shape, elements=numbers(low, high), fill=st.nothing())


def turned(turns: np.ndarray) -> np.ndarray:
    """The rotation by these angles about z, y, and x."""
    return np.linalg.multi_dot([axis_rotation(axis, angle) for axis, angle in zip(np.eye(3)[::-1], turns, strict=True)])


rotations = arrays_of((3,), -math.pi, math.pi).map(turned)


@st.composite
def soups(draw: st.DrawFn) -> tuple[np.ndarray, np.ndarray]:
    """A few triangles, which leave vertices unused, or many."""
    n, count = draw(st.integers(3, 11)), draw(st.integers(1, 3) | st.integers(4, 300))
    faces = np.random.default_rng(draw(st.integers(0, 2**32))).integers(0, n, (300, 3))
    return draw(arrays_of((n, 3))), faces[:count]


@st.composite
def parts(draw: st.DrawFn) -> Mesh:
    """A triangle soup, a flat plate, a subdivided box, or a ball."""
    kind = draw(st.sampled_from(["soup", "plate", "box", "ball"]))
    vertices, faces = draw(soups()) if kind in ("soup", "plate") else solid(draw(st.integers(0, 3)), ball=kind == "ball")
    stretched = vertices * draw(arrays_of((3,), 0.2, 4.0)) * ([1.0, 1.0, 0.0] if kind == "plate" else 1.0)
    return Mesh(stretched @ draw(rotations).T + draw(arrays_of((3,))), faces)


# The meshes of up to three parts, with their pivots and axes; `turning` makes the vehicle. Not in a strategy: the type
# checker samples with `random`, which Hypothesis forbids there.
vehicles = st.tuples(st.lists(parts(), min_size=1, max_size=3), arrays_of((3, 3)), st.tuples(rotations, rotations, rotations))
Drawn = tuple[list[Mesh], np.ndarray, tuple[np.ndarray, ...]]


def turning(meshes: Sequence[Mesh], pivots: np.ndarray, rotations: Sequence[np.ndarray]) -> VehicleShape:
    shape = vehicle_of(*meshes, pivots=pivots * [[0], [1], [1]])
    limits = np.tile([-math.pi, math.pi], (3, 1))[: len(meshes)]
    return replace(shape, part_axis=np.array([each[0] for each in rotations[: len(meshes)]]), part_limits=limits)


def solid(subdivisions: int, *, ball: bool) -> tuple[np.ndarray, np.ndarray]:
    mesh = trimesh.creation.box()
    for _ in range(subdivisions):
        mesh = mesh.subdivide()
    vertices = np.asarray(mesh.vertices)
    return vertices / np.linalg.norm(vertices, axis=1, keepdims=True) if ball else vertices, np.asarray(mesh.faces)


@cache
def large_vehicle() -> tuple[VehicleShape, VehicleBoxes]:
    """A vehicle of two parts with more than 60,000 triangles."""
    meshes = [Mesh(vertices * size, faces) for size in (2.0, 1.3) for vertices, faces in [solid(6, ball=size < 2.0)]]
    rng = np.random.default_rng(0)
    shape = turning(meshes, rng.normal(size=(3, 3)), random_rotations(rng, 2))
    return shape, VehicleBoxes(shape)


@st.composite
def cameras(draw: st.DrawFn, target: np.ndarray) -> Cameras:
    """Cameras roughly towards the target, from inside it to far away, with any field of view and image size."""
    distance, rotation = 10.0 ** draw(numbers(-2.0, 2.5)), draw(rotations)
    aside = draw(arrays_of((3,))) * distance * draw(st.sampled_from([0.0, 0.05, 0.5]))
    width, height = draw(st.tuples(*[st.sampled_from([640, 1, 16, 1920])] * 2))
    position = target - distance * rotation[:, 2] + aside
    return Cameras(Intrinsics(width, height, draw(st.sampled_from(FIELDS_OF_VIEW))), rigid_matrix(rotation, position))


@st.composite
def views(draw: st.DrawFn) -> View:
    origin = draw(arrays_of((3,))) * draw(st.sampled_from([0.0, 1.0, 1e4]))
    angles = {name: draw(st.none() | numbers(-3.0, 3.0)) for name in PARTS[1:]}
    articulation = {name: angle for name, angle in angles.items() if angle is not None}
    return rigid_matrix(draw(rotations), origin), draw(cameras(origin)), articulation


def exact_box(
    vertices: np.ndarray, faces: np.ndarray, camera: Cameras, *, frame: bool, slack: float
) -> tuple[Fraction, ...] | None:
    """Clip every triangle in rational arithmetic, its planes moved outwards by `slack`; (u0, v0, u1, v1) or None."""
    axes = [[Fraction(float(n)) for n in column] for column in camera.world_from_camera[:3, :3].T]
    position = [Fraction(float(n)) for n in camera.position]
    points = []
    for vertex in vertices:
        apart = [Fraction(float(n)) - p for n, p in zip(vertex, position, strict=True)]
        points.append([sum(a * b for a, b in zip(axis, apart, strict=True)) for axis in axes])
    f = Fraction(camera.lenses.f_px)
    cx, cy = Fraction(camera.lenses.width, 2), Fraction(camera.lenses.height, 2)
    planes = [(0, 0, 1, Fraction(slack) - Fraction(NEAR_M))]
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


@given(st.data(), st.integers(3, 6), numbers(-2.0, 2.0), st.booleans())
def test_clipping_equals_exact_clipping(data: st.DataObject, n: int, exponent: float, frame: bool) -> None:
    vertices = data.draw(arrays_of((n, 3))) * 10.0**exponent
    faces = np.array(data.draw(st.lists(st.tuples(*[st.integers(0, n - 1)] * 3), min_size=1, max_size=4)))
    camera = data.draw(cameras(vertices[0]))
    # Rounding of coordinates of this size can move a plane by this much.
    slack = 1e-13 * (np.abs(vertices - camera.position).max() + 1.0)
    found = surface_box(vertices, faces, camera, frame=frame)
    assert_between(found, *(exact_box(vertices, faces, camera, frame=frame, slack=s) for s in (-slack, slack)))


# A normal lens nearby, the vehicle cut by the frame.
closeups = st.tuples(numbers(0.5, 6.0), rotations, arrays_of((2,), -0.6, 0.6), numbers(0.5, 1.5))
# Lenses whose near plane, at 0.1 m, may touch the vehicle: where they see its nearest vertex.
touching = st.tuples(numbers(0.05, 0.2), rotations, arrays_of((2,)), st.sampled_from(FIELDS_OF_VIEW))
# Lenses whose left edge is some pixels from the box's left or right side.
offsets = numbers(0.01, 9.0) | numbers(-9.0, -0.01)  # at 0, rounding decides
beside = st.tuples(rotations, offsets, st.sampled_from([np.min, np.max]), st.sampled_from(FIELDS_OF_VIEW))


@given(
    st.none() | vehicles, views(), st.lists(closeups, max_size=1), st.lists(touching, min_size=1, max_size=2),
    st.lists(beside, min_size=1, max_size=3), st.booleans(),
)  # fmt: skip
def test_the_fast_box_equals_clipping(
    vehicle: Drawn | None, view: View, cut: list[tuple], near: list[tuple], edges: list[tuple], frame: bool
) -> None:
    shape = turning(*vehicle) if vehicle else large_vehicle()[0]
    boxes = VehicleBoxes(shape) if vehicle else large_vehicle()[1]
    pose, camera, angles = view
    articulation = {name: angle for name, angle in angles.items() if name in shape.part_names}
    lenses = [camera]
    for distance, rotation, aside, fov_x in cut:
        position = pose[:3, 3] - distance * rotation[:, 2] + rotation[:, :2] @ aside * distance
        lenses.append(Cameras(Intrinsics(640, 480, fov_x), rigid_matrix(rotation, position)))
    vertices_world = transform_points(pose, vertices_at(shape, articulation))
    for depth, rotation, aside, fov_x in near:
        nearest = vertices_world[(vertices_world @ rotation[:, 2]).argmin()]
        position = nearest - depth * (rotation[:, 2] + rotation[:, :2] @ aside)
        lenses.append(Cameras(Intrinsics(640, 480, fov_x), rigid_matrix(rotation, position)))
    for rotation, edge, side, fov_x in edges:
        intrinsics, position = Intrinsics(640, 480, fov_x), pose[:3, 3] - 50.0 * rotation[:, 2]
        x, _, z = rotation.T @ (vertices_world - position).T
        shift = side(x - (edge - 320.0) * z / intrinsics.f_px)  # of the camera to its right
        lenses.append(Cameras(intrinsics, rigid_matrix(rotation, position + shift * rotation[:, 0])))
    for lens in lenses:
        found = boxes.box(pose, lens, articulation, frame=frame)
        expected = surface_box(vertices_world, shape.mesh.faces, lens, frame=frame)
        # Coordinates of 1e4 m have rounding errors of 1e-12 m, which a long lens nearby magnifies to pixels.
        far = 1e-15 * np.abs(vertices_world).max() * lens.lenses.f_px / NEAR_M
        assert (expected is None) == (found is None)
        if expected is not None and found is not None:
            tolerance = (PIXEL_ERROR + far) * max(1.0, np.abs(expected).max()) ** 0.5
            assert np.abs(found - expected).max() <= tolerance


@given(vehicles, rotations, arrays_of((3,)), arrays_of((3,), -3.0, 3.0))
def test_hull_vertices_give_the_bits_of_all_vertices(
    vehicle: Drawn, rotation: np.ndarray, position: np.ndarray, angles: np.ndarray
) -> None:
    camera, shape = Cameras(Intrinsics(1920, 1080, 1.0), rigid_matrix(np.eye(3), [0.0, 0.0, -60.0])), turning(*vehicle)
    pose, posed = rigid_matrix(rotation, position), PosedParts(shape)
    angles = (angles * [0.0, 1.0, 1.0])[None, : len(shape.part_names)]
    articulation = dict(zip(shape.part_names[1:], angles[0, 1:].tolist(), strict=True))
    camera_from_parts = posed.camera_from_parts(pose[None], camera.world_from_camera[None], angles)
    x, y, z = transform_part_points(posed.vertices, posed.vertex_slices, camera_from_parts)[:, 0]
    u, v = x / z * camera.lenses.f_px + 960.0, y / z * camera.lenses.f_px + 540.0
    assume(min(u.min(), v.min()) >= 0.0)
    assume(u.max() <= 1920.0)
    assume(v.max() <= 1080.0)
    expected = np.array([u.min(), v.min(), u.max() - u.min(), v.max() - v.min()])
    assert np.array_equal(VehicleBoxes(shape).box(pose, camera, articulation), expected)


@given(vehicles, st.lists(views(), max_size=5), cameras(np.zeros(3)))
def test_a_batch_gives_the_bits_of_its_rows(vehicle: Drawn, rows: list[View], camera: Cameras) -> None:
    shape, first = turning(*vehicle), camera.lenses
    boxes, poses = VehicleBoxes(shape), np.array([view[0] for view in rows]).reshape(-1, 4, 4)
    angles = [{name: angle for name, angle in view[2].items() if name in shape.part_names} for view in rows]
    each = [replace(view[1], lenses=replace(first, fov_x=view[1].lenses.fov_x)) for view in rows]
    lenses = replace(first, fov_x=np.array([camera.lenses.fov_x for camera in each]))
    world_from_camera = np.array([camera.world_from_camera for camera in each]).reshape(-1, 4, 4)
    found = boxes.boxes(poses, Cameras(lenses, world_from_camera), angles)
    for i, camera in enumerate(each):
        for frame, together in ((True, found.xywh), (False, found.amodal)):
            alone = boxes.box(poses[i], camera, angles[i], frame=frame)
            assert np.array_equal(together[i], np.full(4, np.nan) if alone is None else alone, equal_nan=True)


@given(st.integers(0, 3), st.booleans(), arrays_of((3,), 1.0, 4.0), rotations, arrays_of((3,), -3.0, 3.0))
def test_the_box_contains_the_mask_and_touches_it_on_four_sides(
    subdivisions: int, ball: bool, stretch: np.ndarray, rotation: np.ndarray, position: np.ndarray
) -> None:
    vertices, faces = solid(subdivisions, ball=ball)
    shape, pose = vehicle_of(Mesh(vertices * stretch, faces)), rigid_matrix(rotation, position)
    view = rigid_matrix(np.eye(3), [0.0, 0.0, -8.0])
    box = VehicleBoxes(shape).box(pose, Cameras(Intrinsics(64, 48, 1.0), view))
    if box is None or box[2:].min() < 1.0:
        return
    # Eight rays a pixel and axis, since the pointed end of a surface can be between pixel centers.
    fine = Cameras(Intrinsics(8 * 64, 8 * 48, 1.0), view)
    around = 8.0 * box + [-16.0, -16.0, 32.0, 32.0]
    inner = mask_box(whole_and_visible_masks(PosedVehicle(VehicleCaster(shape), pose[None], {}), fine, xywh=around)[1])
    assert inner is not None
    inner /= 8.0
    low, high = inner[:2] - box[:2], box[:2] + box[2:] - inner[:2] - inner[2:]
    assert min(low.min(), high.min()) >= -0.5 / 8.0 - 1e-3
    assert max(low.max(), high.max()) <= 1.0


@given(
    st.data(), st.sampled_from([(1920, 1080), (640, 480), (1080, 1920)]), st.sampled_from(sorted(LENSES)),
    st.sampled_from(["before", "large", "across"]), numbers(40.0, 120.0), arrays_of((6,), -1.0, 1.0), st.integers(1, 6),
)  # fmt: skip
def test_curved_boxes_are_within_a_hundredth_of_a_pixel(
    data: st.DataObject, size_px: tuple[int, int], name: str, kind: str, fov_deg: float, place: np.ndarray, count: int
) -> None:
    (width, height), half = size_px, math.radians(fov_deg) / 2
    while True:  # the widest view that doesn't fold
        f = width / 2 / math.tan(half)
        pinhole = (f, f * (1 + 0.1 * place[0]), width * (0.5 + 0.15 * place[1]), height * (0.5 + 0.15 * place[2]))
        try:
            intrinsics = Intrinsics.calibrated(width, height, pinhole, LENSES[name])
            break
        except ValueError:
            half *= 0.9
    middle = np.array([*place[3:5], 1.0]) * 10 ** data.draw(numbers(-0.5, 1.5))
    size = 10 ** data.draw(numbers(-1.5, 1)) * np.linalg.norm(middle) * (3 if kind == "large" else 1)
    corners = np.eye(3) + data.draw(arrays_of((count, 3, 3)))
    assume((np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) > 0.01).all())
    triangles = middle + corners * size * data.draw(arrays_of((3,), 0.05, 1.0))
    if kind == "across":
        triangles[..., 2] += place[5] * size - middle[2]
    faces = np.arange(3 * len(triangles)).reshape(-1, 3)
    for frame in (True, False):
        box = surface_box(triangles.reshape(-1, 3), faces, Cameras(intrinsics, np.eye(4)), frame=frame)
        wanted = dense_extent(triangles, intrinsics, frame=frame)
        if box is None or wanted is None:
            assert box is None, box
            assert wanted is None, wanted
            continue
        wanted = np.clip(wanted, -MAX_COORDINATE_PX, MAX_COORDINATE_PX)
        # Next to the near plane, pixels are millions apart.
        tolerance = 0.01 if frame else 0.01 + 1e-4 * np.abs(wanted).max()
        assert np.abs(np.append(box[:2], box[:2] + box[2:]) - wanted).max() <= tolerance
