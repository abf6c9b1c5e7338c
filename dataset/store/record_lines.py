"""How ``annotations.json`` is laid out, one record a line, so that a large one is read without parsing it whole."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import Any, BinaryIO

import orjson

LONGEST_HEAD = 1 << 24  # bytes: info, licences and categories of a dataset that was made here fit in


class OtherLayoutError(Exception):
    """The file is not laid out as `write_coco` lays it out; it may be sound all the same."""


def write_coco(file: BinaryIO, head: Mapping[str, Any], images: Iterable[bytes], annotations: Iterable[bytes]) -> None:
    """Write a COCO document.

    Parameters
    ----------
    file
        Open for writing.
    head
        All but images and annotations; not empty.
    images, annotations
        Records as JSON.
    """
    file.write(orjson.dumps(head)[:-1])
    for key, records in ((b"images", images), (b"annotations", annotations)):
        file.write(b',\n"%b":[' % key)
        start = b"\n"
        for record in records:
            file.write(start)
            file.write(record)
            start = b",\n"
        file.write(b"]")
    file.write(b"}\n")


def read_by_line(file: BinaryIO) -> tuple[dict[str, Any], Iterator[dict[str, Any]], Iterator[dict[str, Any]]]:
    """Head, images and annotations of what `write_coco` has written; images are to be taken first, and wholly.

    What is accepted here is what a parser of the whole would have read, and nothing else: the head is an object that
    is not empty and has neither list, between the records is the punctuation of JSON and nothing besides, each record
    is one object by itself, and after the end comes nothing.

    Parameters
    ----------
    file
        Open for reading, at its beginning.

    Raises
    ------
    OtherLayoutError
        Here, or when records are taken.
    """
    line = file.readline(LONGEST_HEAD)
    if not line.endswith(b",\n"):
        raise OtherLayoutError
    head = _object(line[:-2] + b"}")
    if not head or "images" in head or "annotations" in head:
        raise OtherLayoutError
    return head, _records(file, b"images", b"],\n"), _records(file, b"annotations", b"]}\n", last=True)


def _records(file: BinaryIO, key: bytes, end: bytes, *, last: bool = False) -> Iterator[dict[str, Any]]:
    start = file.readline(LONGEST_HEAD)
    if start != b'"%b":[%b' % (key, end):
        if start != b'"%b":[\n' % key:
            raise OtherLayoutError
        for line in file:
            if line.endswith(b"},\n"):
                yield _object(line[:-2])
            elif line.endswith(end):
                yield _object(line[: -len(end)])
                break
            else:
                raise OtherLayoutError
        else:
            raise OtherLayoutError
    if last and file.read(1):
        raise OtherLayoutError


def _object(line: bytes) -> dict[str, Any]:
    try:
        found = orjson.loads(line)
    except orjson.JSONDecodeError:
        raise OtherLayoutError from None
    if not isinstance(found, dict):
        raise OtherLayoutError
    return found
