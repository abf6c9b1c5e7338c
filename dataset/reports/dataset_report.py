"""A dataset or a plan as one HTML page: thumbnails with boxes, a table of classes, charts, and maps."""

from __future__ import annotations

import io
import warnings
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
from cyclopts import Parameter
from jaxtyping import Float
from matplotlib.figure import Figure
from PIL import Image as Pictures
from PIL import ImageDraw
from scipy.stats import ks_2samp

from hulldown.annotate.drawing import IGNORED_COLOR, category_color
from hulldown.assets.picture_files import read_pixels
from hulldown.base.arguments import AnyPath, Count, HtmlFile
from hulldown.base.color import LUMINANCE_WEIGHTS
from hulldown.base.errors import DatasetError
from hulldown.base.files import replace_file
from hulldown.base.indices import even_sample
from hulldown.base.outputs import require_replaceable_file
from hulldown.base.terminal import progress_bar
from hulldown.dataset.attributes import BOX_SIZE_SCALE, SCALES, camera_poses, pose_array
from hulldown.dataset.photographs import Photographs, read_photographs
from hulldown.dataset.reports.charts import (
    azimuth_chart,
    camera_map_chart,
    comparison_histogram_chart,
    histogram_chart,
    label_position_chart,
    name_count_chart,
)
from hulldown.dataset.reports.page import Tile, render_page
from hulldown.dataset.table import CONDITION_TITLES, Dataset
from hulldown.plan.library import Library, load_planned_library
from hulldown.plan.pictures.preview import Artist
from hulldown.plan.plan_file import read_plan
from hulldown.plan.summary import SIZE_CLASSES_PX2
from hulldown.reading.confinement.watch import DEFAULT_LIMITS, ReadLimits

MAX_THUMBNAILS = 1_000  # some 10 MB
THUMBNAIL_WIDTH_PX = 320
JPEG_QUALITY = 65
PAGE_MARK = b'content="hulldown"'  # every page by hulldown has this
MAX_MEASURED_PICTURES = 500  # spread evenly over the dataset
MEASURED_SIDE_PX = 512  # longer side of the pictures that are measured
Values = dict[str, Float[np.ndarray, " n"]]  # of each feature by name


def report_dataset(
    source: AnyPath,
    output: HtmlFile,
    *,
    images: Count = MAX_THUMBNAILS,
    photographs: Annotated[AnyPath | None, Parameter(name="--beside")] = None,
    cache: AnyPath | None = None,
    limits: ReadLimits = DEFAULT_LIMITS,
    library: Library | None = None,
) -> Comparison | None:
    """Show a dataset or a plan as a page.

    Reads a dataset's folder or a plan; writes one page with tables, charts, maps, and thumbnails that filter.

    Parameters
    ----------
    source
        The dataset or plan.
    output
        The page.
    images
        Most thumbnails, evenly spread.
    photographs
        A COCO folder or file of photographs, to compare each feature with, and name the keys that change it.
    cache
        Cache of a plan's assets; by default .hulldown-cache next to the plan.
    limits
        Time and memory for reading an asset.
    """
    source, out = Path(source), Path(output)
    if source.is_dir():
        dataset = Dataset.read(source)
    else:
        plan = read_plan(source)
        artist = Artist(plan, (library or load_planned_library(plan, cache=cache, limits=limits)).assets)
        dataset = Dataset.of_plan(plan, lambda i: artist.picture(plan[i], width=THUMBNAIL_WIDTH_PX, labels=False))
    if not dataset.images:
        raise DatasetError("has no images yet", path=source, remedy="render some first")
    require_replaceable_file(out, "a page", PAGE_MARK)
    comparison = None
    if photographs is not None:
        comparison = compare_with_photographs(dataset, read_photographs(Path(photographs)), pixels=source.is_dir())
    chosen = even_sample(len(dataset), images)
    tiles = []
    with progress_bar("thumbnails", None) as advance:
        for i in chosen.tolist():
            tiles.append(_image_tile(dataset, i))
            advance(len(tiles), len(chosen))
    page = render_page(
        "dataset/reports/report.html",
        {
            "dataset": dataset,
            "comparison": comparison,
            "tiles": tiles,
            "facts": _dataset_facts(dataset),
            "sizes": SIZE_CLASSES_PX2,
            "classes": _class_rows(dataset),
            "charts": _label_charts(dataset),
            "maps": _scenery_maps(dataset),
        },
    )
    replace_file(out, page.encode())
    return comparison


def _dataset_facts(dataset: Dataset) -> list[str]:
    images = dataset.of_images
    places = len({(s, p) for s, p in zip(images["scenery"], images["position"], strict=True) if s and p == p})
    counts = {
        "images": len(dataset),
        "images without labels": int((images["labels"] == 0).sum()),
        "positions": places,
        "labels": len(dataset.labels["id"]),
        "classes": len(dataset.categories),
    }
    return [f"{name}: {count:,}" for name, count in counts.items()]


def _class_rows(dataset: Dataset) -> list[list[str]]:
    labels, rows = dataset.labels, []
    for name in dataset.categories.values():
        of_class = labels["category"] == name
        sizes = np.histogram(labels["box_size"][of_class], np.sqrt([0.0, *SIZE_CLASSES_PX2.values()]))[0].tolist()
        vehicles = Counter(one for one in labels["vehicle"][of_class].tolist() if one)
        shown = len(np.unique(labels["image"][of_class]))
        models = ", ".join(f"{vehicle} {n:,}" for vehicle, n in sorted(vehicles.items()))
        rows.append([name, f"{shown:,}", f"{of_class.sum():,}", *(f"{n:,}" for n in sizes), models])
    return rows


def _label_charts(dataset: Dataset) -> dict[str, Figure]:
    labels, images, charts = dataset.labels, dataset.of_images, {}
    for scale in (BOX_SIZE_SCALE, *SCALES):
        if np.isfinite(values := labels[scale.name]).any():
            title = f"{scale.title}, {scale.unit}" if scale.unit else scale.title
            charts[title] = histogram_chart(title, values, log=scale.name in ("box_size", "distance"))
    if np.isfinite(labels["azimuth"]).any():
        charts["side seen"] = azimuth_chart(labels["azimuth"])
    sizes = np.stack([images["width"], images["height"]], axis=1)[labels["image"]]
    if len(sizes):
        centers = np.stack([labels["x"] + labels["width"] / 2, labels["y"] + labels["height"] / 2], axis=1)
        charts["label positions"] = label_position_chart(centers / sizes)
    charts |= {
        title: name_count_chart(title, images[key]) for key, title in CONDITION_TITLES.items() if (images[key] != "").any()
    }
    if np.isfinite(images["strength"]).any():
        charts["strength of light"] = histogram_chart("strength of light", images["strength"])
    return charts


def _scenery_maps(dataset: Dataset) -> dict[str, Figure]:
    scenery = dataset.of_images["scenery"]
    cameras = camera_poses(dataset.images)[:, :2, 3]
    firsts = (image.labels[0] if image.labels else None for image in dataset.images)
    vehicles = pose_array([None if first is None else first.world_from_vehicle for first in firsts])[:, :2, 3]
    known = np.isfinite(cameras).all(axis=1)
    return {
        f"map of {name}": camera_map_chart(name, *(side[known & (scenery == name)] for side in (cameras, vehicles)))
        for name in np.unique(scenery[known]).tolist()
        if name
    }


def _image_tile(dataset: Dataset, i: int) -> Tile:
    labels, images = dataset.labels, dataset.of_images
    rows = np.flatnonzero(labels["image"] == i)
    values = {
        "class": _sorted_unique_names(labels["category"][rows]) or ["none"],
        "vehicle": _sorted_unique_names(labels["vehicle"][rows]),
    }
    values |= {title: _sorted_unique_names(images[key][[i]]) for key, title in CONDITION_TITLES.items()}
    values["side seen"] = _sorted_unique_names(labels["side"][rows])
    lines = [", ".join(_label_caption_parts(dataset, row)) for row in rows.tolist()] or ["no labels"]
    lines.append(", ".join(filter(None, (str(images[key][i]) for key in CONDITION_TITLES))))
    return Tile(_labeled_thumbnail_jpeg(dataset, i), [dataset.images[i].file_name, *filter(None, lines)], values)


def _label_caption_parts(dataset: Dataset, row: int) -> list[str]:
    labels = dataset.labels
    caption = [str(labels["category"][row]), str(labels["vehicle"][row])]
    caption.append(f"{labels['width'][row]:.0f} x {labels['height'][row]:.0f} px")
    if np.isfinite(distance := labels["distance"][row]):
        caption.append(f"{distance:.0f} m")
    if np.isfinite(visible := labels["visible_fraction"][row]):
        caption.append(f"{100 * visible:.0f} % visible")
    return [each for each in caption if each]


def _labeled_thumbnail_jpeg(dataset: Dataset, i: int) -> bytes:
    image, file = dataset.images[i], io.BytesIO()
    small = dataset.picture(i, labels=False).convert("RGB")
    small.thumbnail((THUMBNAIL_WIDTH_PX, small.height), Pictures.Resampling.LANCZOS)
    pen = ImageDraw.Draw(small)
    for label in image.labels:
        x, y, w, h = (label.bbox * small.width / image.width).tolist()
        color = IGNORED_COLOR if label.crowd else category_color(label.category_id)
        pen.rectangle((x - 1, y - 1, x + max(w, 0.0), y + max(h, 0.0)), outline=color)
    small.save(file, "JPEG", quality=JPEG_QUALITY, optimize=True)
    return file.getvalue()


def _sorted_unique_names(values: np.ndarray) -> list[str]:
    return sorted({value for value in values.tolist() if value})


@dataclass(frozen=True, slots=True)
class Feature:
    """A feature of pictures or boxes: its title, the config keys that change it, and whether its bins are ratios."""

    title: str
    keys: str
    log: bool = False


REPORT_FEATURES = {
    "height": Feature("box height / picture height", "camera.target_fraction or camera.like", log=True),
    "x": Feature("box center from left to right", "camera.framing or camera.like"),
    "y": Feature("box center from top to bottom", "camera.framing or camera.like"),
    "aspect": Feature("box width / height", "camera.elevation_deg, camera.like, or the models", log=True),
    "cut": Feature("boxes that the frame cuts off", "camera.truncated_fraction or camera.like"),
    "count": Feature("boxes in a picture", "placement.vehicles_per_image, budget.background_share, or camera.like"),
    "brightness": Feature("brightness (mean luma)", "light.exposure and light.exposure_error_ev"),
    "contrast": Feature("contrast (deviation of luma)", "light.hdris and weather"),
}


@dataclass(frozen=True, eq=False, slots=True)
class Comparison:
    """The values of each feature that a dataset and photographs have."""

    own: Values
    wanted: Values

    def distances(self) -> dict[str, float]:
        """Kolmogorov-Smirnov distance in each feature: the largest difference of the cumulative distributions."""
        return {name: float(ks_2samp(own, self.wanted[name], method="asymp").statistic) for name, own in self.own.items()}

    def rows(self) -> list[list[str]]:
        """Title, distance, and keys of each feature."""
        return [
            [REPORT_FEATURES[name].title, f"{far:.2f}", REPORT_FEATURES[name].keys] for name, far in self.distances().items()
        ]

    def feature_charts(self) -> dict[str, Figure]:
        """Histograms of dataset and photographs for each feature, by description."""
        return {
            f"{REPORT_FEATURES[name].title}: this dataset and the photographs": comparison_histogram_chart(
                REPORT_FEATURES[name].title, own, self.wanted[name], log=REPORT_FEATURES[name].log
            )
            for name, own in self.own.items()
        }


def compare_with_photographs(dataset: Dataset, photographs: Photographs, *, pixels: bool) -> Comparison:
    """Compare a dataset or plan with photographs, feature by feature; features of pictures only if `pixels` is true."""
    boxes = boxes_as_photographs(dataset)
    for each in (photographs, boxes):
        if not len(each.image):
            raise DatasetError("has no boxes to compare", path=each.path, remedy="label some pictures")
    own, wanted = _box_feature_values(boxes), _box_feature_values(photographs)
    folder = photographs.path.parent
    files = [path for name in photographs.file_names if (path := _picture_path_inside(folder, name)) is not None]
    if pixels and not files:
        warnings.warn(f"{folder}: no pictures of the photographs; only boxes are compared", stacklevel=2)
    elif pixels:
        own |= _light_feature_values(lambda i: dataset.picture(i, labels=False).convert("RGB"), len(dataset))
        wanted |= _light_feature_values(lambda i: Pictures.fromarray(read_pixels(files[i])), len(files))
    return Comparison(own, wanted)


def boxes_as_photographs(dataset: Dataset) -> Photographs:
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
    luma = np.asarray(picture) / 255.0 @ LUMINANCE_WEIGHTS
    return float(luma.mean()), float(luma.std())


def _box_feature_values(photographs: Photographs) -> Values:
    x, y = photographs.center.T
    cut = photographs.cut.any(axis=1)
    columns = {"height": photographs.height, "x": x, "y": y, "aspect": photographs.aspect, "cut": cut}
    # Rounded, so that a box has the same value however it was computed.
    values = {name: column.astype(np.float64).round(9) for name, column in columns.items()}
    return values | {"count": photographs.count.astype(np.float64)}


def _light_feature_values(picture: Callable[[int], Pictures.Image], count: int) -> Values:
    chosen = even_sample(count, MAX_MEASURED_PICTURES).tolist()
    found = []
    with progress_bar("comparing", None) as advance:
        for i in chosen:
            found.append(brightness_and_contrast(picture(i)))
            advance(len(found), len(chosen))
    return dict(zip(("brightness", "contrast"), np.array(found).T, strict=True))


def _picture_path_inside(folder: Path, name: str) -> Path | None:
    path = folder / name
    return path if name and path.is_file() and path.resolve().is_relative_to(folder.resolve()) else None
