"""Keypoints of a vehicle in an image and their visibility, as COCO writes them: x, y, and v."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Annotated

import numpy as np
from jaxtyping import Float
from msgspec import Meta

from hulldown.annotate.label_type import LabeledVehicle, LabelType, Pen
from hulldown.annotate.record_fields import Pixel
from hulldown.annotate.records import Category, Image, Label
from hulldown.assets.vehicle import VehicleShape
from hulldown.base.errors import ConfigError
from hulldown.camera.cameras import NEAR_M, Cameras
from hulldown.geometry.transforms import transform_points
from hulldown.scene.posed_scene import Scene
from hulldown.scene.posed_vehicle import PosedVehicle
from hulldown.scene.rays import RayList

UNSEEN, HIDDEN, SEEN = 0.0, 1.0, 2.0  # COCO's v
SURFACE_SLACK_M = 0.01  # a keypoint on a surface may be this far below it


class Keypoints(LabelType):
    """Keypoints of a label, in the order of its class."""

    keypoints: Annotated[
        list[Pixel] | None, Meta(description="COCO's, if `annotate.keypoints` is set: [labels](labels.md#keypoints)")
    ] = None
    num_keypoints: Annotated[int | None, Meta(description="number of those with v > 0")] = None

    @classmethod
    def compute_fields(cls, vehicle: LabeledVehicle) -> dict[str, object]:
        """Return the keypoints that the dataset has; nothing if it has none."""
        if (traced := vehicle.traced) is None or not traced.keypoints:
            return {}
        found = keypoints_in_image(traced.posed, vehicle.camera, traced.scene)
        by_name = dict(zip(traced.posed.caster.shape.keypoint_names, found.tolist(), strict=True))
        listed = [by_name.get(name, (0.0, 0.0, 0.0)) for name in traced.keypoints]
        flat = [number for x, y, v in listed for number in (round(x, 6), round(y, 6), int(v))]
        return {"keypoints": flat, "num_keypoints": sum(int(v > 0) for _, _, v in listed)}

    def problems(self, label: Label, image: Image, category: Category | None) -> Iterator[str]:
        """Find keypoints that are too few or too many, outside their image, or counted wrong."""
        if (keypoints := self.keypoints) is None:
            return
        names = category.keypoints if category is not None else None
        if names is None or len(keypoints) != 3 * len(names):
            yield f"keypoints has {len(keypoints)} numbers, its category has {len(names or ())} keypoints"
            return
        for name, x, y, v in zip(names, keypoints[::3], keypoints[1::3], keypoints[2::3], strict=True):
            if v not in (0, 1, 2):
                yield f"keypoint {name!r} has the visibility {v!r}, expected 0, 1, or 2"
            elif v and not (0 <= x <= image.width and 0 <= y <= image.height):
                yield f"keypoint {name!r} is outside of its image"
        if self.num_keypoints != sum(v > 0 for v in keypoints[2::3]):
            yield f"num_keypoints is {self.num_keypoints!r}"

    def draw_lines(self, pen: Pen) -> None:
        """Draw a disk for each visible keypoint, and a circle for each hidden one."""
        points, reach = self.keypoints or (), 2 * pen.width
        for x, y, v in zip(points[::3], points[1::3], points[2::3], strict=False):
            if v:
                fill, outline = (pen.color, (0, 0, 0)) if v > 1 else (None, pen.color)
                around = (x - reach, y - reach, x + reach, y + reach)
                pen.canvas.ellipse(around, fill=fill, outline=outline, width=pen.width)


def keypoints_in_image(vehicle: PosedVehicle, camera: Cameras, world: Scene) -> Float[np.ndarray, "k 3"]:
    """Pixel and COCO's v of each keypoint of a vehicle: 2 if it's visible, 1 if it's hidden, 0 outside of the image."""
    shape, world_from_vehicle = vehicle.caster.shape, vehicle.world_from_vehicle[0]
    points = transform_points(world_from_vehicle, shape.articulated_keypoints(vehicle.articulation))
    pixels, depth = camera.project(points)
    size = (camera.lenses.width, camera.lenses.height)
    with np.errstate(invalid="ignore"):
        framed = np.flatnonzero((depth >= NEAR_M) & (pixels >= 0.0).all(axis=1) & (pixels < size).all(axis=1))
    keypoints = np.zeros((len(points), 3))
    keypoints[framed] = np.column_stack([pixels[framed], np.full(len(framed), SEEN)])
    along = points[framed] - camera.position
    distance = np.linalg.norm(along, axis=1)
    first = NEAR_M * distance / depth[framed]  # to the near plane
    reach = distance - first - SURFACE_SLACK_M
    asked = np.flatnonzero(reach > 0.0)
    unit = along[asked] / distance[asked, None]
    rays = RayList(camera.position + first[asked, None] * unit, unit)
    hidden = world.occlusion(rays, max_distance=reach[asked])
    keypoints[framed[asked[hidden]], 2] = HIDDEN
    return keypoints


def category_keypoint_fields(
    shapes: Iterable[VehicleShape], patterns: Sequence[str] | None, lines: Sequence[tuple[str, str]] | None, *, path: Path
) -> dict[str, object]:
    """Return COCO's `keypoints` and `skeleton`, the same for all categories, so an image's labels are one array."""
    if patterns is None:
        return {}
    there = list(dict.fromkeys(name for shape in shapes for name in shape.keypoint_names))
    for pattern in patterns:
        if not any(fnmatchcase(name, pattern) for name in there):
            known = ", ".join(map(repr, there)) or "none"
            problem = f"annotate.keypoints: {pattern!r} matches no keypoint of a vehicle"
            raise ConfigError(problem, path=path, remedy=f"there are: {known}; give them in `keypoints` of a vehicle")
    lines = lines or ()
    names = [name for name in there if any(fnmatchcase(name, pattern) for pattern in patterns)]
    place = {name: i for i, name in enumerate(names, start=1)}
    for name in (name for line in lines for name in line if name not in place):
        problem = f"annotate.skeleton: {name!r} is no keypoint"
        raise ConfigError(problem, path=path, remedy=f"these are: {', '.join(map(repr, names))}")
    return {"keypoints": names, "skeleton": [[place[a], place[b]] for a, b in lines]}
