"""A dataset's images shared out to train, valid and test, whole positions at a time."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

SPLITS = ("train", "valid", "test")


def group_of(image: Mapping[str, Any], annotations: Sequence[Mapping[str, Any]]) -> str:
    """What an image must not be parted from: the shots of one position show one vehicle on one piece of ground.

    A position is where the first vehicle stands, to the millimetre, so that another plan's shots of the same place
    belong to it too. Images that know no such thing, such as real ones, stand alone; so do those whose poses, from
    elsewhere, are of another kind.
    """
    for annotation in annotations:
        if (place := _place(annotation.get("world_from_vehicle"))) is not None:
            return f"{image.get('scenery')} {annotation.get('vehicle')} {place}"
    if image.get("position") is not None:
        return f"{image.get('scenery')} position {image['position']}"
    return f"image {image['id']}"


def _place(pose: Any) -> str | None:
    """Where a pose stands; None if it is no matrix."""
    try:
        return " ".join(f"{float(pose[i][3]):.3f}" for i in range(3))
    except (TypeError, ValueError, IndexError, KeyError):
        return None


def positions(
    images: Iterable[Mapping[str, Any]], annotations: Mapping[int, Sequence[Mapping[str, Any]]]
) -> dict[str, list[Mapping[str, Any]]]:
    """Image records by `group_of`, in the order in which they come; `annotations` are by image id."""
    groups: dict[str, list[Mapping[str, Any]]] = {}
    for image in images:
        groups.setdefault(group_of(image, annotations.get(image["id"], ())), []).append(image)
    return groups


def share_out(
    images: Sequence[Mapping[str, Any]],
    annotations: Mapping[int, Sequence[Mapping[str, Any]]],
    *,
    fractions: tuple[float, float, float] = (0.7, 0.2, 0.1),
    seed: int = 0,
) -> dict[int, str]:
    """A split for every image id, whole groups at a time, classes in proportion.

    Groups are taken in an order that depends on nothing but the seed and their names, each into the split that its
    classes are furthest behind in.

    Parameters
    ----------
    images
        COCO image records.
    annotations
        Image id -> its COCO annotation records.
    fractions
        Shares of train, valid and test; they add up to 1.
    seed
        Another seed, another split.
    """
    # What is no number fails each comparison.
    if len(fractions) != 3 or not all(f >= 0.0 for f in fractions) or not abs(sum(fractions) - 1.0) <= 1e-6:
        raise ValueError(f"fractions: expected three shares that are not negative and add up to 1, got {fractions}")
    groups = positions(images, annotations)
    counts = {name: _count(annotations.get(one["id"], ()) for one in members) for name, members in groups.items()}
    # Large groups first: small ones then even out what those left uneven.
    order = sorted(groups, key=lambda name: (-len(groups[name]), shuffled(name, seed)))
    have: dict[str, dict[int, int]] = {split: {} for split in SPLITS}
    split_of: dict[int, str] = {}
    open_splits = [(split, share) for split, share in zip(SPLITS, fractions, strict=True) if share > 0.0]
    for name in order:
        mine = counts[name]
        split, _ = min(open_splits, key=lambda choice: _filled(have[choice[0]], mine) / choice[1])
        for label, n in mine.items():
            have[split][label] = have[split].get(label, 0) + n
        split_of.update({image["id"]: split for image in groups[name]})
    return split_of


def _filled(have: Mapping[int, int], more: Mapping[int, int]) -> int:
    """How full a split would be with more, in the classes of the more, weighted by how much there is of each."""
    return sum(n * (have.get(label, 0) + n) for label, n in more.items())


def _count(images: Iterable[Sequence[Mapping[str, Any]]]) -> dict[int, int]:
    """How often each category occurs; an image without any counts as a category, so that backgrounds spread too."""
    counts: dict[int, int] = {}
    for boxes in images:
        for label in [box["category_id"] for box in boxes] or [-1]:
            counts[label] = counts.get(label, 0) + 1
    return counts


def shuffled(name: str, seed: int) -> bytes:
    """A key that sorts names into an order which depends on them and the seed alone."""
    return hashlib.sha256(f"{seed} {name}".encode()).digest()
