"""WebDataset: tar files of pictures, each followed by its records as JSON, for streaming.

References
----------
WebDataset documentation, "The WebDataset format": files of a sample follow each other and share their stem.
"""

from __future__ import annotations

import io
import tarfile
from contextlib import ExitStack
from functools import partial
from pathlib import Path, PurePosixPath

import orjson

from hulldown.base.errors import DatasetError
from hulldown.base.outside import DATA, read_file
from hulldown.dataset.exports.layouts.splits import Splits

SHARD_BYTES = 512 * 2**20  # bytes; suits object storage and readers
SHARD_IMAGES = 10_000


def write(splits: Splits, out: Path) -> None:
    """Write ``train-000000.tar`` and so on, and ``categories.json``.

    A sample is ``STEM.png`` and ``STEM.json``, which has ``image`` and ``annotations``, COCO's records with the class's
    name as ``category``. The files are the same whenever they are written.
    """
    for split, items in splits:
        number, images, room = 0, SHARD_IMAGES, 0  # the first picture begins a shard
        with ExitStack() as stack:
            for item in items:
                size = item.picture.stat().st_size
                if images == SHARD_IMAGES or size > room:
                    stack.close()
                    path = out / f"{split}-{number:06d}.tar"
                    shard = stack.enter_context(tarfile.open(path, "w", format=tarfile.USTAR_FORMAT))
                    number, images, room = number + 1, 0, SHARD_BYTES
                images, room = images + 1, room - size
                labels = [{**label.record, "category": label.category} for label in item.image.labels]
                suffix = PurePosixPath(item.name).suffix.lower()
                content = read_file(item.picture, partial(DatasetError, path=item.picture), most=DATA)
                _add(shard, f"{item.stem}{suffix}", content)
                _add(shard, f"{item.stem}.json", orjson.dumps({"image": item.image.record, "annotations": labels}))
    (out / "categories.json").write_bytes(orjson.dumps([category.record for category in splits.categories]))


def _add(shard: tarfile.TarFile, name: str, content: bytes) -> None:
    member = tarfile.TarInfo(name)
    member.size = len(content)
    shard.addfile(member, io.BytesIO(content))
