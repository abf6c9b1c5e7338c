"""provenance.json: what each plan's part of a dataset was made from, and by what."""

from __future__ import annotations

import os
import platform
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import orjson

from annotate.coco import Run
from geometry.errors import DatasetError
from planning.plan_file import Plan

PROVENANCE_NAME = "provenance.json"


def record(folder: Path, plan: Plan, run: Run, *, blender: str, devices: Iterable[str]) -> None:
    """Add to, or bring up to date, the entry of a plan; replaces the file in one step.

    Parameters
    ----------
    folder
        The dataset.
    plan
        The plan.
    run
        What the dataset has set aside for it.
    blender
        Version of the Blender that has rendered.
    devices
        What it has rendered on; added to those of earlier runs.

    Raises
    ------
    DatasetError
        If there is a file of that name that cannot be read.
    """
    path = folder / PROVENANCE_NAME
    try:
        known: dict[str, Any] = orjson.loads(path.read_bytes()) if path.exists() else {"plans": {}}
        before = known["plans"].get(run.key, {})
    except (orjson.JSONDecodeError, KeyError, TypeError, AttributeError):
        raise DatasetError("is no provenance of hulldown", path=path, remedy="move it away") from None
    known["plans"][run.key] = {
        "file": plan.path.name,
        "first_image_id": run.image_offset + 1,
        "images": len(plan),
        "blender": sorted({*before.get("blender", []), blender}),
        "devices": sorted({*before.get("devices", []), *devices}),
        "systems": sorted({*before.get("systems", []), platform.platform(terse=True)}),
        "plan": plan.header,
    }
    temporary = path.with_name(f".{path.name}.tmp")
    temporary.unlink(missing_ok=True)  # were it a link, writing would follow it
    temporary.write_bytes(orjson.dumps(known, option=orjson.OPT_INDENT_2))
    os.replace(temporary, path)
