"""Names of pictures in a dataset: which file a name stands for, however it is spelled."""

from __future__ import annotations

import posixpath

from hulldown.geometry.files import stays_inside

# What the dataset keeps for itself: pictures under these names would be swept away or written over.
RESERVED = (
    ".unfinished",
    ".hulldown.lock",
    "annotations.json",
    "journal.jsonl",
    "failures.jsonl",
    "provenance.json",
    "logs",
)


def place_of(file_name: str) -> str:
    """The file that a name stands for: ``images/./1.png`` and ``images//1.png`` are one.

    Examples
    --------
    >>> place_of("images/./1.png"), place_of("images//1.png")
    ('images/1.png', 'images/1.png')
    """
    return posixpath.normpath(file_name)


def is_free(file_name: object) -> bool:
    """Whether a picture may have this name: it stays in the dataset, and is none that the dataset needs itself."""
    if not stays_inside(file_name):
        return False
    first = place_of(file_name).casefold().split("/")[0]
    return first != "." and first not in RESERVED
