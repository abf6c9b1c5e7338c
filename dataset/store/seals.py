"""Hashes of pictures, records, and journal lines, to detect later changes.

A rendered image's record has the SHA-256 of its picture (`PICTURE_KEY`), and each of its
records that of its other fields (`RECORD_KEY`). Records from elsewhere have neither.
"""

from __future__ import annotations

import hashlib
from typing import Any

import orjson

from hulldown.assets.coco_types import Record

PICTURE_KEY = "picture_sha256"
RECORD_KEY = "record_sha256"
LINE_KEY = "line_sha256"

_LINE_START = b',"' + LINE_KEY.encode() + b'":"'
_LINE_END = b'"}\n'
_SEAL_LENGTH = len(_LINE_START) + 64 + len(_LINE_END)


def digest(content: bytes) -> str:
    """Hexadecimal SHA-256 of a file's content."""
    return hashlib.sha256(content).hexdigest()


def seal_of(record: Record) -> str:
    """Return the correct seal of a record: the hash of its other fields, in the order of their names."""
    rest = {key: value for key, value in record.items() if key != RECORD_KEY}
    return digest(orjson.dumps(rest, option=orjson.OPT_SORT_KEYS))


def sealed(record: Record) -> Record:
    """Add the seal as a record's last field."""
    rest = {key: value for key, value in record.items() if key != RECORD_KEY}
    return {**rest, RECORD_KEY: seal_of(rest)}


def broken(record: Record) -> bool:
    """Return whether a record's seal is wrong; null is the seal of records edited on purpose."""
    seal = record.get(RECORD_KEY)
    return seal is not None and seal != seal_of(record)


def changed(record: Record, **fields: Any) -> Record:
    """Change fields of a record; a valid seal stays valid."""
    new = {**record, **fields}
    return sealed(new) if record.get(RECORD_KEY) is not None and not broken(record) else new


def seal_line(line: bytes) -> bytes:
    """Add to a journal line, a JSON object with its newline, the hash of everything before it."""
    content = line[:-2]
    return content + _LINE_START + digest(content).encode() + _LINE_END


def line_is_broken(line: bytes) -> bool:
    """Return whether a sealed journal line was changed, or its seal isn't at its end."""
    content, end = line[:-_SEAL_LENGTH], line[-_SEAL_LENGTH:]
    return end != _LINE_START + digest(content).encode() + _LINE_END
