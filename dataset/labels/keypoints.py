"""Keypoints of a label, as COCO writes them: x, y, and v."""

from __future__ import annotations

from collections.abc import Iterator

from hulldown.annotate.keypoint_visibility import keypoints_in_image
from hulldown.dataset.images import Category, Image, Label
from hulldown.dataset.labels.seen_vehicle import SeenVehicle


def seen_keypoints(vehicle: SeenVehicle) -> dict[str, object]:
    """Return the fields of a vehicle's keypoints; none if its dataset has none."""
    if not vehicle.keypoints:
        return {}
    found = keypoints_in_image(vehicle.posed, vehicle.row.camera, vehicle.scene)
    by_name = dict(zip(vehicle.posed.caster.shape.keypoint_names, found.tolist(), strict=True))
    listed = [by_name.get(name, (0.0, 0.0, 0.0)) for name in vehicle.keypoints]
    flat = [number for x, y, v in listed for number in (round(x, 6), round(y, 6), int(v))]
    return {"keypoints": flat, "num_keypoints": sum(int(v > 0) for _, _, v in listed)}


def keypoint_problems(label: Label, image: Image, category: Category | None) -> Iterator[str]:
    """Find keypoints with a wrong number, outside of their image, or with a wrong count."""
    fields = label.fields
    if (keypoints := fields.keypoints) is None:
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
    if (counted := fields.num_keypoints) != sum(v > 0 for v in keypoints[2::3]):
        yield f"num_keypoints is {counted!r}"
