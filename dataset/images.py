"""All images of a dataset with their labels, made of usable records."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from msgspec import Struct

from hulldown.annotate.coco_types import Coco, Record
from hulldown.annotate.record_fields import declared_fields
from hulldown.annotate.records import Category, Image, Label


@dataclass(frozen=True, eq=False, slots=True)
class LabeledImages:
    """All images of a dataset."""

    categories: tuple[Category, ...]  # categories, images: in the order of the file
    images: tuple[Image, ...]
    head: Record  # the other keys of the COCO dictionary

    @classmethod
    def from_coco_dict(cls, coco: Coco) -> LabeledImages:
        """Return the images of a COCO dictionary with usable records, see `dataset.record_checks.read_usable_dataset`."""
        categories = tuple(map(Category.from_record, coco["categories"]))
        names = {category.id: category.name for category in categories}
        of_image: dict[int, list[Label]] = {image["id"]: [] for image in coco["images"]}
        for record in coco["annotations"]:
            of_image[record["image_id"]].append(Label.from_record(record, names))
        images = tuple(Image.from_record(image, of_image[image["id"]]) for image in coco["images"])
        head = {key: value for key, value in coco.items() if key not in ("categories", "images", "annotations")}
        return cls(categories, images, head)

    @property
    def category_names_by_id(self) -> dict[int, str]:
        """Category id -> name."""
        return {category.id: category.name for category in self.categories}

    @property
    def classes(self) -> list[Category]:
        """Categories in the order of ids, without parents of others that label nothing, as Roboflow writes them.

        >>> found = [{"id": 0, "name": "army", "supercategory": "none"}]
        >>> found += [{"id": 1, "name": "tank", "supercategory": "army"}]
        >>> coco = {"categories": found, "images": [], "annotations": []}
        >>> [category.name for category in LabeledImages.from_coco_dict(coco).classes]
        ['tank']
        """
        ordered = sorted(self.categories, key=lambda category: category.id)
        used = {label.category_id for image in self.images for label in image.labels}
        # A list, since a foreign record may have a value that can't be hashed.
        parents = [c.record.get("supercategory") for c in ordered if c.record.get("supercategory") != c.name]
        return [category for category in ordered if category.id in used or category.name not in parents]


class _Position(Struct):
    """Fields of an image's record that tell its position."""

    scenery: object = None
    position: object = None


def position_group_key(image: Image) -> str:
    """Return the group of images that stay together: by the first vehicle's place to the millimeter, or one image."""
    shot = declared_fields(image.record, _Position)
    for label in image.labels:
        if label.world_from_vehicle is not None and len(label.world_from_vehicle) >= 3:
            place = " ".join(f"{row[3]:.3f}" for row in label.world_from_vehicle[:3])
            return f"{shot.scenery} {label.vehicle} {place}"
    if shot.position is not None:
        return f"{shot.scenery} position {shot.position}"
    return f"image {image.id}"


def group_images_by_position(images: Iterable[Image]) -> dict[str, list[Image]]:
    """Return images by `position_group_key`, in order."""
    groups: dict[str, list[Image]] = {}
    for image in images:
        groups.setdefault(position_group_key(image), []).append(image)
    return groups
