"""Jobs for a worker inside Blender, pickled: paths and Python's own numbers, since it may have another numpy."""

from __future__ import annotations

from dataclasses import dataclass, field

from hulldown.camera.intrinsics import Intrinsics
from hulldown.weather.kinds import Weather

Matrix = list[list[float]]  # (4, 4)


@dataclass(frozen=True, slots=True)
class VehicleInput:
    """A vehicle and its place in the scenery."""

    tidy: str  # its tidy twin, by `reading.blender.tidy`
    world_from_parts: list[Matrix]  # poses of its parts, in meters
    # linear red, green, and blue of each painted material, by its name in the vehicle's file
    paint: dict[str, tuple[float, float, float]] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class CameraInput:
    """The camera that renders."""

    world_from_camera: Matrix  # rigid, meters; x right, y down, z forward
    intrinsics: Intrinsics  # image size and field of view
    near: float  # meters along the optical axis; nothing closer is seen
    exposure: float  # the picture's exposure in EV
    white_balance: float  # offset in kelvin from the neutral white balance


@dataclass(frozen=True, slots=True)
class LightInput:
    """The HDRI that lights a picture."""

    hdri: str
    yaw: float  # its yaw in radians, counterclockwise
    strength: float
    horizon: float | None  # elevation in radians whose color continues below for the camera; None: the whole picture


@dataclass(frozen=True, slots=True)
class CyclesSettings:
    """The config's settings of Cycles; `adaptive_threshold` 0 turns adaptive sampling off."""

    samples: int
    denoise: bool
    adaptive_threshold: float
    bounces: int


@dataclass(frozen=True, slots=True)
class MaskJob:
    """Render the vehicle at each pixel to `output`, a .npy file; see `render.blender.object_index`."""

    scenery: str
    vehicles: list[VehicleInput]
    camera: CameraInput
    output: str


@dataclass(frozen=True, slots=True)
class RenderJob:
    """Render a picture to `output`, a .png file; weather None is clear and dry."""

    scenery: str
    vehicles: list[VehicleInput]
    camera: CameraInput
    light: LightInput
    weather: Weather | None
    seed: int
    settings: CyclesSettings
    output: str


@dataclass(frozen=True, slots=True)
class BlendJob:
    """Save the scene of a picture to `output`, a .blend file; see `render.blender.saved_scene`."""

    picture: RenderJob  # its own output isn't written
    output: str


@dataclass(frozen=True, slots=True)
class StartJob:
    """Choose a device by `render.blender.cycles.activate_device`, and the number of CPU threads (0: all)."""

    device: str
    index: int
    threads: int


OutputJob = RenderJob | MaskJob | BlendJob
Job = StartJob | OutputJob
