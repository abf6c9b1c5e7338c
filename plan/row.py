"""The schema of a plan file: fields, ranges, rounding, nullability; its docs and datasets' records follow from it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, partial
from typing import Annotated, Any, Literal, NamedTuple, get_type_hints

import msgspec
import numpy as np
from jaxtyping import Float
from msgspec import Meta, Struct

from hulldown.assets.plan_assets import AssetSource, GeometrySource, HdriSource
from hulldown.camera.cameras import Cameras
from hulldown.camera.intrinsics import Intrinsics
from hulldown.plan.coats import Coat
from hulldown.plan.given_poses import MAX_COORDINATE_M, GivenPoses
from hulldown.plan.picture_names import PICTURE_NAME
from hulldown.weather.kinds import Weather

PLAN_FORMAT = 4


def _decimal_rounder(decimals: int) -> Callable[[np.ndarray], np.ndarray]:
    """Return a function that rounds to this many decimals; adding zero turns -0.0 into 0.0."""
    return lambda values: np.round(values, decimals) + 0.0


def _round_poses(values: np.ndarray) -> np.ndarray:
    rounded = _decimal_rounder(12)(values)
    rounded[..., :3, 3] = _decimal_rounder(9)(values[..., :3, 3])
    return rounded


def _round_boxes(values: np.ndarray) -> np.ndarray:
    """Round both corners to 1e-6 pixels, so that a box that ends at the frame's side still ends there."""
    low = _decimal_rounder(6)(values[..., :2])
    high = _decimal_rounder(6)(values[..., :2] + values[..., 2:])
    return np.concatenate([low, _decimal_rounder(6)(high - low)], axis=-1)


def _field_kind_meta(
    expected: str, to: str = "", rounding: Callable[[np.ndarray], np.ndarray] | None = None, **limits: Any
) -> Meta:
    return Meta(extra={"expected": expected, "to": to, "rounding": rounding}, **limits)


def _field_meaning_meta(text: str, *, recorded: bool = True) -> Meta:
    return Meta(description=text, extra={"recorded": recorded})


_plan_only = partial(_field_meaning_meta, recorded=False)  # of a field of plans alone


Pixel = Annotated[float, Meta(ge=-1e12, le=1e12)]
Pixels = Annotated[float, Meta(ge=0, le=1e12)]


class Box(NamedTuple):
    """A box in COCO's format: upper left corner, width, and height in pixels."""

    x: Pixel
    y: Pixel
    width: Pixels
    height: Pixels


Meter = Annotated[float, Meta(ge=-1e6, le=1e6)]


class Bounds(NamedTuple):
    """Lowest and highest corner of a box along the axes of a vehicle, meters."""

    low: tuple[Meter, Meter, Meter]
    high: tuple[Meter, Meter, Meter]


class OnMap(Struct, frozen=True, kw_only=True, gc=False):
    """A vehicle's place on a map: meters to 1e-6, and degrees of WGS 84 to 1e-9."""

    crs: str
    easting: float
    northing: float
    longitude: float
    latitude: float


Name = Annotated[str, _field_kind_meta("a name", max_length=4096)]
NameOrNone = Annotated[Annotated[str, Meta(max_length=4096)] | None, _field_kind_meta("a name or null")]
LabelState = Literal["full", "ignored", "none"]
RoleName = Annotated[Literal["target", "companion", "distractor"], _field_kind_meta('"target", "companion" or "distractor"')]
Count = Annotated[int, _field_kind_meta("a whole number >= 0", ge=0, le=2**53)]
Number = Annotated[int, _field_kind_meta("a whole number >= 1", ge=1, le=2**53 + 1)]
NumberOrNone = Annotated[Annotated[int, Meta(ge=1, le=2**53)] | None, _field_kind_meta("a whole number >= 1")]
Size = Annotated[int, _field_kind_meta("a whole number from 1 to 65536", ge=1, le=65536)]
Seed = Annotated[int, _field_kind_meta("a whole number", ge=-(2**63), le=2**63 - 1)]
Share = Annotated[float, _field_kind_meta("a number from 0 to 1", "1e-9", _decimal_rounder(9), ge=0, le=1)]
AtLeastZero = Annotated[float, _field_kind_meta("a number >= 0", "1e-9", _decimal_rounder(9), ge=0, le=1e9)]
Slope = Annotated[float, _field_kind_meta("a number from 0 to 90", "1e-9 degrees", _decimal_rounder(9), ge=0, le=90)]
YawDegrees = Annotated[
    float, _field_kind_meta("a number from -360 to 360", "1e-9 degrees", _decimal_rounder(9), ge=-360, le=360)
]
FieldOfView = Annotated[
    float, _field_kind_meta("a number from 1e-6 to 179.999", "1e-12 degrees", _decimal_rounder(12), ge=1e-6, le=179.999)
]
Pose = Annotated[np.ndarray, _field_kind_meta("a 4x4 matrix (rigid)", "1e-9 m, rotation to 1e-12", _round_poses)]
_BOX_FORMAT = "[x, y, width, height]"
FrameOrNone = Annotated[Box | None, _field_kind_meta(f"{_BOX_FORMAT} or null", "1e-6 pixels", _round_boxes)]
_Pinhole = Annotated[float, Meta(ge=-1e9, le=1e9)]
_Three = tuple[_Pinhole, _Pinhole, _Pinhole]
_Bend = Annotated[float, Meta(ge=-1e6, le=1e6)]
MatrixOrNone = Annotated[tuple[_Three, _Three, _Three] | None, _field_kind_meta("a 3x3 matrix")]
LensOrNone = Annotated[tuple[_Bend, _Bend, _Bend, _Bend, _Bend] | None, _field_kind_meta("[k1, k2, p1, p2, k3]")]
Horizon = Annotated[Annotated[float, Meta(ge=0, le=90)] | None, _field_kind_meta("a number from 0 to 90, or null")]
ExposureValue = Annotated[float, _field_kind_meta("a number from -32 to 32", "1e-4", _decimal_rounder(4), ge=-32, le=32)]
Kelvin = Annotated[float, _field_kind_meta("a number from -2500 to 13500", "1e-3 K", _decimal_rounder(3), ge=-2500, le=13500)]
Angles = Annotated[
    dict[str, Annotated[float, Meta(ge=-1e6, le=1e6)]],
    _field_kind_meta("angles by name", "1e-12 radians", _decimal_rounder(12)),
]
RowWeather = Annotated[
    Weather | None, _field_kind_meta('null or {"visibility_m": meters above 0, "kind": ...}', "1e-9", _decimal_rounder(9))
]
VehicleBounds = Annotated[Bounds, _field_kind_meta("[[x, y, z], [x, y, z]]", "1e-9 m", _decimal_rounder(9))]
Reasons = Annotated[dict[str, Annotated[int, Meta(ge=0)]], _field_kind_meta("counts by reason")]
Coats = Annotated[list[Coat], _field_kind_meta("a list of coats of paint")]
PlaceOrNone = Annotated[OnMap | None, _field_kind_meta('{"crs": a name, "easting": meters, ...}')]
FileName = Annotated[str, _field_kind_meta("a path like images/1.png", pattern=PICTURE_NAME)]
_Files = _field_kind_meta("files by name")


class FollowedPhotograph(Struct, frozen=True):
    """File names of an image's sampled photograph and of the one that replaced it; None: configured ranges."""

    sampled: str
    photograph: str | None


class PlannedVehicle(Struct, frozen=True, eq=False, kw_only=True, gc=False, omit_defaults=True):
    """A vehicle in an image: its role, model, pose, and labels; see docs/plan-file.md."""

    role: Annotated[RoleName, _plan_only("companions are of `[[assets.vehicles]]`, distractors of `[[assets.distractors]]`")]
    vehicle: Annotated[Name, _field_meaning_meta("the vehicle's name")]
    category: Annotated[NameOrNone, _plan_only("its class, or null")]
    world_from_vehicle: Annotated[Pose, _field_meaning_meta("its pose, in meters")]
    articulation: Annotated[Angles, _field_meaning_meta("angles of its parts, in radians")]
    bbox: Annotated[FrameOrNone, _field_meaning_meta("the surface in the frame")]
    bbox_amodal: Annotated[FrameOrNone, _field_meaning_meta("all of the surface in front of the camera")]
    visible_fraction: Annotated[Share, _field_meaning_meta("unhidden share of its outline in the frame")]
    truncated_fraction: Annotated[Share, _field_meaning_meta("share of `bbox_amodal` that the frame cuts off")]
    slope_deg: Annotated[Slope, _plan_only("inclination of the vehicle")]
    gap: Annotated[AtLeastZero, _plan_only("largest distance to the ground below it, in meters")]
    penetration: Annotated[AtLeastZero, _plan_only("largest height of the ground above its underside, in meters")]
    tries: Annotated[Count, _plan_only("places tried for it, including its own")]
    label: Annotated[
        LabelState, _field_kind_meta('"full", "ignored" or "none"'), _plan_only("its label; ignored if it shows too little")
    ]
    bounds: Annotated[VehicleBounds, _plan_only("lowest and highest corner in its own frame, parts turned")]
    paint: Annotated[Coats, _field_meaning_meta("`materials`, `color`")]
    air_contrast: Annotated[Share, _field_meaning_meta("share of its contrast left after haze")]
    geo: Annotated[PlaceOrNone, _field_meaning_meta("place on the map, on a [GeoTIFF](terrain.md)")] = None
    track_id: Annotated[NumberOrNone, _field_meaning_meta("the same in all images of a `sequence`, and in no others")] = None


Vehicles = Annotated[list[PlannedVehicle], _field_kind_meta("a list of vehicles")]


class Row(Struct, frozen=True, eq=False, kw_only=True, gc=False, omit_defaults=True):
    """An image of a plan, see docs/plan-file.md; the camera is framed on the target, which backgrounds leave out."""

    index: Annotated[Count, _plan_only("0, 1, 2, ...")]
    image_id: Annotated[Number, _plan_only("`index + 1`")]
    file_name: Annotated[FileName, _plan_only("the picture's path; unique, ignoring case")]
    scenery: Annotated[Name, _field_meaning_meta("the scenery's name")]
    position: Annotated[Count, _field_meaning_meta("number of the position: one pose of a vehicle, with several shots")]
    shot: Annotated[Count, _field_meaning_meta("0, 1, 2, ... in each position")]
    world_from_camera: Annotated[Pose, _field_meaning_meta("the camera's pose, in meters")]
    fov_x_deg: Annotated[FieldOfView, _field_meaning_meta("horizontal field of view")]
    K: Annotated[
        MatrixOrNone, _field_meaning_meta("camera matrix in pixels, from the corner; only with `camera.intrinsics`")
    ] = None
    dist: Annotated[LensOrNone, _field_meaning_meta("OpenCV's distortion coefficients; only with `K`")] = None
    like: Annotated[
        FollowedPhotograph | None,
        _field_kind_meta("two names"),
        _plan_only(
            "file names: `sampled`, and `photograph`, which the camera follows (another one, or null, where limits "
            "refuse it); only if one was sampled"
        ),
    ] = None
    sequence: Annotated[
        NameOrNone, _field_meaning_meta("name of the sequence whose frame `shot` this is; only with `plan --poses`")
    ] = None
    width: Annotated[Size, _field_meaning_meta("of the picture, in pixels")]
    height: Annotated[Size, _field_meaning_meta("of the picture, in pixels")]
    hdri: Annotated[Name, _field_meaning_meta("the HDRI's name")]
    hdri_yaw_deg: Annotated[YawDegrees, _field_meaning_meta("its turn, counterclockwise seen from above")]
    strength: Annotated[AtLeastZero, _field_meaning_meta("factor on its brightness")]
    horizon_deg: Annotated[
        Horizon, _field_meaning_meta("elevation whose color continues below it; null: the whole HDRI is visible")
    ]
    exposure_ev: Annotated[ExposureValue, _field_meaning_meta("exposure of the picture")]
    white_balance_k: Annotated[Kelvin, _field_meaning_meta("white balance minus 6500 K; more is warmer")]
    weather: Annotated[RowWeather, _field_meaning_meta("null: clear and dry")]
    sample_seed: Annotated[Seed, _field_meaning_meta("seed of Cycles' noise")]
    background: Annotated[
        bool, _field_kind_meta("true or false"), _field_meaning_meta("whether the image shows no target (see below)")
    ]
    planned: Annotated[Vehicles, _plan_only("the target, then companions, then distractors")]
    rejected: Annotated[Reasons, _plan_only("refused tries; refused places only in a position's first shot")]
    left_out: Annotated[Count, _plan_only("companions and distractors that found no room")]

    @property
    def target(self) -> PlannedVehicle:
        """The vehicle that the camera is framed on, even if the picture leaves it out."""
        return self.planned[0]

    @property
    def companions(self) -> list[PlannedVehicle]:
        """The target's companions."""
        return [vehicle for vehicle in self.planned if vehicle.role == "companion"]

    @property
    def distractors(self) -> list[PlannedVehicle]:
        """The distractors beside the target."""
        return [vehicle for vehicle in self.planned if vehicle.role == "distractor"]

    @property
    def hides_target(self) -> bool:
        """Whether the target is left out of the picture."""
        return self.background and self.target.category is not None

    @property
    def vehicles(self) -> list[PlannedVehicle]:
        """The vehicles in the picture: the target or a distractor in its place, companions, and distractors."""
        return self.planned[1:] if self.hides_target else self.planned

    @property
    def labeled(self) -> list[PlannedVehicle]:
        """The vehicles with an annotation, including ignored ones."""
        return [vehicle for vehicle in self.vehicles if vehicle.label != "none"]

    @property
    def intrinsics(self) -> Intrinsics:
        """Image size, and field of view or calibration."""
        return Intrinsics.from_record_fields(self.width, self.height, fov_x_deg=self.fov_x_deg, K=self.K, dist=self.dist)

    @property
    def camera(self) -> Cameras:
        """The camera in the world."""
        return Cameras(self.intrinsics, self.world_from_camera)


class ModelSource(GeometrySource, frozen=True, kw_only=True):
    """The file of a vehicle or distractor, and its class, which a distractor may lack."""

    category: str | None


class ScenerySource(GeometrySource, frozen=True, kw_only=True):
    """The file of a scenery, and the origin of the plan's world in its coordinates."""

    origin: tuple[float, float, float]


class LeftOut(Struct, frozen=True, kw_only=True):
    """A vehicle that isn't planned on a scenery, and why."""

    vehicle: str
    scenery: str
    why: str


class Header(Struct, frozen=True, kw_only=True, omit_defaults=True):
    """The first line of a plan; `Config.of` reads `config`."""

    hulldown_plan: Annotated[int, _field_kind_meta("4"), _field_meaning_meta("format version")]
    images: Annotated[Count, _field_meaning_meta("number of lines that follow")]
    seed: Annotated[int, _field_kind_meta("a whole number >= 0", ge=0, le=2**63 - 1), _field_meaning_meta("the config's")]
    root: Annotated[Name, _field_meaning_meta("folder of the config, relative to the plan; paths below are relative to it")]
    config: Annotated[dict[str, object], _field_kind_meta("a table"), _field_meaning_meta("the config with all defaults")]
    vehicles: Annotated[
        dict[str, ModelSource], _Files, _field_meaning_meta("`path`, `sha256`, `files`, `geometry`, `category`")
    ]
    sceneries: Annotated[
        dict[str, ScenerySource],
        _Files,
        _field_meaning_meta("`path`, `sha256`, `files`, `geometry`, `origin`: the world's, in the file's coordinates"),
    ]
    hdris: Annotated[dict[str, HdriSource], _Files, _field_meaning_meta("`path`, `sha256`, `mended_sha256`")]
    distractors: Annotated[
        dict[str, ModelSource], _Files, _field_meaning_meta("`path`, `sha256`, `files`, `geometry`, `category` or null")
    ]
    versions: Annotated[
        dict[str, str],
        _field_kind_meta("versions by name"),
        _field_meaning_meta("of Python, Blender (`bpy`), and the libraries"),
    ]
    left_out: Annotated[
        list[LeftOut], _field_kind_meta("a list of pairs"), _field_meaning_meta("without a place: `vehicle`, `scenery`, `why`")
    ]
    photographs: Annotated[
        AssetSource | None, _field_kind_meta("a file"), _field_meaning_meta("`path` and `sha256`; only with `camera.like`")
    ] = None
    poses: Annotated[
        GivenPoses | None,
        _field_kind_meta("`path` and `lines`"),
        _field_meaning_meta("the file's name and lines; only with `plan --poses`"),
    ] = None

    @property
    def categories(self) -> list[str]:
        """The classes, those of vehicles first, in the order of the config."""
        models = (*self.vehicles.values(), *self.distractors.values())
        return list(dict.fromkeys(model.category for model in models if model.category is not None))


@dataclass(frozen=True, slots=True)
class RowField:
    """How one field of rows or vehicles is declared."""

    expected: str
    to: str  # to, rounding: its rounding in words, empty if there is none, and as a function of arrays
    rounding: Callable[[np.ndarray], np.ndarray] | None
    meaning: str
    recorded: bool
    optional: bool  # whether it's left out of a line if it's None


@cache
def row_fields(kind: type[Struct]) -> dict[str, RowField]:
    """Return the fields of a declared type in the order of a line."""
    hints = get_type_hints(kind, include_extras=True)
    declared = {}
    for field in msgspec.structs.fields(kind):
        metas: tuple[Meta, ...] = hints[field.name].__metadata__
        extra = {key: value for meta in metas for key, value in (meta.extra or {}).items()}
        declared[field.name] = RowField(meaning=metas[-1].description or "", optional=field.default is None, **extra)
    return declared


def round_field(key: str, values: Float[np.ndarray, "..."]) -> Float[np.ndarray, "..."]:
    """Round values of a field of rows or vehicles as they're written: (..., 4, 4) poses, (..., 4) boxes, or numbers."""
    rounding = (row_fields(Row) | row_fields(PlannedVehicle))[key].rounding
    assert rounding is not None, key
    return rounding(values)


_ROTATION_TOLERANCE = 1e-6  # for plans that were edited by hand
_Matrix = tuple[tuple[float, float, float, float], ...]


def decode_pose(_: type, value: object) -> np.ndarray:
    """Decode a pose from JSON, the only type here that msgspec lacks."""
    try:
        (a, b, c, x), (d, e, f, y), (g, h, i, z), last = msgspec.convert(value, _Matrix)
    except (msgspec.ValidationError, ValueError, SystemError):  # SystemError: an integer beyond the largest float
        raise ValueError("no 4x4 matrix") from None
    if not (
        abs(a * a + b * b + c * c - 1.0) <= _ROTATION_TOLERANCE
        and abs(d * d + e * e + f * f - 1.0) <= _ROTATION_TOLERANCE
        and abs(g * g + h * h + i * i - 1.0) <= _ROTATION_TOLERANCE
        and abs(a * d + b * e + c * f) <= _ROTATION_TOLERANCE
        and abs(a * g + b * h + c * i) <= _ROTATION_TOLERANCE
        and abs(d * g + e * h + f * i) <= _ROTATION_TOLERANCE
        and a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g) > 0.0
        and last == (0.0, 0.0, 0.0, 1.0)
        and max(abs(x), abs(y), abs(z)) <= MAX_COORDINATE_M
    ):
        raise ValueError("not rigid")
    return np.array([[a, b, c, x], [d, e, f, y], [g, h, i, z], last])


decode_row = msgspec.json.Decoder(Row, dec_hook=decode_pose).decode
decode_header = msgspec.json.Decoder(Header).decode
_encoder = msgspec.json.Encoder(enc_hook=np.ndarray.tolist)


def encode_line(record: Struct) -> bytes:
    """Encode a header, row, or vehicle as a line; floats have the fewest digits that read back exactly."""
    return _encoder.encode(record) + b"\n"


def encode_rows(rows: list[Row]) -> bytes:
    """Return a line for each row."""
    return b"".join(map(encode_line, rows))
