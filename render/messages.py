"""What a worker inside Blender is told: paths and numbers, nothing to look up; as JSON between two processes.

Read on both sides, so it needs numpy only.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

from hulldown.camera.intrinsics import Intrinsics
from hulldown.camera.sensor import Sensor
from hulldown.camera.weather_kinds import Weather

Matrix = list[list[float]]  # (4, 4)


@dataclass(frozen=True, slots=True)
class SceneryInput:
    """A scenery to open.

    Parameters
    ----------
    path
        Its .blend.
    scenery_from_file
        (4, 4) where its coordinates go, in meters.
    standing
        Objects planned as ground or obstacles, which are rendered whatever they or their meshes are called.
    removed
        Objects that the config drops, which are not rendered.
    """

    path: str
    scenery_from_file: Matrix
    standing: list[str]
    removed: list[str]


@dataclass(frozen=True, slots=True)
class PaintInput:
    """How a material of a vehicle is painted.

    Parameters
    ----------
    material
        Its name in the vehicle's file.
    mean
        Mean luminance of its base color: what is brighter or darker stays so as it is painted.
    color
        Linear red, green and blue in place of its own; None for its own.
    hue
        What its hue is turned by, in turns.
    saturation, value
        Factors.
    keeps_dark
        Whether texels as dark as rubber and glass keep their color.
    everywhere
        Whether wheels, windows, and the like are painted too.
    """

    material: str
    mean: float
    color: tuple[float, float, float] | None
    hue: float
    saturation: float
    value: float
    keeps_dark: bool
    everywhere: bool


@dataclass(frozen=True, slots=True)
class VehicleInput:
    """A vehicle to stand in the scenery.

    Parameters
    ----------
    tidy
        The file that `reading.blender.tidy` made.
    world_from_parts
        (p, 4, 4) where its parts are, in meters.
    paint
        Its painted materials.
    """

    tidy: str
    world_from_parts: list[Matrix]
    paint: list[PaintInput] = field(default_factory=list)


@dataclass(frozen=True, slots=True)
class CameraInput:
    """The camera to look through.

    Parameters
    ----------
    world_from_camera
        (4, 4) rigid, meters; x right, y down, z forward.
    intrinsics
        Image size and field of view.
    near
        Meters along the optical axis; nothing closer is seen.
    exposure
        Of the picture, in EV.
    white_balance
        Offset in kelvin from the white balance that changes nothing.
    """

    world_from_camera: Matrix
    intrinsics: Intrinsics
    near: float
    exposure: float
    white_balance: float


@dataclass(frozen=True, slots=True)
class LightInput:
    """The sky.

    Parameters
    ----------
    hdri
        Path of the picture.
    yaw
        Its turn about the vertical, radians counter-clockwise.
    strength
        Factor on its brightness.
    horizon
        Elevation in radians whose color the camera sees below it too; None: it sees the picture as it is.
    """

    hdri: str
    yaw: float
    strength: float
    horizon: float | None


@dataclass(frozen=True, slots=True)
class Settings:
    """Cycles' settings that a config chooses: `adaptive_threshold` 0 means no adaptive sampling."""

    samples: int
    denoise: bool
    adaptive_threshold: float
    bounces: int


@dataclass(frozen=True, slots=True)
class MaskJob:
    """Render which vehicle is at each pixel to `output`, a .npy file; see `render.blender.object_index`."""

    scenery: SceneryInput
    vehicles: list[VehicleInput]
    camera: CameraInput
    output: str


@dataclass(frozen=True, slots=True)
class RenderJob:
    """Render a picture to `output`; without weather it is clear and dry.

    Without a sensor, the picture is what Blender's view transform makes of the light, a .png file.
    """

    scenery: SceneryInput
    vehicles: list[VehicleInput]
    camera: CameraInput
    light: LightInput
    weather: Weather | None
    seed: int
    settings: Settings
    output: str
    sensor: Sensor | None = None


@dataclass(frozen=True, slots=True)
class StartJob:
    """Choose the device to render on: what `render.blender.cycles.choose_device` takes, and CPU threads, 0 for all."""

    device: str
    index: int
    threads: int


Job = StartJob | RenderJob | MaskJob
KINDS: Mapping[str, type[Job]] = {"start": StartJob, "render": RenderJob, "mask": MaskJob}


def _camera_input(intrinsics: Mapping[str, Any], **others: Any) -> CameraInput:
    return CameraInput(intrinsics=Intrinsics(**intrinsics), **others)


PARTS: Mapping[str, Callable[..., Any]] = {
    "scenery": SceneryInput,
    "camera": _camera_input,
    "light": LightInput,
    "weather": Weather,
    "sensor": Sensor,
    "settings": Settings,
}


def to_json(job: Job) -> dict[str, Any]:
    """A job as what JSON can hold; its kind is called `do`."""
    return {"do": next(name for name, kind in KINDS.items() if type(job) is kind), **asdict(job)}


def from_json(message: Mapping[str, Any]) -> Job:
    """The job that `to_json` made a message of."""
    parts = {
        key: PARTS[key](**value) if key in PARTS and value is not None else value
        for key, value in message.items()
        if key != "do"
    }
    if "vehicles" in parts:
        parts["vehicles"] = [
            VehicleInput(**{**vehicle, "paint": [PaintInput(**paint) for paint in vehicle["paint"]]})
            for vehicle in parts["vehicles"]
        ]
    return KINDS[message["do"]](**parts)
