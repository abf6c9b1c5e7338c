"""Folders of YOLO, Pascal VOC, and labelme, read as COCO dictionaries.

Read here, because supervision forgets VOC's `difficult` and rounds YOLO's polygons to pixels.

Ultralytics' and Roboflow's documentation of YOLO folders; Everingham et al., The Pascal visual object classes
challenge, IJCV 2010, and its development kit: pixels are counted from 1.
"""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable, Iterable, Iterator
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal

from msgspec import Meta, Struct

from hulldown.annotate.coco_types import Coco, Record
from hulldown.assets.picture_files import read_picture
from hulldown.base.errors import DatasetError
from hulldown.base.outside import MAX_TEXT_BYTES, convert_parsed_value, parse_xml, parse_yaml, read_file, read_json, read_text

PICTURE_SUFFIXES = (".bmp", ".jpeg", ".jpg", ".png", ".tif", ".tiff", ".webp")
YAML_NAMES = ("data.yaml", "dataset.yaml", "data.yml")
LIST_NAMES = ("classes.txt", "obj.names")  # files of Label Studio and CVAT with a class in each line

_Name = Annotated[str, Meta(min_length=1)] | int | float  # YAML takes a class called 2 for a number
_Share = Annotated[float, Meta(ge=-2, le=2)]
_Pixel = Annotated[float, Meta(ge=-1e9, le=1e9)]


class _Described(Struct):
    names: list[_Name] | dict[int | str, _Name]


class _Shape(Struct):
    label: _Name
    points: Annotated[list[tuple[_Pixel, _Pixel]], Meta(min_length=2)]
    shape_type: Literal["polygon", "rectangle"] = "polygon"


class _LabelmeFile(Struct):
    shapes: list[_Shape]


def foreign_reader(folder: Path) -> Callable[[], Coco] | None:
    """Return the reader of a folder of YOLO, VOC, or labelme; None if it's something else."""
    if (folder / "Annotations").is_dir():
        return partial(_read_voc, folder, folder / "Annotations", folder / "JPEGImages")
    if any(folder.glob("*.xml")):
        return partial(_read_voc, folder, folder, folder)
    homes, names = (folder, *folder.parents[:2]), (*YAML_NAMES, *LIST_NAMES)
    described = [path for home in homes for name in names if (path := home / name).is_file()]
    for pictures, labels in _candidate_yolo_folders(folder) if described else ():
        return partial(_read_yolo, folder, pictures, labels, described[0])
    if described and described[0].parent == folder:
        remedy = "name one of its splits, such as images/train or train"
        raise DatasetError("is a YOLO dataset of several splits", path=folder, remedy=remedy)
    texts = [text for picture in _picture_files(folder) if (text := picture.with_suffix(".json")).is_file()]
    if texts and b'"shapes"' in read_file(texts[0], partial(DatasetError, path=texts[0])):
        return partial(_read_labelme, folder)
    return None


def refuse_known_folder(folder: Path) -> None:
    """Refuse a folder of several datasets, or of YOLO without the file that names its classes."""
    for split in sorted(folder.glob("*/_annotations.coco.json")):
        remedy = f"name one of its splits, such as {split.parent}"
        raise DatasetError("is a COCO dataset of several splits", path=folder, remedy=remedy)
    if (folder / "samples.json").is_file():
        remedy = "export it from FiftyOne as COCODetectionDataset"
        raise DatasetError("is a dataset in FiftyOne's own format", path=folder, remedy=remedy)
    for _, labels in _candidate_yolo_folders(folder):
        raise DatasetError(
            f"has labels as YOLO has them in {labels}, but no {YAML_NAMES[0]} that names their classes",
            path=folder,
            remedy=f"write {folder / YAML_NAMES[0]} with a line such as names: [tank, truck]",
        )


def _candidate_yolo_folders(folder: Path) -> Iterator[tuple[Path, Path]]:
    """Yield each folder of pictures with that of its labels, which may be the same."""
    labels = Path(*("labels" if part == "images" else part for part in folder.parts))
    beside = folder / "obj_train_data"  # CVAT's YOLO 1.1 has this folder
    for pictures, texts in ((folder / "images", folder / "labels"), (folder, labels), (beside, beside)):
        found = _picture_files(pictures) if texts.is_dir() else []
        if found and (pictures != texts or any((texts / f"{path.stem}.txt").is_file() for path in found)):
            yield pictures, texts


def _picture_files(folder: Path) -> list[Path]:
    return sorted(path for path in folder.glob("*") if path.suffix.lower() in PICTURE_SUFFIXES)


def _read_yolo(folder: Path, pictures: Path, labels: Path, described: Path) -> Coco:
    refuse = partial(DatasetError, path=described, remedy="add a line such as names: [tank, truck]")
    try:
        content = read_text(described, refuse)
        listed = described.name in LIST_NAMES
        found = content.rstrip().splitlines() if listed else convert_parsed_value(parse_yaml(content), _Described).names
        names = {int(key): name for key, name in (enumerate(found) if isinstance(found, list) else found.items())}
    except ValueError as error:
        raise refuse(f"names no classes ({error})") from None
    coco = _coco_with_categories(str(name) for _, name in sorted(names.items()))
    ids = {float(key): i for i, key in enumerate(sorted(names), 1)}
    files = _picture_files(pictures)
    bare = [path.name for path in files if not (labels / f"{path.stem}.txt").exists()]
    if bare:
        warnings.warn(f"{pictures}: {len(bare)} of {len(files)} have no label file, such as {bare[0]}", stacklevel=2)
    for picture in files:
        image = _add_image(coco, folder, picture)
        text = labels / f"{picture.stem}.txt"
        refuse = partial(DatasetError, path=text, remedy=f"correct it; {described.name} has the classes")
        for number, line in enumerate(read_text(text, refuse).splitlines() if text.exists() else (), 1):
            if line.strip():
                try:
                    key, *values = map(float, line.replace("_", "?").split())  # Python reads 0.1_5
                    _add_yolo_label(coco, image, ids[key], convert_parsed_value(values, list[_Share]))
                except (ValueError, KeyError):
                    problem = f"line {number}: {line[:60]!r} is no class and box or polygon, as shares of the picture"
                    raise refuse(problem) from None
    return coco


def _add_yolo_label(coco: Coco, image: Record, category: int, values: list[float]) -> None:
    """Add the label in a line: a box (and a confidence), or a polygon, in shares of the picture."""
    width, height = image["width"], image["height"]
    if len(values) in (4, 5):
        x, y, w, h = values[:4]
        _add_label(coco, image, category, [(x - w / 2) * width, (y - h / 2) * height, w * width, h * height])
        return
    if len(values) < 6 or len(values) % 2:
        raise ValueError("no box and no polygon")
    corners = [value * (width, height)[i % 2] for i, value in enumerate(values)]
    left, top, right, bottom = min(corners[::2]), min(corners[1::2]), max(corners[::2]), max(corners[1::2])
    _add_label(coco, image, category, [left, top, right - left, bottom - top], segmentation=[corners])


def _read_voc(folder: Path, texts: Path, pictures: Path) -> Coco:
    trees = {}
    for path in sorted(texts.glob("*.xml")):
        refuse = partial(DatasetError, path=path, remedy="correct it or take it out")
        try:
            trees[path] = parse_xml(read_file(path, refuse, most=MAX_TEXT_BYTES))
        except ValueError as error:
            raise refuse(f"cannot be read ({error})") from None
        if not all(element.findtext("name", "").strip() for element in trees[path].iter("object")):
            raise refuse("an object has no name")
    names = sorted({element.findtext("name", "") for tree in trees.values() for element in tree.iter("object")})
    coco = _coco_with_categories(names)
    for path, tree in trees.items():
        named = pictures / Path(tree.findtext("filename", "")).name
        fitting = [named] if os.path.isfile(named) else [p for p in _picture_files(pictures) if p.stem == path.stem]
        if not fitting:
            raise DatasetError(f"its picture {named.name!r} is missing", path=path, remedy=f"put it into {pictures}")
        image = _add_image(coco, folder, fitting[0])
        for element in tree.iter("object"):
            try:
                sides = [element.findtext(f"bndbox/{side}", "") for side in ("xmin", "ymin", "xmax", "ymax")]
                left, top, right, bottom = convert_parsed_value([side.strip() for side in sides], list[_Pixel], strict=False)
            except ValueError:
                name = element.findtext("name", "")
                raise DatasetError(f"object {name!r} has no box", path=path, remedy="correct it") from None
            box = [left - 1, top - 1, right - left + 1, bottom - top + 1]
            ignored = int(element.findtext("difficult", "0").strip() == "1")
            _add_label(coco, image, names.index(element.findtext("name", "")) + 1, box, iscrowd=ignored)
    return coco


def _read_labelme(folder: Path) -> Coco:
    files: dict[Path, list[_Shape]] = {}
    for picture in _picture_files(folder):
        text = picture.with_suffix(".json")
        refuse = partial(DatasetError, path=text, remedy="correct it, or draw rectangles and polygons")
        known = text.is_file()
        files[picture] = read_json(text, _LabelmeFile, refuse, what="a file of labelme").shapes if known else []
    names = sorted({str(shape.label) for shapes in files.values() for shape in shapes})
    coco = _coco_with_categories(names)
    for picture, shapes in files.items():
        image = _add_image(coco, folder, picture)
        for shape in shapes:
            (left, top), (right, bottom) = (tuple(map(side, *shape.points)) for side in (min, max))
            rings = [] if shape.shape_type == "rectangle" else [[value for point in shape.points for value in point]]
            box = [left, top, right - left, bottom - top]
            _add_label(coco, image, names.index(str(shape.label)) + 1, box, segmentation=rings)
    return coco


def _coco_with_categories(names: Iterable[str]) -> Coco:
    return {"images": [], "annotations": [], "categories": [{"id": i, "name": name} for i, name in enumerate(names, 1)]}


def _add_image(coco: Coco, folder: Path, picture: Path) -> Record:
    width, height = read_picture(picture, largest=0).size
    name = picture.relative_to(folder).as_posix()
    coco["images"].append({"id": len(coco["images"]) + 1, "file_name": name, "width": width, "height": height})
    return coco["images"][-1]


def _add_label(coco: Coco, image: Record, category: int, box: list[float], **more: Any) -> None:
    record = {"id": len(coco["annotations"]) + 1, "image_id": image["id"], "category_id": category, "bbox": box}
    coco["annotations"].append({**record, "area": box[2] * box[3], "iscrowd": 0, **more})
