"""DOTA: a text file a picture, with the four corners of oriented boxes.

References
----------
Xia et al., DOTA: a large-scale dataset for object detection in aerial images, CVPR 2018, and its description of
``labelTxt``: x1 y1 x2 y2 x3 y3 x4 y4 category difficult.
"""

from __future__ import annotations

from pathlib import Path

from hulldown.dataset.exports.layouts.splits import VAL_NAMES, Splits
from hulldown.dataset.exports.layouts.yolo import CornersOf


def write(splits: Splits, out: Path, *, corners_of: CornersOf) -> None:
    """Write ``train/images``, ``train/labelTxt`` and so on; crowds are difficult, blanks in class names hyphens."""
    for split, items in splits:
        pictures, texts = (out / VAL_NAMES[split] / name for name in ("images", "labelTxt"))
        pictures.mkdir(parents=True)
        texts.mkdir()
        for item in items:
            item.link(pictures)
            lines = []
            for label in item.image.labels:
                corners = " ".join(f"{n:.4f}" for n in corners_of(label, item.image).ravel())
                name = "-".join(label.category.split())
                lines.append(f"{corners} {name} {int(label.crowd)}\n")
            (texts / f"{item.stem}.txt").write_text("".join(lines), encoding="utf-8")
