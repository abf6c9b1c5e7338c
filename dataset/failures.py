"""failures.jsonl: failed images of plans, with reasons."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import orjson

from hulldown.dataset.store.journal import read_journal, replaced

FAILURES_NAME = "failures.jsonl"


def read_failures(folder: Path) -> list[dict[str, Any]]:
    """One record per image, with its `file_name`; empty without a file."""
    return [line for line in read_journal(folder / FAILURES_NAME) if isinstance(line.get("file_name"), str)]


def write_failures(folder: Path, failures: Sequence[Mapping[str, Any]]) -> None:
    """Replace the file in one step; without failures there is no file."""
    path = folder / FAILURES_NAME
    if not failures:
        path.unlink(missing_ok=True)
        return
    with replaced(path) as file:
        file.writelines(orjson.dumps(line, option=orjson.OPT_APPEND_NEWLINE) for line in failures)
