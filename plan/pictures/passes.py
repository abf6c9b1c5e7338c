"""Depth, normals, instances, parts, and classes at the pixel centers of a plan's images, by rays alone."""

from __future__ import annotations

import hashlib
import io
import os
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import msgspec
import numpy as np
from jaxtyping import Float32, UInt8, UInt16
from msgspec import UNSET, Struct, UnsetType
from PIL import Image

from hulldown.assets.plan_assets import Assets
from hulldown.assets.scenery import Scenery
from hulldown.base.arguments import AnyPath, Count
from hulldown.base.errors import ConfigError, HulldownError
from hulldown.base.files import replace_file
from hulldown.base.indices import even_sample
from hulldown.base.outputs import OutputFolder
from hulldown.base.outside import read_json
from hulldown.base.terminal import track_items
from hulldown.plan.library import load_planned_library
from hulldown.plan.lines import PlanFile
from hulldown.plan.pictures.preview import Artist
from hulldown.plan.row import Row, encode_line
from hulldown.reading.confinement.watch import DEFAULT_LIMITS, ReadLimits
from hulldown.scene.camera_pencils import PixelRays
from hulldown.scene.rays import Hits, SurfaceKind

# folder and suffix of each pass
PASS_MEANINGS = {
    "depth": ("depth", ".npz"),
    "normal": ("normal", ".npz"),
    "instance": ("instance", ".png"),
    "part": ("part", ".png"),
    "category": ("panoptic", ".png"),
}
STUFF_CLASSES = ("ground", "obstacle", "water", "distractor", "sky")  # classes without instances in COCO panoptic
FIRST_STUFF_SEGMENT = 1 << 16  # segments of vehicles have their instance numbers
MAX_INSTANCES = (1 << 16) - 1


class Instance(Struct, frozen=True):
    """A vehicle or surface in an image, numbered from 1; only vehicles have a class and a label."""

    id: int
    kind: str
    name: str
    category: str | UnsetType | None = UNSET
    label: str | UnsetType = UNSET


class Segment(Struct, frozen=True):
    """A segment of an image in COCO's panoptic format."""

    id: int
    category_id: int
    area: int
    bbox: tuple[int, int, int, int]
    iscrowd: int


class NumberedPart(Struct, frozen=True):
    """A line of parts.json: a part of one of the plan's vehicles, and its number in passes."""

    id: int
    vehicle: str
    part: str


class PanopticImage(Struct, frozen=True):
    """An image of panoptic.json."""

    id: int
    file_name: str
    width: int
    height: int


class PanopticLabel(Struct, frozen=True):
    """The segments of an image, and their picture."""

    image_id: int
    file_name: str
    segments_info: list[Segment]


class PanopticClass(Struct, frozen=True):
    """A class of segments; the segments of "things" are instances."""

    id: int
    name: str
    isthing: int


class Panoptic(Struct, frozen=True):
    """The file panoptic.json, in COCO's panoptic format."""

    images: list[PanopticImage]
    annotations: list[PanopticLabel]
    categories: list[PanopticClass]


class WrittenPasses(Struct, frozen=True):
    """A file that lists the passes that were written for the row with this hash."""

    row_sha256: str
    passes: list[str]
    instances: list[Instance]
    segments_info: list[Segment]


@dataclass(frozen=True, eq=False, slots=True)
class SurfacePixels:
    """The surfaces at the pixel centers of an image."""

    # axis, ray: meters along the optical axis, and along the ray from the pinhole; inf for the sky
    axis: Float32[np.ndarray, "h w"]
    ray: Float32[np.ndarray, "h w"]
    normal: Float32[np.ndarray, "h w 3"]  # the face's normal in the world, toward the camera; nan for the sky
    # 0 for the sky; 1, 2, ... for the row's vehicles in their order; then ground and obstacles.
    instance: UInt16[np.ndarray, "h w"]
    part: UInt16[np.ndarray, "h w"]  # number in `numbered_parts`; 0 for other surfaces than vehicles
    table: list[Instance]


def numbered_parts(artist: Artist) -> list[NumberedPart]:
    """Return the parts of all vehicles of a plan, numbered from 1."""
    parts = [(name, part) for name, shape in artist.shapes.items() for part in shape.part_names]
    return [NumberedPart(i, name, part) for i, (name, part) in enumerate(parts, start=1)]


def trace_pixels(row: Row, artist: Artist, sceneries: Mapping[str, Scenery]) -> SurfacePixels:
    """Cast a ray through the center of each pixel of an image; `sceneries` are the plan's by name."""
    camera, shape = row.camera, (row.height, row.width)
    hits = artist.scene(row).first_hits(PixelRays(camera), threads=os.cpu_count() or 1)
    through = camera.lenses.pixel_directions(camera.lenses.pixel_centers)
    along_axis = hits.distance / np.sqrt(np.einsum("ij,ij->i", through, through))
    instance, table = _instance_numbers_and_table(row, hits, sceneries[row.scenery])
    return SurfacePixels(
        along_axis.astype(np.float32).reshape(shape),
        hits.distance.astype(np.float32).reshape(shape),
        hits.normal.astype(np.float32).reshape(*shape, 3),
        instance.reshape(shape),
        _part_numbers(row, artist, hits).reshape(shape),
        table,
    )


def _instance_numbers_and_table(row: Row, hits: Hits, scenery: Scenery) -> tuple[UInt16[np.ndarray, " n"], list[Instance]]:
    table = [Instance(i, "vehicle", v.vehicle, v.category, v.label) for i, v in enumerate(row.vehicles, start=1)]
    instance = np.where(hits.kind == SurfaceKind.VEHICLE, hits.instance + 1, 0)
    if (ground := hits.kind == SurfaceKind.GROUND).any():
        table.append(Instance(len(table) + 1, "ground", "ground"))
        instance[ground] = len(table)
    obstacles = hits.kind == SurfaceKind.OBSTACLE
    shown, number = np.unique(hits.instance[obstacles], return_inverse=True)
    instance[obstacles] = number + len(table) + 1
    for i in shown.tolist():
        what = "water" if scenery.instance_is_water[i] else "obstacle"
        table.append(Instance(len(table) + 1, what, scenery.instance_names[i]))
    if len(table) > MAX_INSTANCES:
        raise ConfigError(f"image {row.index} shows {len(table):,} instances, more than 16-bit pictures can tell apart")
    return instance.astype(np.uint16), table


def _part_numbers(row: Row, artist: Artist, hits: Hits) -> UInt16[np.ndarray, " n"]:
    ids = {part.vehicle: part.id for part in numbered_parts(artist)[::-1]}
    first = np.array([ids[vehicle.vehicle] for vehicle in row.vehicles] or [0])
    return np.where(hits.part >= 0, first.take(hits.instance, mode="clip") + hits.part, 0).astype(np.uint16)


def panoptic_picture_and_segments(
    pixels: SurfacePixels, class_ids: Mapping[str, int]
) -> tuple[UInt8[np.ndarray, "h w 3"], list[Segment]]:
    """Return an image's segments, as a picture of their numbers and a list; `STUFF_CLASSES` follows the classes."""
    segment, category, crowd = np.zeros((3, len(pixels.table) + 1), np.int64)
    for one in [Instance(0, "sky", "sky"), *pixels.table]:
        i = one.id
        if isinstance(one.category, str):
            segment[i], category[i], crowd[i] = i, class_ids[one.category], one.label != "full"
        else:
            stuff = STUFF_CLASSES.index("distractor" if one.kind == "vehicle" else one.kind)
            segment[i], category[i] = FIRST_STUFF_SEGMENT + stuff, len(class_ids) + 1 + stuff
    numbers = segment[pixels.instance]
    colors = np.stack([numbers & 255, numbers >> 8 & 255, numbers >> 16], axis=-1).astype(np.uint8)
    segments = []
    for number in np.unique(numbers).tolist():
        (rows, columns), i = np.nonzero(numbers == number), int(np.flatnonzero(segment == number)[0])
        top, left = int(rows.min()), int(columns.min())
        bbox = (left, top, int(columns.max()) + 1 - left, int(rows.max()) + 1 - top)
        segments.append(Segment(number, int(category[i]), len(rows), bbox, int(crowd[i])))
    return colors, segments


def write_passes(
    plan: AnyPath,
    output: AnyPath,
    *,
    depth: bool = False,
    normal: bool = False,
    instance: bool = False,
    part: bool = False,
    category: bool = False,
    count: Count | None = None,
    cache: AnyPath | None = None,
    limits: ReadLimits = DEFAULT_LIMITS,
    assets: Assets | None = None,
) -> dict[str, int]:
    """Write depth, normals, instances, and more of a plan's images.

    Reads a plan and the assets it names; writes arrays and pictures of each image, and COCO panoptic; without Blender.
    Without a choice, all passes are written. The same call continues one that was stopped.

    Parameters
    ----------
    plan
        The plan.
    output
        The folder to write into.
    depth
        Float32 meters along the optical axis and along the ray.
    normal
        Float32 normals in the world.
    instance
        16-bit numbers of vehicles, ground, and obstacles.
    part
        16-bit numbers of vehicles' parts.
    category
        COCO panoptic: classes and instances.
    count
        Most images, evenly spread over the plan; by default all.
    cache
        Cache of assets; by default .hulldown-cache next to the plan.
    limits
        Time and memory for reading an asset.

    Returns
    -------
    The number of images of each written pass.
    """
    plan, output = PlanFile.read(plan), Path(output)
    assets = assets or load_planned_library(plan, cache=cache, limits=limits).assets
    asked = dict(zip(PASS_MEANINGS, (depth, normal, instance, part, category), strict=True))
    passes = [name for name in PASS_MEANINGS if asked[name]] or list(PASS_MEANINGS)
    artist = Artist(plan, assets)
    chosen = even_sample(len(plan), len(plan) if count is None else count).tolist()
    names = [*plan.header.categories, *STUFF_CLASSES]
    things = len(plan.header.categories)
    categories = [PanopticClass(i, name, int(i <= things)) for i, name in enumerate(names, start=1)]
    document = Panoptic([], [], categories)
    with OutputFolder(output, "passes"):
        for index in track_items("casting rays", chosen, len(chosen)):
            row = plan[index]
            segments = _write_image_passes(row, artist, assets, output, passes)
            document.images.append(PanopticImage(row.image_id, row.file_name, row.width, row.height))
            document.annotations.append(PanopticLabel(row.image_id, f"{_image_stem(row)}.png", segments))
        if "part" in passes:
            replace_file(output / "parts.json", msgspec.json.format(msgspec.json.encode(numbered_parts(artist))))
        if "category" in passes:
            replace_file(output / "panoptic.json", msgspec.json.encode(document))
    return dict.fromkeys(passes, len(chosen))


def _write_image_passes(row: Row, artist: Artist, assets: Assets, output: Path, passes: Sequence[str]) -> list[Segment]:
    """Write an image's passes, then a table of the complete ones; return its segments."""
    stem, digest = _image_stem(row), hashlib.sha256(encode_line(row)).hexdigest()
    path, complete = output / "tables" / f"{stem}.json", set[str]()
    places = {name: output / folder / f"{stem}{suffix}" for name, (folder, suffix) in PASS_MEANINGS.items()}
    with suppress(HulldownError):  # written anew
        table = read_json(path, WrittenPasses, partial(HulldownError, path=path), what="a table of ours")
        if table.row_sha256 == digest:
            complete = {name for name in table.passes if name in places and places[name].is_file()}
    if complete >= set(passes):
        return table.segments_info
    pixels = trace_pixels(row, artist, assets.sceneries)
    colors, segments = panoptic_picture_and_segments(pixels, artist.class_ids)
    contents = {
        "depth": lambda: _encode_npz(axis=pixels.axis, ray=pixels.ray),
        "normal": lambda: _encode_npz(world=pixels.normal),
        "instance": lambda: _encode_png(pixels.instance),
        "part": lambda: _encode_png(pixels.part),
        "category": lambda: _encode_png(colors),
    }
    for name in passes:
        _write_file(places[name], contents[name]())
    _write_file(path, msgspec.json.encode(WrittenPasses(digest, sorted({*passes, *complete}), pixels.table, segments)))
    return segments


def _image_stem(row: Row) -> str:
    return str(Path(row.file_name).relative_to("images").with_suffix(""))


def _encode_npz(**arrays: np.ndarray) -> bytes:
    buffer = io.BytesIO()
    np.savez(buffer, **arrays)
    return buffer.getvalue()


def _encode_png(pixels: np.ndarray) -> bytes:
    buffer = io.BytesIO()
    Image.fromarray(pixels).save(buffer, "PNG", compress_level=1)
    return buffer.getvalue()


def _write_file(path: Path, content: bytes) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    replace_file(path, content)
