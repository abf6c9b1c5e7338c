"""Cycles' own masks of planned vehicles, for checking annotations against what is rendered."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool

from geometry.errors import HulldownError
from planning.plan_file import Plan
from render.jobs import RenderAssets, mask_job
from render.pool import Pool


@dataclass(frozen=True, eq=False, slots=True)
class RowMasks:
    """What Cycles shows of the vehicles of one row, at pixel centres.

    Parameters
    ----------
    index
        The row.
    alone
        (k, h, w) each vehicle as if nothing else were there.
    visible
        (k, h, w) each vehicle behind whatever hides it.
    """

    index: int
    alone: Bool[np.ndarray, "k h w"]
    visible: Bool[np.ndarray, "k h w"]


def cycles_masks(
    plan: Plan, rows: Sequence[int], assets: RenderAssets, *, device: str = "auto", blender: str | None = None
) -> list[RowMasks]:
    """Render the masks of all vehicles in some rows of a plan, the target first, then its companions.

    Parameters
    ----------
    plan
        The plan.
    rows
        Indices of rows.
    assets
        The plan's files; see `render.jobs.render_assets`.
    device, blender
        As of `render.supervisor.render_plan`.

    Raises
    ------
    HulldownError
        If Blender fails.
    """
    found: dict[int, RowMasks] = {}
    with tempfile.TemporaryDirectory(prefix="hulldown-") as name:
        folder = Path(name)

        def message(index: int) -> dict[str, Any]:
            return mask_job(plan[index], assets, folder / f"{index}.npy")

        def done(index: int, _answer: Mapping[str, Any]) -> None:
            maps = np.load(folder / f"{index}.npy")
            numbers = np.arange(1, len(maps))[:, None, None]
            # Alone, a vehicle still has its own number.
            found[index] = RowMasks(index, alone=maps[1:] == numbers, visible=maps[:1] == numbers)

        def failed(index: int, reasons: list[str]) -> None:
            raise HulldownError(f"the mask of image {index} cannot be rendered: {reasons[-1]}", path=plan.path)

        with Pool(folder / "logs", blender=blender, device=device, workers=1) as pool:
            pool.run(sorted(rows, key=lambda i: plan[i]["scenery"]), message, done, failed)
    return [found[index] for index in rows]
