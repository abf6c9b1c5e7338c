"""Verify a dataset: records, files, boxes, and masks."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

from hulldown.base.arguments import AnyPath
from hulldown.base.errors import DatasetError
from hulldown.base.outside import DATA, json_with_repeats, read_file
from hulldown.base.terminal import progress_bar
from hulldown.dataset.records import (
    Finding,
    check_cameras,
    check_journal,
    check_labels,
    check_names,
    check_reservations,
    sound_images,
    unusable_records,
)
from hulldown.dataset.store.document import ANNOTATIONS_NAME, COCO_NAME, JOURNAL_NAME, read_coco
from hulldown.dataset.store.journal import lacks_newline
from hulldown.dataset.verification.check_pictures import check_pictures
from hulldown.dataset.verification.check_plan import check_planned
from hulldown.plan.library import Library
from hulldown.plan.plan_file import read_plan


def find_problems(
    dataset: AnyPath,
    plan: AnyPath | None,
    *,
    fast: bool,
    assets: Callable[[], Library],
    progress: Callable[[int, int], None] | None = None,
) -> list[Finding]:
    """Find what is wrong with a dataset; parameters as of `render.verify.verify_dataset`."""
    folder = Path(dataset)
    coco = read_coco(folder)
    sound = sound_images(coco)
    findings = [*unusable_records(coco["categories"], coco["images"], coco["annotations"]), *check_names(coco)]
    findings += check_cameras(coco["images"])
    findings += check_labels(coco["categories"], sound.values())
    findings += check_reservations(coco)
    findings += check_journal(coco, folder / JOURNAL_NAME)
    if plan is not None:
        findings += check_planned(coco, read_plan(plan), None if fast else assets)
    findings += _check_keys(folder)
    if lacks_newline(folder / JOURNAL_NAME):
        problem = "its last line is cut off: its image is not in the dataset; render again"
        findings.append(Finding("warning", JOURNAL_NAME, problem))
    with progress_bar("checking", progress) as advance:
        findings += check_pictures(folder, coco, sound, fast=fast, progress=advance)
    return findings


def _check_keys(folder: Path) -> Iterator[Finding]:
    path = next((path for name in (ANNOTATIONS_NAME, COCO_NAME) if (path := folder / name).exists()), None)
    if path is None:
        if (folder / JOURNAL_NAME).exists():
            problem = "is not there yet: the run has not been closed; render again to finish it"
            yield Finding("warning", ANNOTATIONS_NAME, problem)
        return
    refuse = partial(DatasetError, path=path)
    try:
        _, repeated = json_with_repeats(read_file(path, refuse, most=DATA))
    except ValueError as error:  # it changed meanwhile
        raise refuse(f"isn't valid JSON ({error})") from None
    for key, times in repeated.items():
        yield Finding("error", path.name, f"{times} objects have the key {key!r} more than once: readers take the last")
