"""What a plan's part of a dataset was made from, and by what: said to the dataset's provenance.json."""

from __future__ import annotations

import platform
from collections.abc import Iterable
from pathlib import Path

from annotate.provenance import add_provenance
from annotate.runs import Run
from planning.plan_file import Plan


def record(folder: Path, plan: Plan, run: Run, *, blender: str, devices: Iterable[str]) -> None:
    """Add to, or bring up to date, the entry of a plan.

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
    entry = {
        "file": plan.path.name,
        "first_image_id": run.image_offset + 1,
        "images": len(plan),
        "blender": [blender],
        "devices": list(devices),
        "systems": [platform.platform(terse=True)],
        "plan": plan.header,
    }
    add_provenance(folder, {run.key: entry})
