"""Names of pictures in a dataset, in any spelling."""

from __future__ import annotations

import posixpath

from hulldown.geometry.files import stays_inside

# The dataset's own files: pictures with these names would be removed or overwritten.
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
    """The normal form of a name: ``images/./1.png`` and ``images//1.png`` are the same file.

    Examples
    --------
    >>> place_of("images/./1.png"), place_of("images//1.png")
    ('images/1.png', 'images/1.png')
    """
    return posixpath.normpath(file_name)


def is_free(file_name: object) -> bool:
    """Whether a picture may have this name: inside the dataset, and not one of the dataset's own files."""
    if not stays_inside(file_name):
        return False
    first = place_of(file_name).casefold().split("/")[0]
    return first != "." and first not in RESERVED
