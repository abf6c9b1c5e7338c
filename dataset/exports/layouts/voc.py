"""Pascal VOC: an XML file a picture.

Everingham et al., The Pascal visual object classes challenge, IJCV 2010, and its development kit: pixels are counted
from 1, and the last one of a box belongs to it.
"""

from __future__ import annotations

import math
from pathlib import Path
from xml.etree import ElementTree

from hulldown.dataset.exports.layouts.splits import COMMON_SPLIT_NAMES, ExportedImage, Splits

MAX_WHOLE_TRUNCATION, MIN_UNOCCLUDED_FRACTION = 0.0, 0.95


def write_voc(splits: Splits, out: Path) -> None:
    """Write ``JPEGImages``, ``Annotations`` in whole pixels with crowds as ``difficult``, and ``ImageSets/Main``."""
    pictures, texts, lists = out / "JPEGImages", out / "Annotations", out / "ImageSets" / "Main"
    for folder in (pictures, texts, lists):
        folder.mkdir(parents=True)
    for split, items in splits:
        with (lists / f"{COMMON_SPLIT_NAMES[split]}.txt").open("w", encoding="utf-8") as stems:
            for item in items:
                item.link(pictures)
                stems.write(f"{item.stem}\n")
                tree = ElementTree.ElementTree(_annotation_xml(item))
                ElementTree.indent(tree)
                tree.write(texts / f"{item.stem}.xml", encoding="utf-8")


def _annotation_xml(item: ExportedImage) -> ElementTree.Element:
    root = ElementTree.Element("annotation")
    _add_elements(root, folder="JPEGImages", filename=item.name)
    width, height = item.image.size
    _add_elements(ElementTree.SubElement(root, "size"), width=width, height=height, depth=3)
    _add_elements(root, segmented=0)
    for label in item.image.labels:
        x, y, w, h = label.bbox.tolist()
        shown = ElementTree.SubElement(root, "object")
        _add_elements(
            shown,
            name=label.category,
            pose="Unspecified",
            truncated=int(label.truncated_fraction > MAX_WHOLE_TRUNCATION),  # nan, if it isn't known, is neither
            occluded=int(label.visible_fraction < MIN_UNOCCLUDED_FRACTION),
            difficult=int(label.crowd),
        )
        _add_elements(
            ElementTree.SubElement(shown, "bndbox"),
            xmin=min(max(math.floor(x), 0), width - 1) + 1,
            ymin=min(max(math.floor(y), 0), height - 1) + 1,
            xmax=max(min(math.ceil(x + w), width), 1),
            ymax=max(min(math.ceil(y + h), height), 1),
        )
    return root


def _add_elements(parent: ElementTree.Element, **texts: object) -> None:
    for name, value in texts.items():
        ElementTree.SubElement(parent, name).text = str(value)
