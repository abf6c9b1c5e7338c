"""Nested subsets of a dataset, to make real data scarce (paper, section 2.2)."""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from itertools import accumulate
from pathlib import Path
from typing import Annotated

import orjson

from hulldown.annotate.records import Image
from hulldown.base.arguments import AnyPath, make_option_parser
from hulldown.base.errors import DatasetError
from hulldown.base.outputs import OutputFolder
from hulldown.base.terminal import progress_bar
from hulldown.dataset.exports.split import shuffle_key
from hulldown.dataset.images import group_images_by_position
from hulldown.dataset.record_checks import read_usable_dataset
from hulldown.dataset.store.document import ANNOTATIONS_NAME, write_coco_document
from hulldown.dataset.store.placed_pictures import link_or_copy_file, resolve_own_picture

DEFAULT_FRACTIONS = (1.0, 0.5, 0.25, 0.1, 0.05)
FRACTIONS_PARSER = make_option_parser(
    "shares such as 1,0.5,0.25", lambda text: tuple(map(float, text.split(","))), metavar="A,B,..."
)


def subset_name(fraction: float) -> str:
    """Return the name of a fraction's folder: its percentage."""
    return f"{100 * fraction:.10g}"


def nested_subset_ids(
    images: Sequence[Image], fractions: Sequence[float], *, seed: int = 0, stratified: bool = False
) -> list[list[int]]:
    """Return image ids of each share, prefixes of one order by seed and names, of whole positions, at least one."""
    groups = group_images_by_position(images)
    for members in groups.values():
        members.sort(key=lambda image: image.file_name)
    order = sorted(groups.values(), key=lambda members: shuffle_key(members[0].file_name, seed))
    if stratified:
        order = _reorder_groups_evenly(order)
    ids = [image.id for members in order for image in members]
    ends = list(accumulate(map(len, order)))
    # By decimal value: 0.05 of 420 is 21, although 0.05 isn't exact in binary.
    sizes = [round(Fraction(str(fraction)) * len(ids)) for fraction in fractions]
    return [ids[: max([end for end in ends if end <= size], default=ends[0])] for size in sizes]


def write_subsets(
    dataset: AnyPath,
    output: AnyPath,
    *,
    fractions: Annotated[Sequence[float], FRACTIONS_PARSER] = DEFAULT_FRACTIONS,
    seed: int = 0,
    stratified: bool = False,
) -> dict[str, int]:
    """Make nested subsets of a dataset.

    Reads a dataset; writes OUTPUT/100, OUTPUT/50, and so on, each within the larger ones, pictures as hard links if the
    disk allows. A subset has as many images as its share, or fewer if the last position doesn't fit completely; at
    least one position.

    Parameters
    ----------
    dataset
        The dataset's folder.
    output
        A new or an empty folder.
    fractions
        Shares of the images, above 0 and at most 1.
    seed
        Seed of the selection.
    stratified
        Keep the proportion of classes in each.

    Returns
    -------
    Images in each subset.
    """
    dataset, out = Path(dataset), Path(output)
    for fraction in fractions:
        if not 0.0 < fraction <= 1.0:
            raise DatasetError(f"fraction {fraction:g}: expected a share above 0 and at most 1")
    names = [subset_name(fraction) for fraction in fractions]
    if repeated := [name for name in names if names.count(name) > 1]:
        raise DatasetError(f"fraction {float(repeated[0]) / 100:g} is given twice", remedy="name each fraction once")
    found = read_usable_dataset(dataset)
    if not found.images:
        raise DatasetError("has no images", path=dataset, remedy="name a dataset that has some")
    subsets = nested_subset_ids(found.images, fractions, seed=seed, stratified=stratified)
    sizes = [len(ids) for ids in subsets]
    chosen = {name: set(ids) for name, ids in zip(names, subsets, strict=True)}
    done, total = 0, sum(sizes)
    head = {"info": {}, **found.head, "categories": [category.record for category in found.categories]}
    with (
        OutputFolder(out, "subsets", (), inputs=[dataset]) as target,
        progress_bar("linking images") as advance,
        target.stage_content() as unfinished,
    ):
        for name, ids in chosen.items():
            images = [image for image in found.images if image.id in ids]
            for image in images:
                source, linked = resolve_own_picture(dataset, image.file_name), unfinished / name / image.file_name
                linked.parent.mkdir(parents=True, exist_ok=True)
                link_or_copy_file(source, linked)
                done += 1
                advance(done, total)
            records = [orjson.dumps(image.record) for image in images]
            labels = [orjson.dumps(label.record) for image in images for label in image.labels]
            with (unfinished / name / ANNOTATIONS_NAME).open("wb") as file:
                write_coco_document(file, head, records, labels)
    return dict(zip(names, sizes, strict=True))


def _reorder_groups_evenly(order: Sequence[list[Image]]) -> list[list[Image]]:
    """Order groups so that classes are evenly spread: the i-th of n groups of a kind is at (i + 1/2) / n."""
    kinds: dict[tuple[int, ...], list[list[Image]]] = {}
    for members in order:
        labels = {label.category_id for image in members for label in image.labels}
        kinds.setdefault(tuple(sorted(labels)), []).append(members)
    placed = []
    for kind, groups in kinds.items():
        ends = list(accumulate(len(members) for members in groups))
        placed += [((end - len(m) / 2) / ends[-1], kind, m) for end, m in zip(ends, groups, strict=True)]
    return [members for _, _, members in sorted(placed, key=lambda entry: entry[:2])]
