"""A dataset's files about runs: sources and software of each plan's images, and its failed images with reasons."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path

import orjson
from msgspec import Struct, to_builtins
from msgspec.structs import replace

from hulldown.base.errors import DatasetError
from hulldown.base.outside import convert_parsed_value, read_json
from hulldown.dataset.store.journal import open_replacement_file, read_journal

FAILURES_NAME = "failures.jsonl"
PROVENANCE_NAME = "provenance.json"
GROWING_LISTS = ("blender", "devices", "systems", "confinement")  # several runs and machines add to these


class Provenance(Struct, frozen=True, kw_only=True, omit_defaults=True):
    """The origin of a plan's images: the plan, and what rendered them."""

    file: str = ""  # name of the plan's file
    first_image_id: int = 0  # first_image_id, images: id of its first image in the dataset, and number of all
    images: int = 0
    blender: list[str]
    devices: list[str]  # devices, systems, blender, confinement: what rendered them, on all machines
    systems: list[str]
    confinement: list[str]
    plan: object = None


class Failure(Struct, frozen=True, kw_only=True, omit_defaults=True):
    """A failed image: its number in the plan, its name, and the reason of each attempt."""

    index: int | None = None
    file_name: str
    reasons: list[str] = []


class _File(Struct):
    plans: dict[str, Provenance]


def read_provenance_by_plan(folder: Path) -> dict[str, Provenance]:
    """Return the provenance of each plan's images by its key; empty without a file."""
    path = folder / PROVENANCE_NAME
    refuse = partial(DatasetError, path=path, remedy="move it away")
    return read_json(path, _File, refuse, what="a hulldown provenance file").plans if path.exists() else {}


def add_provenance(folder: Path, plans: Mapping[str, Provenance]) -> None:
    """Add or update plans in the file, in one step."""
    if not plans:
        return
    known = read_provenance_by_plan(folder)
    for key, new in plans.items():
        before = known.get(key, new)
        grown = {name: sorted({*getattr(before, name), *getattr(new, name)}) for name in GROWING_LISTS}
        known[key] = replace(new, **grown)
    with open_replacement_file(folder / PROVENANCE_NAME) as file:
        file.write(orjson.dumps({"plans": to_builtins(known)}, option=orjson.OPT_INDENT_2))


def read_failures(folder: Path) -> list[Failure]:
    """Return one failure per image; empty without a file."""
    refuse = partial(DatasetError, path=folder / FAILURES_NAME, remedy="delete it; the images are tried again")
    try:
        return convert_parsed_value(list(read_journal(folder / FAILURES_NAME)), list[Failure])
    except ValueError as error:
        raise refuse(f"isn't a list of failed images ({error})") from None


def write_failures(folder: Path, failures: Sequence[Failure]) -> None:
    """Replace the file in one step; delete it if there are no failures."""
    path = folder / FAILURES_NAME
    if not failures:
        path.unlink(missing_ok=True)
        return
    with open_replacement_file(path) as file:
        file.writelines(orjson.dumps(to_builtins(line), option=orjson.OPT_APPEND_NEWLINE) for line in failures)
