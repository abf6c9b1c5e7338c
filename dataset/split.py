"""A dataset's images shared out to train, valid and test, and written as folders that training tools read."""

from __future__ import annotations

import hashlib
import shutil
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path, PurePosixPath
from typing import Any

import orjson

from dataset.document import COCO_NAME
from dataset.pictures import link_or_copy, own_picture
from dataset.records import read_usable
from dataset.seals import changed
from dataset.yolo import class_numbers, label_lines, write_data_file
from geometry.errors import DatasetError

SPLITS = ("train", "valid", "test")
UNFINISHED_NAME = ".unfinished"


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
    groups: dict[str, list[int]] = {}
    for image in images:
        groups.setdefault(group_of(image, annotations.get(image["id"], ())), []).append(image["id"])
    counts = {name: _count(annotations.get(i, ()) for i in ids) for name, ids in groups.items()}
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
        split_of.update(dict.fromkeys(groups[name], split))
    return split_of


def export(
    dataset: Path | str,
    out: Path | str,
    *,
    layout: str = "coco",
    fractions: tuple[float, float, float] = (0.7, 0.2, 0.1),
    seed: int = 0,
    allow_links: Sequence[Path | str] = (),
    progress: Callable[[int, int], None] | None = None,
) -> dict[str, int]:
    """Write a dataset as train, valid and test folders; images are linked where the disk allows, copied where not.

    Parameters
    ----------
    dataset
        The folder of a COCO dataset.
    out
        A folder that does not exist or is empty.
    layout
        ``"coco"``: ``train/_annotations.coco.json`` with the images beside it, as RF-DETR and Roboflow have it.
        ``"yolo"``: ``images/train``, ``labels/train`` and ``data.yaml``, as Ultralytics has it.
    fractions, seed
        See `share_out`.
    allow_links
        Folders outside the dataset that pictures which are links may lead to.
    progress
        Told (done, all) after each image.

    Returns
    -------
    Images in each split.

    Raises
    ------
    DatasetError
        If the dataset cannot be read, an image of it is missing or is a link that leads elsewhere, or `out` has
        something in it or cannot be written.
        Nothing is left in `out` then.
    """
    if layout not in ("coco", "yolo"):
        raise ValueError(f"layout: expected 'coco' or 'yolo', got {layout!r}")
    dataset, out, allowed = Path(dataset), Path(out), [Path(folder) for folder in allow_links]
    coco = read_usable(dataset)
    if out.exists() and (not out.is_dir() or any(path.name != UNFINISHED_NAME for path in out.iterdir())):
        raise DatasetError("has something in it already", path=out, remedy="name an empty or a new folder")
    boxes: dict[int, list[dict[str, Any]]] = {image["id"]: [] for image in coco["images"]}
    for annotation in coco["annotations"]:
        if annotation["image_id"] in boxes:
            boxes[annotation["image_id"]].append(annotation)
    split_of = share_out(coco["images"], boxes, fractions=fractions, seed=seed)
    names = _flat_names(coco["images"])
    numbers = class_numbers(coco["categories"])
    with all_or_nothing(out) as unfinished:
        for folder in [part for split in SPLITS for part in _folders(unfinished, layout, split)]:
            folder.mkdir(parents=True, exist_ok=True)
        for done, image in enumerate(coco["images"], start=1):
            pictures, texts = _folders(unfinished, layout, split_of[image["id"]])
            name = names[image["id"]]
            source = dataset / image["file_name"]
            try:
                link_or_copy(own_picture(dataset, image["file_name"], allowed), pictures / name)
            except OSError as error:
                problem = f"cannot be exported ({error.strerror})"
                raise DatasetError(problem, path=source, remedy="check it with `hulldown verify`") from error
            if layout == "yolo":
                lines = label_lines(boxes[image["id"]], numbers, image["width"], image["height"])
                (texts / f"{PurePosixPath(name).stem}.txt").write_text("".join(f"{line}\n" for line in lines))
            if progress is not None:
                progress(done, len(coco["images"]))
        if layout == "yolo":
            write_data_file(unfinished / "data.yaml", coco["categories"], SPLITS)
        else:
            for split in SPLITS:
                mine = [image for image in coco["images"] if split_of[image["id"]] == split]
                part = {
                    **{key: value for key, value in coco.items() if key not in ("images", "annotations")},
                    "images": [changed(image, file_name=names[image["id"]]) for image in mine],
                    "annotations": [annotation for image in mine for annotation in boxes[image["id"]]],
                }
                (unfinished / split / COCO_NAME).write_bytes(orjson.dumps(part))
    return {split: sum(found == split for found in split_of.values()) for split in SPLITS}


@contextmanager
def all_or_nothing(out: Path) -> Iterator[Path]:
    """A folder to write to, whose content becomes that of `out` if all goes well.

    It lies in `out`, so that moving is renaming. What a killed export left in it is not seen by training tools, and
    the next export replaces it.
    """
    unfinished = out / UNFINISHED_NAME
    made = not out.exists()
    try:
        shutil.rmtree(unfinished, ignore_errors=True)
        unfinished.mkdir(parents=True)
        yield unfinished
        for path in sorted(unfinished.iterdir()):
            path.rename(out / path.name)
        unfinished.rmdir()
    except BaseException as error:
        shutil.rmtree(out if made else unfinished, ignore_errors=True)
        if isinstance(error, OSError):
            raise DatasetError(
                f"cannot be written ({error.strerror})", path=out, remedy="choose a folder that you may write to"
            ) from error
        raise


def _filled(have: Mapping[int, int], more: Mapping[int, int]) -> int:
    """How full a split would be with more, in the classes of the more, weighted by how much there is of each."""
    return sum(n * (have.get(label, 0) + n) for label, n in more.items())


def _folders(out: Path, layout: str, split: str) -> tuple[Path, Path]:
    """Where pictures and labels of a split go."""
    if layout == "coco":
        return out / split, out / split
    return out / "images" / split, out / "labels" / split


def _flat_names(images: Sequence[Mapping[str, Any]]) -> dict[int, str]:
    """One name an image without folders; stems are unique, since YOLO labels are named by them."""
    names: dict[int, str] = {}
    taken: set[str] = set()
    for image in images:
        path = PurePosixPath(image["file_name"])
        name = path.name
        if path.stem.casefold() in taken:
            name = f"{path.stem}-{image['id']}{path.suffix}"
        while PurePosixPath(name).stem.casefold() in taken:
            name = f"{PurePosixPath(name).stem}-again{path.suffix}"
        taken.add(PurePosixPath(name).stem.casefold())
        names[image["id"]] = name
    return names


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
