"""A plan or a dataset next to photographs: distributions of boxes and brightness, and the keys that change them."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
from jaxtyping import Float
from matplotlib.figure import Figure
from msgspec import Struct
from PIL import Image as Pictures
from scipy.stats import ks_2samp

from hulldown.assets.photographs import Photographs
from hulldown.assets.picture_files import read_pixels
from hulldown.base.errors import DatasetError
from hulldown.base.terminal import reporting
from hulldown.dataset.reports.charts import BINS, two_histograms
from hulldown.dataset.table import Dataset
from hulldown.geometry.color import LUMINANCE
from hulldown.geometry.indices import spread

MOST_PICTURES = 500  # most measured pictures, spread evenly
SIDE = 512  # pixels of the longer side at which pictures are measured


class Feature(Struct, frozen=True):
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


class ComparedFeature(Struct, frozen=True):
    """A feature of a dataset next to that of photographs."""

    distance: float  # Kolmogorov-Smirnov: the largest difference of the two cumulative distributions, 0 to 1
    keys: str
    edges: list[float]  # of common bins that hold nearly all values; one bin per value if they're few
    own: list[float]  # own, photographs: the share of values in each bin; outliers are in the first or last
    photographs: list[float]


class Comparison(Struct, frozen=True):
    """The comparison in all features that both have, by name."""

    photographs: str
    features: Mapping[str, ComparedFeature]

    def rows(self) -> list[list[str]]:
        """Title, distance, and keys of each feature."""
        return [[FEATURES[name].title, f"{one.distance:.2f}", one.keys] for name, one in self.features.items()]

    def charts(self) -> dict[str, Figure]:
        """Histograms of dataset and photographs for each feature, by description."""
        return {
            f"{FEATURES[name].title}: this dataset and the photographs": two_histograms(
                FEATURES[name].title, np.array(one.edges), np.array([one.own, one.photographs]), log=FEATURES[name].log
            )
            for name, one in self.features.items()
        }


def compare_with_photographs(dataset: Dataset, photographs: Photographs, *, pixels: bool) -> Comparison:
    """Compare a dataset or a plan with photographs, feature by feature; pictures only with `pixels`."""
    boxes = boxes_in(dataset)
    for each in (photographs, boxes):
        if not len(each.image):
            raise DatasetError("has no boxes to compare", path=each.path, remedy="label some pictures")
    own, wanted = _box_values(boxes), _box_values(photographs)
    folder = photographs.path.parent
    files = [path for name in photographs.file_names if (path := _inside(folder, name)) is not None]
    if pixels and not files:
        warnings.warn(f"{folder}: no pictures of the photographs; only boxes are compared", stacklevel=2)
    elif pixels:
        own |= _light_values(lambda i: dataset.picture(i, labels=False).convert("RGB"), len(dataset))
        wanted |= _light_values(lambda i: Pictures.fromarray(read_pixels(files[i])), len(files))
    features = {name: _compared(feature, own[name], wanted[name]) for name, feature in FEATURES.items() if name in own}
    return Comparison(str(photographs.path), features)


def boxes_in(dataset: Dataset) -> Photographs:
    """Return the boxes of a dataset or a plan in the form of photographs, without crowds."""
    labels, images = dataset.labels, dataset.of_images
    rows = np.flatnonzero(~labels["crowd"])
    image = labels["image"][rows]
    size = np.stack([images["width"], images["height"]], axis=1).astype(np.float64)
    xywh = np.stack([labels[key][rows] for key in ("x", "y", "width", "height")], axis=1) / np.tile(size[image], 2)
    cut = np.nan_to_num(labels["truncated_fraction"][rows]) > 0.0
    return Photographs(
        Path(dataset.name), "", tuple(images["file_name"].tolist()), size, image, xywh,
        tuple(labels["category"][rows].tolist()), np.repeat(cut[:, None], 4, axis=1),
    )  # fmt: skip


def brightness_and_contrast(picture: Pictures.Image) -> tuple[float, float]:
    """Mean and standard deviation of an RGB picture's luma, from 0 to 1."""
    picture.thumbnail((SIDE, SIDE), Pictures.Resampling.LANCZOS)
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
    chosen = spread(count, MOST_PICTURES).tolist()
    found = []
    with reporting("comparing", None) as advance:
        for i in chosen:
            found.append(brightness_and_contrast(picture(i)))
            advance(len(found), len(chosen))
    return dict(zip(("brightness", "contrast"), np.array(found).T, strict=True))


def _compared(feature: Feature, own: Float[np.ndarray, " n"], wanted: Float[np.ndarray, " m"]) -> ComparedFeature:
    both = np.concatenate([own, wanted])
    low, high = np.quantile(both, [0.005, 0.995])
    if len(different := np.unique(both)) <= BINS // 2 and (different == np.round(different)).all():
        edges = np.arange(different[0], different[-1] + 2) - 0.5
    elif feature.log:
        edges = np.geomspace(*((low, high) if low < high else (low / 2, high * 2)), BINS + 1)
    else:
        edges = np.linspace(*((low, high) if low < high else (low - 0.5, high + 0.5)), BINS + 1)
    shares = [np.histogram(np.clip(side, edges[0], edges[-1]), edges)[0] / len(side) for side in (own, wanted)]
    distance = float(ks_2samp(own, wanted, method="asymp").statistic)
    return ComparedFeature(distance, feature.keys, edges.tolist(), *(share.round(6).tolist() for share in shares))


def _inside(folder: Path, name: str) -> Path | None:
    """Return a picture of a COCO file; None if it's missing, or outside of the file's folder."""
    path = folder / name
    return path if name and path.is_file() and path.resolve().is_relative_to(folder.resolve()) else None
