"""A dataset or a plan as one HTML page: tables, charts, maps, and thumbnails."""

from __future__ import annotations

import contextlib
import io
import math
import os
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from PIL import Image as Pictures

from hulldown.annotate.drawing import color_of
from hulldown.annotate.known import SCALES, SIDES, SIZE, bins_of, poses_of
from hulldown.annotate.oriented import rectangle_corners
from hulldown.annotate.outlines import polygons
from hulldown.assets.photographs import read_photographs
from hulldown.dataset.oriented import ground_corners, is_rectangle
from hulldown.dataset.reports.charts import azimuths, histogram, place_map, places_in_pictures, shares
from hulldown.dataset.reports.comparison import Comparison, Encoder, compare
from hulldown.dataset.reports.page import (
    GENERATOR,
    Charts,
    Facet,
    Gallery,
    Overlay,
    PageSection,
    Table,
    Tile,
    Words,
    page,
)
from hulldown.dataset.table import CONDITIONS, Dataset, Image
from hulldown.geometry.arrays import spread
from hulldown.geometry.errors import DatasetError
from hulldown.geometry.files import replace_file
from hulldown.geometry.terminal import reading_status, shown
from hulldown.planning.inputs.loading import load_planned_library
from hulldown.planning.pictures.preview import Artist
from hulldown.planning.plan_file import read_plan
from hulldown.reading.confinement.watch import DEFAULT_LIMITS, ReadLimits

MOST = 1_000  # thumbnails on a page: some 15 MB
THUMBNAIL_WIDTH = 320  # pixels of a thumbnail
QUALITY = 65  # of JPEG
COCO_SIZES = {"small": (0.0, 32.0), "medium": (32.0, 96.0), "large": (96.0, math.inf)}
ORDERS = (SIZE, *SCALES)


def report(
    source: Path | str,
    out: Path | str,
    *,
    photographs: Path | str | None = None,
    encode: Encoder | None = None,
    most: int = MOST,
    cache: str | os.PathLike[str] | None = None,
    limits: ReadLimits = DEFAULT_LIMITS,
) -> Comparison | None:
    """Write the page about a dataset's folder or a plan's file; compare it with photographs if given.

    Parameters
    ----------
    source, out
        The dataset or plan, and the page's file; see `write_report`.
    photographs
        A COCO folder or file.
    encode, most
        See `compare` and `write_report`; pictures of plans are previews, which aren't compared.
    cache, limits
        Of reading a plan's assets; see `planning.inputs.loading.load_planned_library`.

    Raises
    ------
    HulldownError
        If the source, one of its assets, or the photographs are unusable, or the page can't be written.
    """
    source = Path(source)
    if source.is_dir():
        dataset = Dataset.read(source)
    else:
        plan = read_plan(source)
        with reading_status() as progress:
            assets = load_planned_library(plan, cache=cache, progress=progress, limits=limits).assets
        artist = Artist(plan, assets)
        dataset = Dataset.of_plan(plan, lambda i: artist.picture(plan[i], width=THUMBNAIL_WIDTH, labels=False))
    comparison = None
    if photographs is not None:
        comparison = compare(dataset, read_photographs(Path(photographs)), pixels=source.is_dir(), encode=encode)
    write_report(dataset, out, most=most, comparison=comparison)
    return comparison


def write_report(
    dataset: Dataset,
    path: Path | str,
    *,
    most: int = MOST,
    comparison: Comparison | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> None:
    """Write a self-contained page: tables, charts, maps, and thumbnails that filter by every field.

    Parameters
    ----------
    dataset
        The dataset or plan.
    path
        The page's file; a page by hulldown is replaced.
    most
        Most thumbnails; of more images an even selection is shown.
    comparison
        A comparison with photographs, shown first.
    progress
        Called with (done, all) after each thumbnail; None: a bar in a terminal or notebook.

    Raises
    ------
    DatasetError
        If the dataset has no images, a picture cannot be read, or `path` is somebody else's file.
    """
    path = Path(path)
    if not dataset.images:
        raise DatasetError("has no images yet", path=Path(dataset.name), remedy="render some first")
    _refuse_foreign(path)
    chosen = spread(len(dataset.images), most)
    tiles = []
    with shown("thumbnails", progress) as advance:
        for done, i in enumerate(chosen.tolist(), start=1):
            tiles.append(_tile(dataset, i))
            advance(done, len(chosen))
    first = [comparison.section()] if comparison else []
    sections = [*first, _looks(dataset, tiles), _counts(dataset), *_charts(dataset), *_maps(dataset)]
    text = page(f"Dataset {dataset.name}", sections)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        replace_file(path, text.encode())
    except OSError as error:
        remedy = "choose a file that you may write to"
        raise DatasetError(f"cannot be written ({error.strerror})", path=path, remedy=remedy) from error


def _counts(dataset: Dataset) -> PageSection:
    labels, images = dataset.labels, dataset.of_images
    empty = int((images["labels"] == 0).sum())
    places = len({(s, p) for s, p in zip(images["scenery"], images["position"], strict=True) if s and p == p})
    classes = _number(len(dataset.categories), "class", "classes")
    facts = [_number(len(dataset.images), "image"), f"{_number(len(labels['id']), 'label')} of {classes}"]
    facts += [f"{_number(empty, 'image')} without labels"] if empty else []
    facts += [_number(places, "position")] if places else []
    rows = []
    for name in dataset.categories.values():
        of_class = labels["category"] == name
        sizes = [
            int(((labels["box_size"] >= low) & (labels["box_size"] < high) & of_class).sum())
            for low, high in COCO_SIZES.values()
        ]
        vehicles = Counter(one for one in labels["vehicle"][of_class].tolist() if one)
        shown = len(np.unique(labels["image"][of_class]))
        models = ", ".join(f"{vehicle} {n:,}" for vehicle, n in sorted(vehicles.items()))
        rows.append([name, f"{shown:,}", f"{of_class.sum():,}", *(f"{n:,}" for n in sizes), models])
    header = ["class", "images", "labels", *COCO_SIZES, "vehicles"]
    table = Table(header, rows, choose=[{"class": row[0]} for row in rows])
    return PageSection("Contents", [Words(", ".join(facts) + "."), table])


def _charts(dataset: Dataset) -> list[PageSection]:
    labels, images = dataset.labels, dataset.of_images
    charts = []
    for scale in ORDERS:
        values = labels[scale.name]
        if np.isfinite(values).any():
            title = f"{scale.title}, {scale.unit}" if scale.unit else scale.title
            charts.append(histogram(title, values, log=scale.name in ("box_size", "distance")))
    if np.isfinite(labels["azimuth"]).any():
        charts.append(azimuths(labels["azimuth"]))
    sizes = np.stack([images["width"], images["height"]], axis=1)[labels["image"]]
    if len(sizes):
        centers = np.stack([labels["x"] + labels["width"] / 2, labels["y"] + labels["height"] / 2], axis=1)
        charts.append(places_in_pictures(centers / sizes))
    light = [shares(title, images[key]) for key, title in CONDITIONS.items() if (images[key] != "").any()]
    if np.isfinite(images["strength"]).any():
        light.append(histogram("strength of light", images["strength"]))
    sections = [PageSection("Labels", [Charts(charts)])] if charts else []
    return sections + ([PageSection("Sceneries, light, and weather", [Charts(light)])] if light else [])


def _maps(dataset: Dataset) -> list[PageSection]:
    """A map of vehicles and cameras for each scenery."""
    scenery = dataset.of_images["scenery"]
    cameras = poses_of([image.record for image in dataset.images], "world_from_camera")[:, :2, 3]
    firsts = [image.labels[0].record if image.labels else {} for image in dataset.images]
    vehicles = poses_of(firsts, "world_from_vehicle")[:, :2, 3]
    known = np.isfinite(cameras).all(axis=1)
    names = [name for name in np.unique(scenery[known]).tolist() if name]
    if not names:
        return []
    charts = [place_map(name, *(side[known & (scenery == name)] for side in (cameras, vehicles))) for name in names]
    return [PageSection("Maps", [Words("Dots are vehicles, ends of lines are cameras. Meters."), Charts(charts)])]


def _looks(dataset: Dataset, tiles: Sequence[Tile]) -> PageSection:
    shown, every = len(tiles), len(dataset.images)
    legend = [Words(f"{shown:,} images, an even selection of {every:,}.")] if shown < every else []
    facets = [
        Facet("class", "class", [*dataset.categories.values(), "none"]),
        Facet("vehicle", "vehicle", _names(dataset.labels["vehicle"])),
        *(Facet(key, title, _names(dataset.of_images[key])) for key, title in CONDITIONS.items()),
        *(Facet(scale.name, scale.title, scale.bins) for scale in ORDERS),
        Facet("side", "side seen", SIDES),
    ]
    orders = {scale.name: scale.title for scale in ORDERS}
    return PageSection("Images", [*legend, Gallery(tiles, facets, orders)])


def _tile(dataset: Dataset, i: int) -> Tile:
    """An image's thumbnail: facets of all its labels, sort values of its first."""
    image, labels, images = dataset.images[i], dataset.labels, dataset.of_images
    rows = np.flatnonzero(labels["image"] == i)
    values: dict[str, str | Sequence[str]] = {"class": _names(labels["category"][rows]) or "none"}
    values |= {key: _names(labels[key][rows]) for key in ("vehicle", "side")}
    conditions = {key: str(images[key][i]) for key in CONDITIONS}
    for scale in ORDERS:
        bins = bins_of(labels[scale.name][rows], scale)
        values[scale.name] = [scale.bins[b] for b in np.unique(bins[bins >= 0])]
    numbers = {scale.name: float(labels[scale.name][rows[0]]) for scale in ORDERS} if len(rows) else {}
    lines = [image.file_name]
    lines += [", ".join(_about(dataset, row)) for row in rows.tolist()] or ["no labels"]
    lines.append(", ".join(filter(None, conditions.values())))
    return Tile(
        _thumbnail(dataset.picture(i, labels=False)),
        [each for each in lines if each],
        values | conditions,
        numbers,
        _overlay(image, dataset),
    )


def _about(dataset: Dataset, row: int) -> list[str]:
    labels = dataset.labels
    caption = [str(labels["category"][row]), str(labels["vehicle"][row])]
    caption.append(f"{labels['width'][row]:.0f} x {labels['height'][row]:.0f} px")
    if np.isfinite(distance := labels["distance"][row]):
        caption.append(f"{distance:.0f} m")
    if np.isfinite(visible := labels["visible_fraction"][row]):
        caption.append(f"{100 * visible:.0f} % visible")
    if np.isfinite(cut := labels["truncated_fraction"][row]) and cut > 0:
        caption.append(f"{100 * cut:.0f} % outside")
    return [each for each in caption if each]


def _overlay(image: Image, dataset: Dataset) -> Overlay | None:
    """Return an image's boxes, masks, and oriented boxes; None if it has no label."""
    ids = {name: number for number, name in dataset.categories.items()}
    boxes, masks, lines = [], [], []
    for label in image.labels:
        color = "rgb({},{},{})".format(*color_of(ids[label.category]))
        if label.record.get("segmentation"):
            within = image.width / THUMBNAIL_WIDTH / 2  # half a pixel of the thumbnail
            try:
                rings = polygons(label.record["segmentation"], image.width, image.height, within=within)
            except ValueError as error:
                remedy = "check the dataset with `hulldown verify`"
                raise DatasetError(f"{image.file_name}: {error}", path=Path(dataset.name), remedy=remedy) from None
            masks += [(np.reshape(ring, (-1, 2)).tolist(), color) for ring in rings]
        lines += [(ring.tolist(), color) for ring in _oriented(label.record, image.record)]
        x, y, w, h = label.bbox.tolist()
        boxes.append(((x, y, w, h), color, label.category, label.crowd))
    return Overlay((image.width, image.height), boxes, masks, lines) if boxes else None


def _oriented(label: Mapping[str, Any], image: Mapping[str, Any]) -> list[Float[np.ndarray, "_ 2"]]:
    """Lines around the visible mask, and around the ground under the vehicle, with an arrow to its front."""
    rings = [rectangle_corners(label["obb"])] if is_rectangle(label.get("obb")) else []
    if label.get("bbox_3d") is not None:
        with contextlib.suppress(DatasetError):  # a part of it is behind the camera
            ground = ground_corners(label, image)
            rings += [ground, np.stack([ground[3], ground[:2].mean(axis=0), ground[2]])]
    return [np.concatenate([ring, ring[:1]]) if len(ring) == 4 else ring for ring in rings]


def _thumbnail(picture: Pictures.Image) -> bytes:
    file = io.BytesIO()
    small = picture.convert("RGB")
    small.thumbnail((THUMBNAIL_WIDTH, small.height), Pictures.Resampling.LANCZOS)
    small.save(file, "JPEG", quality=QUALITY, optimize=True)
    return file.getvalue()


def _number(count: int, singular: str, plural: str = "") -> str:
    return f"{count:,} {singular if count == 1 else plural or singular + 's'}"


def _names(values: np.ndarray) -> list[str]:
    return sorted({value for value in values.tolist() if value})


def _refuse_foreign(path: Path) -> None:
    """Refuse to replace a file that isn't a page by hulldown."""
    try:
        with path.open("rb") as file:
            ours = f'content="{GENERATOR}"'.encode() in file.read(2000)
    except FileNotFoundError:
        return
    except OSError as error:
        raise DatasetError(f"cannot be written ({error.strerror})", path=path, remedy="choose another name") from error
    if not ours:
        raise DatasetError("exists and isn't a hulldown report", path=path, remedy="choose another name")
