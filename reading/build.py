"""From what Blender drew to a vehicle or a scenery: plain arrays, no Blender."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from assets.scenery import Scenery
from assets.vehicle import VehicleShape
from geometry.errors import AssetError
from geometry.meshes import Mesh, merge
from geometry.transforms import apply, rotation_z
from reading.parts import GUN_PART, TURRET_PART, Parts, find_parts
from reading.report import PartRow
from reading.roles import Link, Piece, Role, scenery_roles, vehicle_roles

YAW = {"+x": 0.0, "+y": -np.pi / 2, "-x": np.pi, "-y": np.pi / 2}
Z_FROM_Y_UP = np.array([[1.0, 0, 0, 0], [0, 0, -1.0, 0], [0, 1.0, 0, 0], [0, 0, 0, 1.0]])
KILOMETRE = 1000.0
TEXTURE_SIZE = 1024


@dataclass(frozen=True, slots=True)
class Options:
    """How to read a file; None leaves it to the file.

    Parameters
    ----------
    up
        "z" or "y"; Blender's files are z up.
    scale
        Metres to one unit of the file.
    forward
        Where a vehicle's nose points in the file once z is up.
    keep, drop
        Patterns of what belongs to a vehicle and what does not.
    turret, gun
        Pattern of a vehicle's turret and gun; "" for none.
    include, exclude
        Patterns of what is a scenery's ground and what is not.
    texture_size
        Texels of the longer side that a texture which cuts out is kept at.
    """

    up: str | None = None
    scale: float | None = None
    forward: str = "+x"
    keep: tuple[str, ...] = ()
    drop: tuple[str, ...] = ()
    turret: str | None = None
    gun: str | None = None
    include: tuple[str, ...] = ()
    exclude: tuple[str, ...] = ()
    texture_size: int = TEXTURE_SIZE


def metres_from_file(unit: float, up: str) -> Float[np.ndarray, "4 4"]:
    """From a file's coordinates to metres, z up; where the origin is stays."""
    return np.diag([unit, unit, unit, 1.0]) @ (Z_FROM_Y_UP if up == "y" else np.eye(4))


@dataclass(frozen=True, eq=False, slots=True)
class BuiltVehicle:
    """A vehicle, for each piece its role and part (-1 for none), and the parts that turn."""

    shape: VehicleShape
    roles: list[Role]
    piece_part: list[int]
    parts: tuple[PartRow, ...]


@dataclass(frozen=True, eq=False, slots=True)
class BuiltScenery:
    """A scenery and for each piece its role."""

    scenery: Scenery
    roles: list[Role]


def build_vehicle(
    name: str,
    meshes: Sequence[Mesh],
    pieces: Sequence[Piece],
    markers: Sequence[tuple[Link, ...]],
    *,
    metres: Float[np.ndarray, "4 4"],
    options: Options,
) -> BuiltVehicle:
    """The vehicle among the pieces, its parts merged into one mesh (paper, section 2.1.3).

    Raises
    ------
    AssetError
        If nothing is left of it, or the config names a turret or gun that is not there.
    """
    roles = vehicle_roles(pieces, keep=options.keep, drop=options.drop)
    kept = [i for i, role in enumerate(roles) if role.use == "vehicle"]
    if not kept:
        there = ", ".join(sorted({repr(p.name) for p in pieces})[:8]) or "nothing that is rendered"
        raise AssetError(f"no vehicle is left after clean-up; in it is {there}", remedy="name what to `keep`")
    turned = np.eye(4)
    turned[:3, :3] = np.round(rotation_z(YAW[options.forward]), 12)
    upright = turned @ metres
    points = [apply(upright @ pieces[i].pose, meshes[pieces[i].mesh].vertices) for i in kept]
    parts = find_parts(
        [pieces[i] for i in kept],
        points,
        markers,
        vehicle_from_file=upright,
        turret=options.turret,
        gun=options.gun,
    )
    for key, part in ((options.turret, TURRET_PART), (options.gun, GUN_PART)):
        if key and part not in parts.names:
            there = ", ".join(sorted({repr(pieces[i].name) for i in kept})[:8])
            raise AssetError(f"{part} = {key!r} matches nothing, or everything; in it is {there}")
    order = np.argsort(parts.piece_part, kind="stable")
    placed = [_compact(meshes[pieces[kept[j]].mesh], points[j], pieces[kept[j]].name) for j in order]
    mesh, _ = merge(placed, name=name)
    low, high = mesh.bounds
    underside = np.array([(low[0] + high[0]) / 2, (low[1] + high[1]) / 2, low[2]])
    to_underside = np.eye(4)
    to_underside[:3, 3] = -underside
    for i, why in zip(kept, parts.piece_why, strict=True):
        if why:
            roles[i] = Role("vehicle", why)
    piece_part = np.full(len(pieces), -1)
    piece_part[kept] = parts.piece_part
    shape = VehicleShape(
        name=name,
        mesh=mesh.at(mesh.vertices - underside),
        vertex_part=np.repeat([parts.piece_part[j] for j in order], [len(m.vertices) for m in placed]),
        part_names=parts.names,
        part_parent=np.array(parts.parent),
        part_pivot=np.concatenate([np.zeros((1, 3)), parts.pivot[1:] - underside]),
        part_axis=parts.axis,
        part_limits=parts.limits,
        vehicle_from_file=to_underside @ upright,
    )
    return BuiltVehicle(shape, roles, piece_part.tolist(), _part_rows(shape, parts))


def _compact(mesh: Mesh, points: Float[np.ndarray, "v 3"], name: str) -> Mesh:
    """Without vertices that no face uses: they are not rendered and must not count for boxes."""
    return replace(mesh.at(points).of_faces(np.arange(len(mesh.faces))), name=name)


def _part_rows(shape: VehicleShape, parts: Parts) -> tuple[PartRow, ...]:
    return tuple(
        PartRow(
            name=shape.part_names[i],
            parent=shape.part_names[shape.part_parent[i]],
            pivot=_three(shape.part_pivot[i]),
            axis=_three(shape.part_axis[i]),
            limits=(float(shape.part_limits[i, 0]), float(shape.part_limits[i, 1])),
            why=parts.why[i],
        )
        for i in range(1, len(shape.part_names))
    )


def _three(vector: np.ndarray) -> tuple[float, float, float]:
    return float(vector[0]), float(vector[1]), float(vector[2])


def build_scenery(
    name: str, meshes: Sequence[Mesh], pieces: Sequence[Piece], *, metres: Float[np.ndarray, "4 4"], options: Options
) -> BuiltScenery:
    """Ground and obstacles among the pieces; the ground-plane inventory is paper, section 2.1.5.

    The origin is the middle of the ground (of everything, if there is no ground), rounded to whole kilometres: zero
    for what is modelled around zero, and near enough for float32 where the file is in map coordinates.

    Raises
    ------
    AssetError
        If the file draws nothing.
    """
    roles = scenery_roles(pieces, include=options.include, exclude=options.exclude)
    ground = [i for i, role in enumerate(roles) if role.use == "ground"]
    obstacles = [i for i, role in enumerate(roles) if role.use == "obstacle"]
    if not ground and not obstacles:
        raise AssetError("nothing in it is rendered as ground or obstacle", remedy="check what is hidden from render")
    extent = np.array([pieces[i].bounds for i in ground or obstacles])
    middle = (extent[:, 0].min(axis=0) + extent[:, 1].max(axis=0)) / 2
    origin = np.round(middle / KILOMETRE) * KILOMETRE + 0.0
    shift = np.eye(4)
    shift[:3, 3] = -origin
    scenery_from_file = shift @ metres
    merged, source = None, np.empty(0, np.int64)
    if ground:
        placed = [
            _compact(
                meshes[pieces[i].mesh],
                apply(scenery_from_file @ pieces[i].pose, meshes[pieces[i].mesh].vertices),
                pieces[i].name,
            )
            for i in ground
        ]
        merged, source = merge(placed, name=f"ground of {name}")
    unique = sorted({pieces[i].mesh for i in obstacles})
    position = {number: at for at, number in enumerate(unique)}
    scenery = Scenery(
        name=name,
        origin=origin,
        ground=merged,
        ground_names=tuple(pieces[i].name for i in ground),
        face_ground=source,
        obstacle_meshes=tuple(meshes[i] for i in unique),
        instance_mesh=np.array([position[pieces[i].mesh] for i in obstacles], np.int64),
        world_from_instance=scenery_from_file @ np.array([pieces[i].pose for i in obstacles]).reshape(-1, 4, 4),
        instance_names=tuple(pieces[i].name for i in obstacles),
        instance_gives_way=np.array([pieces[i].hair for i in obstacles], bool),
        scenery_from_file=scenery_from_file,
    )
    return BuiltScenery(scenery, roles)
