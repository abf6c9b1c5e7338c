"""KITTI's object labels: a text file per picture with 3D boxes, if poses are known, and camera.

Geiger, Lenz, Urtasun, Are we ready for autonomous driving? The KITTI vision benchmark suite, CVPR 2012, and the
readme of its object development kit, which defines the fields.
"""

from __future__ import annotations

import math
import warnings
from pathlib import Path

import numpy as np

from hulldown.annotate.labels.box_3d import BoxInCamera
from hulldown.annotate.records import Label
from hulldown.camera.intrinsics import Intrinsics
from hulldown.dataset.exports.layouts.splits import COMMON_SPLIT_NAMES, Splits

UNKNOWN_BOX_3D = (-1.0, -1.0, -1.0, -1000.0, -1000.0, -1000.0, -10.0)  # KITTI's own values
UNKNOWN_ALPHA = -10.0
MIN_FULLY_VISIBLE, MIN_PARTLY_VISIBLE = 0.95, 0.5  # visible fractions of KITTI's occlusion 0 and 1
# The pose of a fictitious lidar at the camera, x forward and z up, which readers require.
CAMERA_FROM_LIDAR = "0 -1 0 0 0 0 -1 0 1 0 0 0"
LIDAR_FROM_IMU = "1 0 0 0 0 1 0 0 0 0 1 0"


def write_kitti(splits: Splits, out: Path) -> None:
    """Write ``training/image_2``, ``label_2``, ``calib`` (for images with a known field of view), and ``ImageSets``."""
    pictures, texts, cameras = (out / "training" / name for name in ("image_2", "label_2", "calib"))
    lists = out / "ImageSets"
    for folder in (pictures, texts, cameras, lists):
        folder.mkdir(parents=True)
    number, without, curved = 0, 0, 0
    for split, items in splits:
        with (lists / f"{COMMON_SPLIT_NAMES[split]}.txt").open("w", encoding="utf-8") as stems:
            for item in items:
                stem = f"{number:06d}"  # its readers number files so
                number += 1
                item.link(pictures, stem + Path(item.name).suffix)
                lines = [kitti_label_line(label) for label in item.image.labels]
                (texts / f"{stem}.txt").write_text("".join(f"{line}\n" for line in lines), encoding="utf-8")
                if (intrinsics := item.image.intrinsics) is None:
                    without += 1
                else:
                    (cameras / f"{stem}.txt").write_text(_calibration_text(intrinsics), encoding="utf-8")
                    curved += any(intrinsics.distortion)
                stems.write(f"{stem}\n")
    if without:
        pictures_of = "1 picture has" if without == 1 else f"{without} pictures have"
        warnings.warn(f"{pictures_of} no calib file: their field of view is not known", stacklevel=2)
    if curved:
        warnings.warn(f"calib files have no place for the distortion of {curved} pictures: `dist` has it", stacklevel=2)


def kitti_label_line(label: Label) -> str:
    """Class, truncated, occluded, alpha, box, and height, width, length, position, and rotation in the camera's frame.

    Names have no blanks. Crowds are ``DontCare``. ``occluded`` is 0 from 95 % visible, 1 from 50 %, else 2, and 3
    if unknown. The rotation is about the camera's y axis alone: if vehicle or camera is tilted, the 3D box
    is leveled, and only ``bbox_3d`` in the dataset has the full rotation.
    """
    x, y, w, h = label.bbox.tolist()
    seen, cut = label.visible_fraction, label.truncated_fraction
    hidden = 3 if math.isnan(seen) else 0 if seen >= MIN_FULLY_VISIBLE else 1 if seen >= MIN_PARTLY_VISIBLE else 2
    alpha = UNKNOWN_ALPHA
    numbers: tuple[float, ...] = UNKNOWN_BOX_3D
    if (box := label.read(BoxInCamera).bbox_3d) is not None:
        length, width, height = box.size
        rotation = np.array(box.rotation)
        ground = np.array(box.center) - rotation[:, 2] * height / 2
        turn = math.atan2(-rotation[2, 0], rotation[0, 0])
        alpha = math.remainder(turn - math.atan2(ground[0], ground[2]), 2 * math.pi)
        numbers = (height, width, length, *(float(each) for each in ground), turn)
    kind = "DontCare" if label.crowd else "_".join(label.category.split())
    corners = (x, y, x + w, y + h)
    truncated = -1.0 if math.isnan(cut) else cut
    return " ".join(
        [kind, f"{truncated:.4f}", str(hidden), f"{alpha:.6f}", *(f"{each:.4f}" for each in corners)]
        + [f"{each:.6f}" for each in numbers]
    )


def _calibration_text(intrinsics: Intrinsics) -> str:
    camera = " ".join(f"{each:.9g}" for each in np.column_stack([intrinsics.matrix, np.zeros(3)]).ravel())
    lines = [f"P{i}: {camera}" for i in range(4)]
    lines += ["R0_rect: 1 0 0 0 1 0 0 0 1", f"Tr_velo_to_cam: {CAMERA_FROM_LIDAR}", f"Tr_imu_to_velo: {LIDAR_FROM_IMU}"]
    return "\n".join(lines) + "\n"
