"""A plan or a dataset next to photographs: distributions of boxes and brightness, and the keys that change them."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float
from matplotlib.figure import Figure
from PIL import Image as Pictures
from scipy.stats import ks_2samp

from hulldown.assets.picture_files import read_pixels
from hulldown.base.errors import DatasetError
from hulldown.base.terminal import progress_bar
from hulldown.dataset.photographs import Photographs
from hulldown.dataset.reports.charts import two_histograms
from hulldown.dataset.table import Dataset
from hulldown.geometry.color import LUMINANCE
from hulldown.geometry.indices import even_sample

MOST_PICTURES = 500  # most measured pictures, spread evenly
MEASURED_SIDE_PX = 512  # pixels of the longer side at which pictures are measured


@dataclass(frozen=True, slots=True)
class Feature:
    """A feature of pictures or boxes: its title, the config keys that change it, and whether its bins are ratios."""

    title: str
    keys: str
    log: bool = False


FEATURES = {
    "height": Feature("box height / picture height", "camera.target_fraction or camera.like", log=True),
    "x": Feature("box center from left to right", "camera.framing or camera.like"),
    "y": Feature("box center from top to bottom", "camera.framing or camera.like"),
    "aspect": Feature("box width / height", "camera.elevation_deg, camera.like, or the models", log=True),
    "cut": Feature("boxes that the frame cuts off", "camera.truncated_fraction or camera.like"),
    "count": Feature("boxes in a picture", "placement.vehicles_per_image, budget.background_share, or camera.like"),
    "brightness": Feature("brightness (mean luma)", "light.exposure and light.exposure_error_ev"),
    "contrast": Feature("contrast (deviation of luma)", "light.hdris and weather"),
}
Values = dict[str, Float[np.ndarray, " n"]]  # of each feature by name


@dataclass(frozen=True, eq=False, slots=True)
class Comparison:
    """A dataset's values and those of photographs, of each feature that both have."""

    own: Values
    wanted: Values

    def distances(self) -> dict[str, float]:
        """Kolmogorov-Smirnov distance in each feature: the largest difference of the cumulative distributions."""
        return {
            name: float(ks_2samp(own, self.wanted[name], method="asymp").statistic) for name, own in self.own.items()
        }

    def rows(self) -> list[list[str]]:
        """Title, distance, and keys of each feature."""
        return [[FEATURES[name].title, f"{far:.2f}", FEATURES[name].keys] for name, far in self.distances().items()]

    def charts(self) -> dict[str, Figure]:
        """Histograms of dataset and photographs for each feature, by description."""
        return {
            f"{FEATURES[name].title}: this dataset and the photographs": two_histograms(
                FEATURES[name].title, own, self.wanted[name], log=FEATURES[name].log
            )
            for name, own in self.own.items()
        }


def compare_with_photographs(dataset: Dataset, photographs: Photographs, *, pixels: bool) -> Comparison:
    """Compare a dataset or a plan with photographs, feature by feature; pictures only with `pixels`."""
    boxes = dataset_boxes(dataset)
    for each in (photographs, boxes):
        if not len(each.image):
            raise DatasetError("has no boxes to compare", path=each.path, remedy="label some pictures")
    own, wanted = _box_values(boxes), _box_values(photographs)
    folder = photographs.path.parent
    files = [path for name in photographs.file_names if (path := _picture_inside(folder, name)) is not None]
    if pixels and not files:
        warnings.warn(f"{folder}: no pictures of the photographs; only boxes are compared", stacklevel=2)
    elif pixels:
        own |= _light_values(lambda i: dataset.picture(i, labels=False).convert("RGB"), len(dataset))
        wanted |= _light_values(lambda i: Pictures.fromarray(read_pixels(files[i])), len(files))
    return Comparison(own, wanted)


def dataset_boxes(dataset: Dataset) -> Photographs:
    """Return the boxes of a dataset or a plan in the form of photographs, without crowds."""
    labels, images = dataset.labels, dataset.of_images
    rows = np.flatnonzero(~labels["crowd"])
    image = labels["image"][rows]
    size = np.stack([images["width"], images["height"]], axis=1).astype(np.float64)
    xywh = np.stack([labels[key][rows] for key in ("x", "y", "width", "height")], axis=1)
    names, classes = np.unique(labels["category"][rows], return_inverse=True)
    cut = np.nan_to_num(labels["truncated_fraction"][rows]) > 0.0
    return Photographs(
        class_names=tuple(names.tolist()), image=image, class_index=classes, xywh=xywh, path=Path(dataset.name),
        sha256="", file_names=tuple(images["file_name"].tolist()), size=size,
        relative=xywh / np.tile(size[image], 2), cut=np.repeat(cut[:, None], 4, axis=1),
    )  # fmt: skip


def brightness_and_contrast(picture: Pictures.Image) -> tuple[float, float]:
    """Mean and standard deviation of an RGB picture's luma, from 0 to 1."""
    picture.thumbnail((MEASURED_SIDE_PX, MEASURED_SIDE_PX), Pictures.Resampling.LANCZOS)
    luma = np.asarray(picture) / 255.0 @ LUMINANCE
    return float(luma.mean()), float(luma.std())


def _box_values(photographs: Photographs) -> Values:
    x, y = photographs.center.T
    cut = photographs.cut.any(axis=1)
    columns = {"height": photographs.height, "x": x, "y": y, "aspect": photographs.aspect, "cut": cut}
    # Rounded, so that a box has the same value however it was computed.
    values = {name: column.astype(np.float64).round(9) for name, column in columns.items()}
    return values | {"count": photographs.count.astype(np.float64)}


def _light_values(picture: Callable[[int], Pictures.Image], count: int) -> Values:
    chosen = even_sample(count, MOST_PICTURES).tolist()
    found = []
    with progress_bar("comparing", None) as advance:
        for i in chosen:
            found.append(brightness_and_contrast(picture(i)))
            advance(len(found), len(chosen))
    return dict(zip(("brightness", "contrast"), np.array(found).T, strict=True))


def _picture_inside(folder: Path, name: str) -> Path | None:
    """Return a picture of a COCO file; None if it's missing, or outside of the file's folder."""
    path = folder / name
    return path if name and path.is_file() and path.resolve().is_relative_to(folder.resolve()) else None
