"""The layout of ``annotations.json``, one record per line, so that large ones are read without parsing the whole."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import Any, BinaryIO

import orjson

LONGEST_HEAD = 1 << 24  # bytes of info, licenses, and categories


class OtherLayoutError(Exception):
    """The file has another layout than `write_coco`'s; it may be valid."""


def write_coco(file: BinaryIO, head: Mapping[str, Any], images: Iterable[bytes], annotations: Iterable[bytes]) -> None:
    """Write a COCO document.

    Parameters
    ----------
    file
        Open for writing.
    head
        The document without images and annotations; not empty.
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
    """Head, images, and annotations of a file by `write_coco`; the images must be read first, and completely.

    It accepts only files that a parser of the whole would read in the same way: the head is an object that
    isn't empty and has neither list, between the records is only JSON's punctuation, each record
    is one object, and nothing follows the end.

    Parameters
    ----------
    file
        Open for reading, at its beginning.

    Raises
    ------
    OtherLayoutError
        Here, or when records are read.
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
        record = orjson.loads(line)
    except orjson.JSONDecodeError:
        raise OtherLayoutError from None
    if not isinstance(record, dict):
        raise OtherLayoutError
    return record
