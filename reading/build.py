"""Build a vehicle or a scenery from evaluated pieces, without Blender."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from difflib import get_close_matches

import numpy as np
from jaxtyping import Float

from hulldown.assets.scenery import Scenery
from hulldown.assets.vehicle import VehicleShape
from hulldown.base.errors import AssetError
from hulldown.geometry.meshes import Mesh, merge_meshes_with_sources
from hulldown.geometry.seen_surface import seen_mesh_and_source_faces
from hulldown.geometry.transforms import transform_points
from hulldown.placement.footprint import contact_footprint, vehicle_underside
from hulldown.reading.pieces.asset_report import PartRow, Thing, xyz_tuple
from hulldown.reading.pieces.doubt import Doubt, DoubtKind
from hulldown.reading.pieces.options import Options
from hulldown.reading.pieces.roles import Evaluated, Piece, PieceRole, is_kept_by_name, vehicle_roles
from hulldown.reading.scenery.scenery_roles import MIN_WATER_WIDTH_M, unmatched_key_and_pattern
from hulldown.reading.scenery.shape import is_wide_and_level, level_share_and_area
from hulldown.reading.vehicle.nose import forward_config_text, mirror_gap
from hulldown.reading.vehicle.part_names import GUN_PART, HULL, TURRET_PART
from hulldown.reading.vehicle.parts import find_parts
from hulldown.reading.vehicle.pivots import keypoints_from_empties
from hulldown.reading.vehicle.solids import MAX_SOLIDS, PlacedPieces
from hulldown.reading.vehicle.stance import (
    UP_AXES,
    Upright,
    find_nose_and_wheels,
    refind_solids_of_pieces,
    vehicle_from_upright,
    z_up_rotation,
)
from hulldown.reading.vehicle.strays import Stray, find_left_out_and_strays
from hulldown.reading.vehicle.things import find_things_and_doubts

KILOMETER_M = 1000.0
MAX_LYING_GAP_SHARE = 0.02  # of its height: a mirror image is this close to its original
NAME_CLUES = (
    "write an object's whole name, with * a part of it; mesh:, collection: or material: before the name of one of those"
)


@dataclass(frozen=True, eq=False, slots=True)
class BuiltVehicle:
    """A vehicle with the role and part (-1: none) of each piece, the moving parts, axes, doubts, and things in it.

    A role's use is the part's name, or "dropped".
    """

    shape: VehicleShape
    roles: list[PieceRole]
    piece_part: list[int]
    parts: tuple[PartRow, ...]
    axes: str
    doubts: tuple[Doubt, ...]
    things: tuple[Thing, ...]


def build_vehicle(name: str, upright: Upright, options: Options) -> BuiltVehicle:
    """Build the vehicle from the pieces; strays are proposed for `drop` if the rest has fewer doubts."""
    built, strays = _build_vehicle_and_strays(name, upright, options)

    def helps(stray: Stray) -> bool:
        try:
            other, left = _build_vehicle_and_strays(name, upright, replace(options, drop=(*options.drop, *stray.drop)))
        except AssetError:
            return False
        return len(other.doubts) + len(left) < len(built.doubts) + len(strays)

    doubts = (stray.doubt(helps=stray.small and helps(stray)) for stray in strays)
    return replace(built, doubts=(*built.doubts, *doubts))


def _build_vehicle_and_strays(name: str, upright: Upright, options: Options) -> tuple[BuiltVehicle, list[Stray]]:
    """Build the vehicle with all other doubts, and return what might not belong to it."""
    pieces, meshes, markers = upright.drawn.pieces, upright.drawn.meshes, upright.drawn.markers
    roles = vehicle_roles(pieces, keep=options.keep, drop=options.drop)
    kept = [i for i, role in enumerate(roles) if role.use == "vehicle"]
    if not kept:
        there = ", ".join(sorted({repr(p.name) for p in pieces})[:8]) or "nothing that is rendered"
        raise AssetError(f"nothing is left after clean-up; it contains {there}", remedy="name what to `keep`")
    if len(upright.solids) == MAX_SOLIDS:
        upright = refind_solids_of_pieces(upright, kept)
    left_out: list[Doubt] = []
    while True:
        forward, solids, wheels = find_nose_and_wheels(upright, kept, options)
        ahead = vehicle_from_upright(forward.value)
        vehicle_from_file = ahead @ upright.meters
        points = [transform_points(vehicle_from_file @ pieces[i].pose, meshes[pieces[i].mesh].vertices) for i in kept]
        whole = PlacedPieces([pieces[i] for i in kept], points, solids.rotate_solids(ahead[:3, :3]), markers, vehicle_from_file)
        wanted = [k for k, piece in enumerate(whole.pieces) if is_kept_by_name(piece, options.keep)]
        others = [pieces[i] for i, role in enumerate(roles) if role.use == "dropped"]
        out, out_doubts, strays = find_left_out_and_strays(whole, meshes, wheels, wanted=wanted, left_out=others)
        if not out or len(out) == len(kept):
            break
        left_out += out_doubts
        for k, why in out.items():
            roles[kept[k]] = PieceRole("dropped", why)
        # Without them the nose, and so the protruding parts, may change.
        kept = [i for k, i in enumerate(kept) if k not in out]
    try:
        parts = find_parts(whole, options)
    except ValueError as error:
        raise AssetError(str(error)) from None
    names = (HULL, *(row.name for row in parts.moving))
    for key, part in ((options.turret, TURRET_PART), (options.gun, GUN_PART)):
        if key and part not in names:
            there = ", ".join(sorted({repr(piece.name) for piece in whole.pieces})[:8])
            raise AssetError(f"{part} = {key!r} matches nothing, or everything; it contains {there}")
    order = np.argsort(parts.piece_part, kind="stable")
    placed = [_place_and_compact_mesh(meshes[whole.pieces[j].mesh], points[j], whole.pieces[j].name) for j in order]
    mesh, _ = merge_meshes_with_sources(placed, name=name)
    seen = seen_mesh_and_source_faces(mesh)
    if seen is None:
        remedy = "raise its materials' alpha to 0.5 or more, or name what else to `keep`"
        raise AssetError("is transparent everywhere: labels are of what hides at least half", remedy=remedy)
    surface, face = seen
    low, high = surface.bounds
    if not (np.ptp(contact_footprint(surface.vertices), axis=0) > 0).all():
        raise AssetError("is a sheet on its edge, with no length or no width to stand on", remedy="set its `up`")
    base = np.array([(low[0] + high[0]) / 2, (low[1] + high[1]) / 2, low[2]])
    standing = surface.with_vertices(surface.vertices - base)
    to_base = np.eye(4)
    to_base[:3, 3] = -base
    piece_part = np.full(len(pieces), -1)
    for i, number, why in zip(kept, parts.piece_part, parts.piece_why, strict=True):
        piece_part[i], roles[i] = number, replace(roles[i], use=names[number], why=why or roles[i].why)
    moving = [replace(row, pivot=xyz_tuple(np.array(row.pivot) - base)) for row in parts.moving]
    vertex_part = np.repeat([parts.piece_part[j] for j in order], [len(m.vertices) for m in placed])
    seen_part = np.empty(len(surface.vertices), dtype=vertex_part.dtype)
    seen_part[surface.faces] = vertex_part[mesh.faces[face, :1]]
    shape = VehicleShape(
        name=name,
        mesh=standing if surface is mesh else mesh.with_vertices(mesh.vertices - base),
        vertex_part=vertex_part,
        part_names=names,
        part_parent=np.array([-1, *(names.index(row.parent) for row in moving)]),
        part_pivot=np.array([np.zeros(3), *(row.pivot for row in moving)]),
        part_axis=np.array([(0.0, 0.0, 1.0), *(row.axis for row in moving)]),
        part_limits=np.array([(0.0, 0.0), *(row.limits for row in moving)]),
        vehicle_from_file=to_base @ vehicle_from_file,
        underside=vehicle_underside(standing).heights,
        seen=None if surface is mesh else standing,
        seen_part=seen_part,
    )
    marked = keypoints_from_empties(markers, [piece.chain for piece in whole.pieces], parts.piece_part)
    from_file = shape.vehicle_from_file
    shape = shape.with_keypoints({key: (transform_points(from_file, at[None])[0], part) for key, (at, part) in marked.items()})
    lying = _lying_doubt(shape) if wheels is None and options.up is None else None
    things, several = ((), list[Doubt]()) if options.keep else find_things_and_doubts(whole, meshes, others)
    doubts = tuple(filter(None, (upright.up.doubt, lying, forward.doubt, *several, *parts.doubts, *left_out)))
    axes = f"up is {upright.up.value}, {upright.up.why}; ahead is {forward_config_text(forward.value)}, {forward.why}"
    return BuiltVehicle(shape, roles, piece_part.tolist(), tuple(moving), axes, doubts, things), strays


def _lying_doubt(shape: VehicleShape) -> Doubt | None:
    """Return a doubt if a vehicle's mirror plane is level, as if it lay on its side."""
    points, size = shape.surface[0].vertices, shape.size_xyz
    gaps = [mirror_gap(points, axis) / max(float(size[axis]), 1e-30) for axis in (1, 2)]
    if not gaps[1] < MAX_LYING_GAP_SHARE <= gaps[0]:
        return None
    outer = [points[side * points[:, 1] > 0.3 * size[1]][:, [0, 2]] for side in (1, -1)]
    left, right = (float(np.ptp(one, axis=0).prod()) if len(one) else 0.0 for one in outer)
    up = shape.vehicle_from_file[1, :3] * (1 if left <= right else -1)  # toward the narrower side
    axis = max(UP_AXES, key=lambda name: float(z_up_rotation(name)[2, :3] @ up))
    axis = axis.removeprefix("-") if abs(left - right) < MAX_LYING_GAP_SHARE * max(left, right) else axis
    text = f'it is alike above and below, and not on its left and right; set up = "{axis}" if it lies on its side'
    return Doubt(DoubtKind.UP, text)


def _place_and_compact_mesh(mesh: Mesh, points: Float[np.ndarray, "v 3"], name: str) -> Mesh:
    """Remove vertices without faces, which aren't rendered and must not widen boxes."""
    return replace(mesh.with_vertices(points).take_mesh_faces(np.arange(len(mesh.faces))), name=name)


def build_scenery_and_wet_names(
    name: str, drawn: Evaluated, roles: Sequence[PieceRole], *, meters: Float[np.ndarray, "4 4"], options: Options
) -> tuple[Scenery, tuple[str, ...]]:
    """Build ground and obstacles about an origin in whole kilometers; also return names of partly wet ground."""
    meshes, pieces = drawn.meshes, drawn.pieces
    if wrong := unmatched_key_and_pattern(pieces, options):
        raise AssetError(
            f"{wrong[0]} = {wrong[1]!r} matches nothing; it contains {_quote_similar_names(wrong[1], pieces)}",
            remedy=NAME_CLUES,
        )
    ground = [i for i, role in enumerate(roles) if role.use == "ground"]
    obstacles = [i for i, role in enumerate(roles) if role.use in ("obstacle", "water")]
    if not ground and not obstacles:
        raise AssetError("nothing in it is rendered as ground or obstacle", remedy="check what is hidden from render")
    extent = np.array([pieces[i].bounds for i in ground or obstacles])
    middle = (extent[:, 0].min(axis=0) + extent[:, 1].max(axis=0)) / 2
    origin = np.round(middle / KILOMETER_M) * KILOMETER_M + 0.0
    shift = np.eye(4)
    shift[:3, 3] = -origin
    scenery_from_file = shift @ meters
    open_ = ground if options.water is None else []
    wet = dict.fromkeys(i for i in open_ if _is_partly_water(pieces[i], drawn, meters))
    merged = None
    if ground:
        placed = []
        for i in ground:
            mesh = _wet_or_dry_mesh(pieces[i].mesh, drawn, wet=False) if i in wet else meshes[pieces[i].mesh]
            placed.append(
                _place_and_compact_mesh(
                    mesh, transform_points(scenery_from_file @ pieces[i].pose, mesh.vertices), pieces[i].name
                )
            )
        merged, _ = merge_meshes_with_sources(placed, name=f"ground of {name}")
    instances = [*obstacles, *wet]
    shapes = [(pieces[i].mesh, i in wet) for i in instances]
    unique = sorted(set(shapes))
    position = {shape: at for at, shape in enumerate(unique)}
    shown = [_wet_or_dry_mesh(number, drawn, wet=True) if part else meshes[number] for number, part in unique]
    scenery = Scenery(
        name=name,
        origin=origin,
        ground=merged,
        ground_names=tuple(pieces[i].name for i in ground),
        obstacle_meshes=tuple(replace(mesh, extreme=mesh.extreme_vertex_indices()) for mesh in shown),
        instance_mesh=np.array([position[shape] for shape in shapes], np.int64),
        world_from_instance=scenery_from_file @ np.array([pieces[i].pose for i in instances]).reshape(-1, 4, 4),
        instance_names=tuple(pieces[i].name for i in instances),
        instance_gives_way=np.array([pieces[i].hair for i in instances], bool),
        instance_is_water=np.array([i in wet or roles[i].use == "water" for i in instances], bool),
        scenery_from_file=scenery_from_file,
    )
    return scenery, tuple(pieces[i].name for i in wet)


def _is_partly_water(piece: Piece, drawn: Evaluated, meters: Float[np.ndarray, "4 4"]) -> bool:
    """Return whether faces of ground with materials named like water are water: wide together, and mostly level."""
    if piece.mesh not in drawn.wet:
        return False
    part, meters_from_mesh = _wet_or_dry_mesh(piece.mesh, drawn, wet=True), meters @ piece.pose
    bounds = part.with_vertices(transform_points(meters_from_mesh, part.vertices)).bounds
    level, _ = level_share_and_area(part, meters_from_mesh)
    return is_wide_and_level(replace(piece, bounds=bounds, level=level), least=MIN_WATER_WIDTH_M)


def _wet_or_dry_mesh(number: int, drawn: Evaluated, *, wet: bool) -> Mesh:
    return drawn.meshes[number].take_mesh_faces(np.flatnonzero(drawn.wet[number] == wet))


def _quote_similar_names(wanted: str, pieces: Sequence[Piece]) -> str:
    names = sorted({piece.name for piece in pieces})
    alike = get_close_matches(wanted, names, n=8, cutoff=0.4)
    return ", ".join(repr(name) for name in (alike or names[:8])) or "nothing that is rendered"
