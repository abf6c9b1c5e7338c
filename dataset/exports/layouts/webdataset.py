"""WebDataset: tar files of pictures, each followed by its records as JSON, for streaming.

References
----------
WebDataset documentation, "The WebDataset format": files of a sample follow each other and share their stem.
"""

from __future__ import annotations

import io
import tarfile
from collections.abc import Iterator
from pathlib import Path, PurePosixPath

import orjson

from hulldown.dataset.exports.shares import Item, Shares

SHARD_BYTES = 512 * 2**20  # bytes; suits object storage and readers
SHARD_IMAGES = 10_000


def write(shares: Shares, out: Path) -> None:
    """Write ``train-000000.tar`` and so on, and ``categories.json``.

    A sample is ``STEM.png`` and ``STEM.json``, which has ``image`` and ``annotations``, COCO's records with the class's
    name as ``category``. The files are the same whenever they are written.
    """
    names = shares.class_names
    for split, items in shares:
        for number, samples in enumerate(_shards(items)):
            with tarfile.open(out / f"{split}-{number:06d}.tar", "w", format=tarfile.USTAR_FORMAT) as shard:
                for item in samples:
                    labels = [{**label, "category": names[label["category_id"]]} for label in item.labels]
                    suffix = PurePosixPath(item.name).suffix.lower()
                    _add(shard, f"{item.stem}{suffix}", item.picture.read_bytes())
                    _add(shard, f"{item.stem}.json", orjson.dumps({"image": item.image, "annotations": labels}))
    (out / "categories.json").write_bytes(orjson.dumps(shares.categories))


def _shards(items: Iterator[Item]) -> Iterator[Iterator[Item]]:
    """Split items into runs of at most `SHARD_IMAGES` pictures and `SHARD_BYTES` bytes, at least one each."""
    ahead = next(items, None)

    def run() -> Iterator[Item]:
        nonlocal ahead
        images = room = 0
        while ahead is not None:
            size = ahead.picture.stat().st_size
            if images and (images == SHARD_IMAGES or size > room):
                return
            room = (room if images else SHARD_BYTES) - size
            images += 1
            yield ahead
            ahead = next(items, None)

    while ahead is not None:
        yield run()


def _add(shard: tarfile.TarFile, name: str, content: bytes) -> None:
    member = tarfile.TarInfo(name)
    member.size = len(content)
    shard.addfile(member, io.BytesIO(content))
