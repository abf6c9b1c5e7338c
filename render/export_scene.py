"""A planned image as a .blend file of its own."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

from hulldown.base.arguments import AnyPath, BlendFile, Count
from hulldown.base.errors import HulldownError
from hulldown.base.outputs import require_replaceable_file
from hulldown.plan.library import load_planned_library
from hulldown.plan.plan_file import read_plan
from hulldown.reading.confinement.watch import DEFAULT_LIMITS, ReadLimits
from hulldown.render.blender.messages import BlendJob
from hulldown.render.jobs import blender_readable_paths, make_planned_row_job
from hulldown.render.pool import Device, Engine
from hulldown.render.process import Blender, Confinement


def export_scene(
    plan: AnyPath,
    output: BlendFile,
    *,
    image: Count = 1,
    device: Device = "auto",
    blender: str | None = None,
    cache: AnyPath | None = None,
    limits: ReadLimits = DEFAULT_LIMITS,
) -> Path:
    """Write a planned image as a scene to open in Blender.

    Reads a plan and the assets it names; writes a .blend file with scenery, vehicles, materials, light, camera, and
    settings of one image, and all textures packed. F12 in Blender renders the picture that `render` makes.

    Parameters
    ----------
    plan
        The plan.
    output
        The .blend file, which must not exist.
    image
        The image's number in the plan, from 1, as in its file name.
    device
        What the file renders on; auto is a GPU if there is one.
    blender
        An installed Blender's program, instead of the bpy module.
    cache
        Cache of assets; by default .hulldown-cache next to the plan.
    limits
        Time and memory for reading an asset.

    Returns
    -------
    The path of the .blend file.

    Examples
    --------
    >>> export_scene("project/plan.jsonl", "image.blend", image=3)  # doctest: +SKIP
    """
    rows, output = read_plan(plan), Path(output)
    if image > len(rows):
        raise HulldownError(f"has no image {image}", path=rows.path, remedy=f"name one from 1 to {len(rows)}")
    engine = Engine(device=device, blender=blender)
    require_replaceable_file(output, "a scene")
    library = load_planned_library(rows, cache=cache, limits=limits)
    with tempfile.TemporaryDirectory(prefix=".hulldown-", dir=output.parent) as name:
        folder = Path(name).resolve()
        job = BlendJob(
            make_planned_row_job(rows, rows[image - 1], library, folder / "picture.png"), os.fspath(folder / output.name)
        )
        confinement = Confinement(folder, blender_readable_paths(library))
        with Blender(folder / "log", program=engine.blender, device=device, confinement=confinement) as worker:
            outcome = worker.do(job)
        if outcome.reasons:
            raise HulldownError(f"image {image} cannot be saved: {outcome.reasons[0]}", path=rows.path)
        os.replace(job.output, output)
    return output
