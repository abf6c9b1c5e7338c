"""What a type of labels is: its record fields, how they're computed from a scene, checked, and drawn."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from jaxtyping import Bool, Float
from msgspec import Struct
from numpy import ndarray
from PIL.ImageDraw import ImageDraw

from hulldown.annotate.records import Category, Image, Label
from hulldown.camera.cameras import Cameras
from hulldown.scene.posed_scene import Scene
from hulldown.scene.posed_vehicle import PosedVehicle


@dataclass(frozen=True, eq=False, slots=True)
class VehicleInScene:
    """A labeled vehicle in its scene, and the pixels that it covers."""

    posed: PosedVehicle
    scene: Scene  # everything in the image, this vehicle included
    # whole, visible: pixels whose center is on the vehicle, and those of them that nothing hides
    whole: Bool[ndarray, "h w"]
    visible: Bool[ndarray, "h w"]
    keypoints: Sequence[str] = ()  # names of the dataset's keypoints, in order; empty: it has none


@dataclass(frozen=True, eq=False, slots=True)
class LabeledVehicle:
    """The input of labels: a vehicle, its camera, and what rays found."""

    camera: Cameras
    world_from_vehicle: Float[ndarray, "4 4"]
    bounds: Float[ndarray, "2 3"]  # lowest and highest corner in its own frame, parts turned
    traced: VehicleInScene | None = None  # None before rendering, when types that need rays have no fields


@dataclass(frozen=True, eq=False, slots=True)
class Pen:
    """The canvas, color, and line width of a label type's drawing."""

    canvas: ImageDraw
    color: tuple[int, int, int]
    width: int  # of a line, pixels


class LabelType(Struct, kw_only=True):
    """A label's values of one type; any of them may be missing. `label_list.LABEL_TYPES` has all types."""

    @classmethod
    def compute_fields(cls, vehicle: LabeledVehicle) -> dict[str, object]:
        """Return the fields of a record; none if they need rays that weren't traced."""
        return {}

    def problems(self, label: Label, image: Image, category: Category | None) -> Iterator[str]:
        """Yield a sentence for each contradiction to the label, its image, or its class (None: unknown)."""
        return iter(())

    def pixels_to_tint(self, width: int, height: int) -> Bool[ndarray, "h w"] | None:
        """Return the pixels that are tinted in a picture of labels; None: there are none."""
        return None

    def draw_lines(self, pen: Pen) -> None:
        """Draw the values over a picture's pixels and boxes."""
