"""Verify a dataset: records, files, boxes, and Cycles' own masks."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache as kept
from pathlib import Path

from hulldown.base.arguments import AnyPath, Count
from hulldown.base.errors import HulldownError
from hulldown.dataset.records import Finding, finding_lines
from hulldown.dataset.verification.verify import find_problems
from hulldown.plan.library import Library, load_planned_library
from hulldown.plan.plan_file import read_plan
from hulldown.reading.confinement.watch import DEFAULT_LIMITS, ReadLimits
from hulldown.render.cycles_masks import MaskReport, verify_masks


class Findings(list[Finding]):
    """What is wrong with a dataset, and the comparison with masks if there is one."""

    masks: MaskReport | None = None

    def lines(self) -> list[str]:
        """Return the findings as lines, at most `LISTED` of each kind."""
        return finding_lines(self)


def verify_dataset(
    dataset: AnyPath,
    plan: AnyPath | None = None,
    *,
    fast: bool = False,
    masks: Count | None = None,
    cache: AnyPath | None = None,
    limits: ReadLimits = DEFAULT_LIMITS,
    assets: Callable[[], Library] | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Findings:
    """Find everything that is wrong with a dataset.

    Reads a dataset; lists problems of records, images, and boxes. The exit code is 1 if there are errors.

    Parameters
    ----------
    dataset
        Its folder, in Python also a `Dataset`.
    plan
        A plan that it was rendered from: records are compared row by row, and labels with those of the rows' scenes.
    fast
        Don't open pictures, compare hashes, or check labels that need the scene.
    masks
        Render the masks of this many images, and compare; needs the plan.
    cache
        Cache of the plan's assets; by default .hulldown-cache next to the plan.
    limits
        Time and memory for reading an asset.
    assets
        Reads the plan's assets, in place of reading them with that cache.
    progress
        Called with (done, all) after each image; None: a bar in a terminal or notebook.

    Raises
    ------
    DatasetError
        If there is no dataset, or it can't be read at all.
    ConfigError
        If the file isn't a plan.

    Examples
    --------
    >>> from tempfile import mkdtemp
    >>> from hulldown.dataset.coco import CocoDataset
    >>> folder = mkdtemp()
    >>> with CocoDataset.open(folder, categories=["truck"]) as dataset:
    ...     _ = dataset.append({"file_name": "1.jpg", "width": 640, "height": 480}, [])
    >>> print(*verify_dataset(folder))
    error: 1.jpg: is missing
    """
    if masks is not None and plan is None:
        raise HulldownError("--masks needs --plan, whose poses are rendered again")
    library = kept(assets or (lambda: load_planned_library(read_plan(plan or ""), cache=cache, limits=limits)))
    findings = Findings(find_problems(dataset, plan, fast=fast, assets=library, progress=progress))
    if masks is not None and plan is not None:
        findings.masks = verify_masks(Path(dataset), plan, library(), count=masks)
        findings += findings.masks.findings
    return findings
