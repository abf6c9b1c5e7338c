"""Jobs for a worker inside Blender: self-contained paths and numbers, pickled between two processes.

Both processes import it, so it needs numpy only. Numbers are Python's own, since the other process may have another
numpy.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from hulldown.camera.intrinsics import Intrinsics
from hulldown.camera.sensor import Sensor
from hulldown.camera.weather.kinds import Weather

Matrix = list[list[float]]  # (4, 4)


@dataclass(frozen=True, slots=True)
class PaintInput:
    """The paint of a vehicle's material.

    Parameters
    ----------
    material
        Its name in the vehicle's file.
    mean
        Mean luminance of its base color; paint keeps brightness relative to it.
    color
        Linear red, green, and blue that replace its own; None: its own.
    hue
        Change of its hue, in turns.
    saturation, value
        Factors.
    everywhere
        Whether wheels, windows, and the like are painted too.
    """

    material: str
    mean: float
    color: tuple[float, float, float] | None
    hue: float
    saturation: float
    value: float
    everywhere: bool


@dataclass(frozen=True, slots=True)
class VehicleInput:
    """A vehicle to place in the scenery.

    Parameters
    ----------
    tidy
        Its tidy twin, by `reading.blender.tidy`.
    world_from_parts
        (p, 4, 4) poses of its parts, in meters.
    paint
        Paint of its materials.
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
        The picture's exposure in EV.
    white_balance
        Offset in kelvin from the neutral white balance.
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
        Its yaw in radians, counterclockwise.
    strength
        Factor on its brightness.
    horizon
        Elevation in radians whose color continues below for the camera; None: the whole picture.
    """

    hdri: str
    yaw: float
    strength: float
    horizon: float | None


@dataclass(frozen=True, slots=True)
class CyclesSettings:
    """The config's settings of Cycles; `adaptive_threshold` 0: no adaptive sampling."""

    samples: int
    denoise: bool
    adaptive_threshold: float
    bounces: int


@dataclass(frozen=True, slots=True)
class MaskJob:
    """Render the vehicle at each pixel to `output`, a .npy file; see `rendering.blender.object_index`."""

    scenery: str
    vehicles: list[VehicleInput]
    camera: CameraInput
    output: str


@dataclass(frozen=True, slots=True)
class RenderJob:
    """Render a picture to `output`; weather None: clear and dry.

    Without a sensor, Blender's view transform makes the picture, a .png file.
    """

    scenery: str
    vehicles: list[VehicleInput]
    camera: CameraInput
    light: LightInput
    weather: Weather | None
    seed: int
    settings: CyclesSettings
    output: str
    sensor: Sensor | None = None


@dataclass(frozen=True, slots=True)
class StartJob:
    """Choose a device by `rendering.blender.cycles.choose_device`, and the number of CPU threads, 0: all."""

    device: str
    index: int
    threads: int


Job = StartJob | RenderJob | MaskJob
