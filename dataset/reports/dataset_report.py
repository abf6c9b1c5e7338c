"""A dataset or a plan as one HTML page: tables, charts, maps, and thumbnails."""

from __future__ import annotations

import io
from collections import Counter
from pathlib import Path
from typing import Annotated

import numpy as np
from cyclopts import Parameter
from jaxtyping import Float
from matplotlib.figure import Figure
from PIL import Image as Pictures

from hulldown.annotate.outlines import polygons
from hulldown.annotate.rectangles import rectangle_corners
from hulldown.assets.photographs import read_photographs
from hulldown.base.arguments import AnyPath, Count, HtmlFile
from hulldown.base.errors import DatasetError
from hulldown.base.files import make_room, replace_file
from hulldown.base.terminal import reporting
from hulldown.dataset.attributes import SCALES, SIDES, SIZE, bins_of, camera_poses, poses
from hulldown.dataset.images import Image, Label
from hulldown.dataset.labels.mask import MASK
from hulldown.dataset.labels.oriented_box import rectangle_of
from hulldown.dataset.reports.charts import azimuths, histogram, place_map, places_in_pictures, shares
from hulldown.dataset.reports.comparison import Comparison, compare_with_photographs
from hulldown.dataset.reports.page import Facet, Shape, Tile, render
from hulldown.dataset.table import CONDITIONS, Dataset
from hulldown.geometry.indices import spread
from hulldown.pictures.drawing import color_of
from hulldown.pictures.own_files import refuse_foreign
from hulldown.planning.inputs.loading import Library, load_planned_library
from hulldown.planning.pictures.preview import Artist
from hulldown.planning.plan_file import read_plan
from hulldown.planning.summary import SIZES
from hulldown.reading.confinement.watch import DEFAULT_LIMITS, ReadLimits

MOST_THUMBNAILS = 1_000  # thumbnails on a page: some 15 MB
THUMBNAIL_WIDTH = 320  # pixels of a thumbnail
QUALITY = 65  # of JPEG
MARK = b'content="hulldown"'  # of a page by hulldown
ORDERS = (SIZE, *SCALES)


def report(
    source: AnyPath,
    output: HtmlFile,
    *,
    images: Count = MOST_THUMBNAILS,
    photographs: Annotated[AnyPath | None, Parameter(name="--beside")] = None,
    cache: AnyPath | None = None,
    limits: ReadLimits = DEFAULT_LIMITS,
    library: Library | None = None,
) -> Comparison | None:
    """Show a dataset or a plan as a page.

    Reads a dataset's folder or a plan; writes one page with tables, charts, maps, and thumbnails that filter by every
    field.

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
        dataset = Dataset.of_plan(plan, lambda i: artist.picture(plan[i], width=THUMBNAIL_WIDTH, labels=False))
    if not dataset.images:
        raise DatasetError("has no images yet", path=source, remedy="render some first")
    make_room(out)
    refuse_foreign(out, MARK)
    comparison = None
    if photographs is not None:
        comparison = compare_with_photographs(dataset, read_photographs(Path(photographs)), pixels=source.is_dir())
    chosen = spread(len(dataset), images)
    tiles = []
    with reporting("thumbnails", None) as advance:
        for i in chosen.tolist():
            tiles.append(_tile(dataset, i))
            advance(len(tiles), len(chosen))
    page = render(
        "dataset/reports/report.html",
        {
            "dataset": dataset,
            "comparison": comparison,
            "tiles": tiles,
            "facets": _facets(dataset),
            "orders": {scale.name: scale.title for scale in ORDERS},
            "facts": _facts(dataset),
            "sizes": SIZES,
            "classes": _classes(dataset),
            "charts": [
                ("Labels", "", _of_labels(dataset)),
                ("Sceneries, light, and weather", "", _of_conditions(dataset)),
                ("Maps", "Dots are vehicles, ends of lines are cameras. Meters.", _maps(dataset)),
            ],
        },
    )
    replace_file(out, page.encode())
    return comparison


def _facts(dataset: Dataset) -> list[str]:
    """Numbers of images, labels, and positions."""
    images = dataset.of_images
    empty = int((images["labels"] == 0).sum())
    places = len({(s, p) for s, p in zip(images["scenery"], images["position"], strict=True) if s and p == p})
    classes = _number(len(dataset.categories), "class", "classes")
    facts = [_number(len(dataset), "image"), f"{_number(len(dataset.labels['id']), 'label')} of {classes}"]
    facts += [f"{_number(empty, 'image')} without labels"] if empty else []
    return facts + ([_number(places, "position")] if places else [])


def _classes(dataset: Dataset) -> list[list[str]]:
    """Return the row of each class: its name, images, labels, labels by size, and vehicles."""
    labels, rows = dataset.labels, []
    for name in dataset.categories.values():
        of_class = labels["category"] == name
        sizes = np.histogram(labels["box_size"][of_class], np.sqrt([0.0, *SIZES.values()]))[0].tolist()
        vehicles = Counter(one for one in labels["vehicle"][of_class].tolist() if one)
        shown = len(np.unique(labels["image"][of_class]))
        models = ", ".join(f"{vehicle} {n:,}" for vehicle, n in sorted(vehicles.items()))
        rows.append([name, f"{shown:,}", f"{of_class.sum():,}", *(f"{n:,}" for n in sizes), models])
    return rows


def _of_labels(dataset: Dataset) -> dict[str, Figure]:
    """Charts of the labels by title."""
    labels, images, charts = dataset.labels, dataset.of_images, {}
    for scale in ORDERS:
        if np.isfinite(values := labels[scale.name]).any():
            title = f"{scale.title}, {scale.unit}" if scale.unit else scale.title
            charts[title] = histogram(title, values, log=scale.name in ("box_size", "distance"))
    if np.isfinite(labels["azimuth"]).any():
        charts["side seen"] = azimuths(labels["azimuth"])
    sizes = np.stack([images["width"], images["height"]], axis=1)[labels["image"]]
    if len(sizes):
        centers = np.stack([labels["x"] + labels["width"] / 2, labels["y"] + labels["height"] / 2], axis=1)
        charts["label positions"] = places_in_pictures(centers / sizes)
    return charts


def _of_conditions(dataset: Dataset) -> dict[str, Figure]:
    """Charts of sceneries, light, and weather by title."""
    images = dataset.of_images
    charts = {title: shares(title, images[key]) for key, title in CONDITIONS.items() if (images[key] != "").any()}
    if np.isfinite(images["strength"]).any():
        charts["strength of light"] = histogram("strength of light", images["strength"])
    return charts


def _maps(dataset: Dataset) -> dict[str, Figure]:
    """Return a map of vehicles and cameras for each scenery."""
    scenery = dataset.of_images["scenery"]
    cameras = camera_poses(dataset.images)[:, :2, 3]
    firsts = (image.labels[0] if image.labels else None for image in dataset.images)
    vehicles = poses([None if first is None else first.world_from_vehicle for first in firsts])[:, :2, 3]
    known = np.isfinite(cameras).all(axis=1)
    return {
        f"map of {name}": place_map(name, *(side[known & (scenery == name)] for side in (cameras, vehicles)))
        for name in np.unique(scenery[known]).tolist()
        if name
    }


def _facets(dataset: Dataset) -> list[Facet]:
    return [
        ("class", "class", [*dataset.categories.values(), "none"]),
        ("vehicle", "vehicle", _names(dataset.labels["vehicle"])),
        *((key, title, _names(dataset.of_images[key])) for key, title in CONDITIONS.items()),
        *((scale.name, scale.title, scale.bins) for scale in ORDERS),
        ("side", "side seen", SIDES),
    ]


def _tile(dataset: Dataset, i: int) -> Tile:
    """Return an image's thumbnail: facets of all its labels, sort values of its first."""
    image, labels, images = dataset.images[i], dataset.labels, dataset.of_images
    rows = np.flatnonzero(labels["image"] == i)
    conditions = [str(images[key][i]) for key in CONDITIONS]
    values = {"class": _names(labels["category"][rows]) or ["none"]}
    values |= {key: _names(labels[key][rows]) for key in ("vehicle", "side")}
    values |= {key: [value] for key, value in zip(CONDITIONS, conditions, strict=True)}
    for scale in ORDERS:
        bins = bins_of(labels[scale.name][rows], scale)
        values[scale.name] = [scale.bins[b] for b in np.unique(bins[bins >= 0])]
    numbers = {scale.name: float(labels[scale.name][rows[0]]) for scale in ORDERS} if len(rows) else {}
    lines = [image.file_name]
    lines += [", ".join(_about(dataset, row)) for row in rows.tolist()] or ["no labels"]
    lines.append(", ".join(filter(None, conditions)))
    picture = _thumbnail(dataset.picture(i, labels=False))
    caption = [each for each in lines if each]
    return Tile(picture, caption, values, numbers, (image.width, image.height), _shapes(image, dataset))


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


def _shapes(image: Image, dataset: Dataset) -> list[Shape]:
    """Return an image's masks, oriented boxes, and boxes."""
    masks, lines, boxes = [], [], []
    for label in image.labels:
        color = "rgb({},{},{})".format(*color_of(label.category_id))
        if mask := MASK.read(label).segmentation:
            within = image.width / THUMBNAIL_WIDTH / 2  # half a pixel of the thumbnail
            try:
                rings = polygons(mask, *image.size, within=within)
            except ValueError as error:
                remedy = "check the dataset with `hulldown verify`"
                raise DatasetError(f"{image.file_name}: {error}", path=Path(dataset.name), remedy=remedy) from None
            masks += [Shape("mask", color, np.reshape(ring, (-1, 2)).tolist()) for ring in rings]
        lines += [Shape("thin", color, ring.tolist()) for ring in _oriented(label, image)]
        x, y, w, h = label.bbox.tolist()
        corners = [(x, y), (x + w, y), (x + w, y + h), (x, y + h), (x, y)]
        boxes.append(Shape("ignored" if label.crowd else "box", color, corners, label.category))
    return masks + lines + boxes


def _oriented(label: Label, image: Image) -> list[Float[np.ndarray, "_ 2"]]:
    """Return lines around the visible mask, and around the ground under the vehicle, with an arrow to its front."""
    rings = [] if (visible := rectangle_of(label)) is None else [rectangle_corners(visible)]
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
