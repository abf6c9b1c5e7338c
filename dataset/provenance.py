"""A dataset's files about runs: sources and software of each plan's images, and its failed images with reasons."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import orjson
from msgspec import Struct

from hulldown.assets.coco_types import Record
from hulldown.base.errors import DatasetError
from hulldown.base.outside import read_json, typed
from hulldown.dataset.store.journal import read_journal, replaced

FAILURES_NAME = "failures.jsonl"
PROVENANCE_NAME = "provenance.json"
GROWING = ("blender", "devices", "systems", "confinement")  # lists that several runs and machines add to


class _Provenance(Struct):
    plans: dict[str, dict[str, Any]]


def read_provenance(folder: Path) -> dict[str, Record]:
    """Return the entry of each plan by its key; empty without a file.

    Raises
    ------
    DatasetError
        If the file is something else.
    """
    path = folder / PROVENANCE_NAME
    refuse = partial(DatasetError, path=path, remedy="move it away")
    plans = read_json(path, _Provenance, refuse, what="a hulldown provenance file").plans if path.exists() else {}
    try:
        typed([[entry.get(key) for key in GROWING] for entry in plans.values()], list[list[list[str]]])
    except ValueError as error:
        raise refuse(f"isn't a hulldown provenance file ({error})") from None
    return dict(plans)


def add_provenance(folder: Path, entries: Mapping[str, Record]) -> None:
    """Add entries, or update those of the same plans; replaces the file in one step.

    Parameters
    ----------
    folder
        The dataset.
    entries
        Entries by the plan's key; the lists in `GROWING` are extended.

    Raises
    ------
    DatasetError
        If the file can't be read or written.
    """
    if not entries:
        return
    known = read_provenance(folder)
    for key, entry in entries.items():
        before = known.get(key, {})
        known[key] = {**entry, **{name: sorted({*before.get(name, []), *entry[name]}) for name in GROWING}}
    with replaced(folder / PROVENANCE_NAME) as file:
        file.write(orjson.dumps({"plans": known}, option=orjson.OPT_INDENT_2))


def read_failures(folder: Path) -> list[Record]:
    """Return one record per image, with its `file_name`; empty without a file."""
    return [line for line in read_journal(folder / FAILURES_NAME) if isinstance(line.get("file_name"), str)]


def write_failures(folder: Path, failures: Sequence[Record]) -> None:
    """Replace the file in one step; without failures there is no file."""
    path = folder / FAILURES_NAME
    if not failures:
        path.unlink(missing_ok=True)
        return
    with replaced(path) as file:
        file.writelines(orjson.dumps(line, option=orjson.OPT_APPEND_NEWLINE) for line in failures)
