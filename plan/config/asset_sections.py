"""The config's `[assets]`: vehicles, distractors, and sceneries."""

from __future__ import annotations

import fnmatch
import re
from collections import Counter
from fnmatch import fnmatchcase
from pathlib import PurePosixPath, PureWindowsPath
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, field_validator, model_validator

from hulldown.base.arrays import are_finite_numbers
from hulldown.plan.config.section import AtLeastZero, Pair, Patterns, Section, is_omitted_default, range_validator
from hulldown.reading.pieces.options import DEFAULT_TEXTURE_SIZE

CACHE_NAME = ".hulldown-cache"
OWN_COLOR = "own"  # keeps a material's color in its file


def _parse_forward(value: Any) -> str | float | Pair | None:
    if value is None or (isinstance(value, str) and value in ("+x", "-x", "+y", "-y")):
        return value
    if are_finite_numbers([value]) and -360 <= value <= 360:
        return float(value)
    if isinstance(value, (list, tuple)) and len(value) in (2, 3) and are_finite_numbers(value) and any(value[:2]):
        return float(value[0]), float(value[1])
    raise ValueError("expected '+x', '-x', '+y', '-y', degrees from -360 to 360, or a vector [x, y]")


def _parse_pivot(value: Any) -> str | tuple[float, ...] | None:
    if value is None or (isinstance(value, str) and value):
        return value
    if isinstance(value, (list, tuple)) and len(value) == 3 and are_finite_numbers(value):
        return tuple(float(x) for x in value)
    raise ValueError("expected the name of an object, or [x, y, z] in the file's axes and units")


Forward = Annotated[str | float | Pair | None, BeforeValidator(_parse_forward)]
PivotPoint = Annotated[str | tuple[float, float, float] | None, BeforeValidator(_parse_pivot)]
Positive = Annotated[float, Field(gt=0)]
_Coordinate = Annotated[float, Field(ge=-1e9, le=1e9)]
Point = Annotated[tuple[_Coordinate, _Coordinate, _Coordinate], Field(strict=False)]


def _parse_color(value: object) -> str:
    if isinstance(value, str) and (value == OWN_COLOR or re.fullmatch("#[0-9a-fA-F]{6}", value)):
        return value.lower()
    raise ValueError("expected a color such as '#4b5320', or 'own' for the file's")


def _wrap_table_in_list(value: object) -> object:
    return [value] if isinstance(value, dict) else value


class PaintEntry(Section):
    """Patterns of a vehicle's materials, and their colors."""

    materials: Annotated[tuple[str, ...], Field(strict=False, min_length=1)]
    """patterns of materials to paint; the first table that matches applies"""
    colors: Annotated[tuple[Annotated[str, BeforeValidator(_parse_color)], ...], Field(strict=False, min_length=1)]
    """sRGB colors such as "#4b5320", of which one is drawn, or "own", the file's"""


Paint = Annotated[tuple[PaintEntry, ...], BeforeValidator(_wrap_table_in_list), Field(strict=False)]


class FileEntry(Section):
    """A file, with the name of the asset; by default the file's."""

    path: str
    """.blend, .glb, .gltf, .fbx, or .obj file"""
    name: str = ""
    """its name in plans and datasets; unique; default: the file's"""

    @model_validator(mode="before")
    @classmethod
    def _fill_name_from_path(cls, data: Any) -> Any:
        if isinstance(data, dict) and isinstance(path := data.get("path"), str):
            stem = (PureWindowsPath(path) if "\\" in path else PurePosixPath(path)).stem
            return {**data, "name": data.get("name") or stem}
        return data


class ModelEntry(FileEntry):
    """A file with a vehicle, and how that is found and posed in it."""

    allow_missing: bool = False
    """plan it even if textures or libraries are missing, which renders magenta"""
    forward: Forward = Field(default=None, examples=["+x"])
    """where its nose points once z is up: "+x", "-x", "+y", "-y", degrees counterclockwise from +x, or [x, y];
    default: by wheels, gun, and names"""
    up: Literal["z", "-z", "y", "-y", "x", "-x"] | None = Field(default=None, examples=["z"])
    """the axis that points up; default: by the file and the wheels"""
    scale: Positive | None = Field(default=None, examples=[1.0])
    """meters per unit of the file; default: from the file"""
    keep: Patterns = ()
    """patterns of objects that belong to the vehicle"""
    drop: Patterns = ()
    """patterns of objects that don't belong to the vehicle"""
    turret: str | None = Field(default=None, examples=["turret*"])
    """pattern of objects that turn; "" for none; default: by name"""
    gun: str | None = Field(default=None, examples=["gun*"])
    """pattern of objects that rise; "" for none; default: by name"""
    turret_pivot: PivotPoint = Field(default=None, examples=[[0.0, 0.0, 2.0]])
    """point that the turret turns about: [x, y, z] in the file's axes and units, or an object's name; default: by
    origins or shape"""
    gun_pivot: PivotPoint = Field(default=None, examples=[[1.0, 0.0, 2.0]])
    """point that the gun rises about, in the same form"""
    turret_limits_deg: Annotated[Pair | None, range_validator(-360.0, 360.0, optional=True)] = Field(
        default=None, examples=[[-180, 180]]
    )
    """turret's turn from its direction in the file, left positive; default: [-180, 180]"""
    gun_limits_deg: Annotated[Pair | None, range_validator(-90.0, 90.0, optional=True)] = Field(
        default=None, examples=[[-5, 20]]
    )
    """gun's rise from its direction in the file, up positive; default: [-5, 20]"""
    keypoints: dict[str, Point] | None = Field(
        default=None, examples=[{"mirror": [1.0, 0.9, 1.8]}], exclude_if=is_omitted_default
    )
    """points to label, by name: [x, y, z] in the file's axes and units; see annotate.keypoints"""
    paint: Paint = ()
    """tables of `materials`, patterns of their names, and `colors`, of which one is drawn"""
    sceneries: Patterns = ()
    """patterns of its sceneries; empty: all"""

    def allows_scenery(self, scenery: str) -> bool:
        """Return whether the vehicle may be placed on the scenery of this name."""
        return not self.sceneries or any(fnmatchcase(scenery, pattern) for pattern in self.sceneries)


class VehicleEntry(ModelEntry):
    """One `[[assets.vehicles]]`: a model and its class."""

    category: str = Field(min_length=1)
    """its class"""
    weight: AtLeastZero = Field(default=1.0, exclude_if=(1.0).__eq__)
    """how often it's planned, relative to others of its class"""


class DistractorEntry(ModelEntry):
    """One `[[assets.distractors]]`: an object that is never a target, with a weight and an optional class."""

    category: str | None = Field(default=None, min_length=1, examples=["bus"])
    """its class, if it's labeled; budgets don't count it"""
    weight: AtLeastZero = 1.0
    """how often it's drawn, relative to others"""


class SceneryEntry(FileEntry):
    """One `[[assets.sceneries]]`: a file, the roles of its objects, and how often it is drawn."""

    path: str
    """.blend, .glb, .gltf, .fbx, or .obj file, or elevations in a GeoTIFF (.tif)"""
    up: Literal["z", "y"] | None = Field(default=None, examples=["z"])
    """the axis that points up; default: by the file"""
    scale: Positive | None = Field(default=None, examples=[1.0])
    """meters per unit, or per unit of elevation; default: from the file"""
    area: tuple[float, float, float, float] | None = Field(
        default=None, strict=False, examples=[[447000.0, 5411000.0, 449000.0, 5413000.0]], exclude_if=is_omitted_default
    )
    """[west, south, east, north] of a GeoTIFF to read, in its coordinates; default: all"""
    texture: str | None = Field(default=None, examples=["ortho.tif"], exclude_if=is_omitted_default)
    """a GeoTIFF's orthophoto, also a GeoTIFF; default: colors by slope"""
    ground: Patterns = ()
    """patterns of objects that are its ground"""
    not_ground: Patterns = ()
    """patterns of objects that aren't its ground"""
    water: Patterns | None = Field(default=None, examples=[["lake*"]])
    """patterns of all its water; [] for none; default: by name, material, and shape"""
    drop: Patterns = ()
    """patterns of objects to leave out"""
    weight: AtLeastZero = 1.0
    """how often it's drawn, relative to others"""

    @field_validator("area")
    @classmethod
    def _refuse_empty_area(cls, area: tuple[float, ...] | None) -> tuple[float, ...] | None:
        if area and not (area[0] < area[2] and area[1] < area[3]):
            raise ValueError("expected [west, south, east, north] with west < east and south < north")
        return area

    @model_validator(mode="after")
    def _refuse_geotiff_keys(self) -> SceneryEntry:
        if (self.area or self.texture) and not self.path.lower().endswith((".tif", ".tiff")):
            raise ValueError("`area` and `texture` are for GeoTIFFs (.tif)")
        return self


class AssetsSection(Section):
    """Files to read; paths are relative to the config's folder."""

    cache: str = CACHE_NAME
    """folder for what was read"""
    texture_size: int = Field(default=DEFAULT_TEXTURE_SIZE, ge=1, le=16384)
    """longer side, in texels, of stored leaf textures"""
    hdris: Annotated[tuple[str, ...], Field(strict=False, min_length=1)] = ("hdris/*.exr",)
    """patterns of .exr or .hdr files: light and backdrop"""
    vehicles: Annotated[tuple[VehicleEntry, ...], Field(strict=False, min_length=1)]
    """a [[assets.vehicles]] table for each"""
    sceneries: Annotated[tuple[SceneryEntry, ...], Field(strict=False, min_length=1)]
    """a [[assets.sceneries]] table for each"""
    distractors: Annotated[tuple[DistractorEntry, ...], Field(strict=False)] = ()
    """a [[assets.distractors]] table for each object that isn't a target"""

    @property
    def entries(self) -> tuple[VehicleEntry | DistractorEntry | SceneryEntry, ...]:
        """All vehicles, distractors, and sceneries."""
        return (*self.vehicles, *self.distractors, *self.sceneries)

    @model_validator(mode="after")
    def _refuse_asset_conflicts(self) -> AssetsSection:
        vehicles = "vehicles and distractors" if self.distractors else "vehicles"
        for kind, names in (
            (vehicles, [entry.name for entry in (*self.vehicles, *self.distractors)]),
            ("sceneries", [entry.name for entry in self.sceneries]),
        ):
            for name, count in Counter(names).items():
                if count > 1:
                    raise ValueError(f"{count} {kind} are called {name!r}; give each its own `name`")
        sceneries = [entry.name for entry in self.sceneries]
        for entry in self.distractors:
            if unknown := [pattern for pattern in entry.sceneries if not fnmatch.filter(sceneries, pattern)]:
                raise ValueError(f"distractor {entry.name!r}: sceneries: {unknown[0]!r} matches none of {sceneries}")
        if not any(e.weight for e in self.sceneries):
            raise ValueError("all sceneries have weight 0; expected at least one above 0")
        return self
