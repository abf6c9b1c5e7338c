"""SHA-256 of pictures, records and journal lines, by which a later change is found.

What was rendered here says in its image record what its picture's bytes hash to (`PICTURE_KEY`), and each of its
records what the rest of the record hashes to (`RECORD_KEY`). Records that were made elsewhere have neither.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from typing import Any

import orjson

PICTURE_KEY = "picture_sha256"
RECORD_KEY = "record_sha256"
LINE_KEY = "line_sha256"

_LINE_START = b',"' + LINE_KEY.encode() + b'":"'
_LINE_END = b'"}\n'
_SEAL_LENGTH = len(_LINE_START) + 64 + len(_LINE_END)


def digest(content: bytes) -> str:
    """Hexadecimal SHA-256 of a file's content."""
    return hashlib.sha256(content).hexdigest()


def seal_of(record: Mapping[str, Any]) -> str:
    """What a record's seal must be: of its fields but the seal, in the order of their names."""
    rest = {key: value for key, value in record.items() if key != RECORD_KEY}
    return digest(orjson.dumps(rest, option=orjson.OPT_SORT_KEYS))


def sealed(record: Mapping[str, Any]) -> dict[str, Any]:
    """A record with its seal as the last field."""
    rest = {key: value for key, value in record.items() if key != RECORD_KEY}
    return {**rest, RECORD_KEY: seal_of(rest)}


def broken(record: Mapping[str, Any]) -> bool:
    """Whether a record has a seal that does not fit it; null is the seal of what a person has changed."""
    seal = record.get(RECORD_KEY)
    return seal is not None and seal != seal_of(record)


def changed(record: Mapping[str, Any], **fields: Any) -> dict[str, Any]:
    """A record with other values in some fields; its seal fits again if it did before."""
    new = {**record, **fields}
    return sealed(new) if record.get(RECORD_KEY) is not None and not broken(record) else new


def seal_line(line: bytes) -> bytes:
    """A journal line, a JSON object that is not empty with its newline, with the hash of all that is before it."""
    content = line[:-2]
    return content + _LINE_START + digest(content).encode() + _LINE_END


def line_is_broken(line: bytes) -> bool:
    """Whether a journal line that has a seal is not as it was written, or has it elsewhere than at its end."""
    content, end = line[:-_SEAL_LENGTH], line[-_SEAL_LENGTH:]
    return end != _LINE_START + digest(content).encode() + _LINE_END
