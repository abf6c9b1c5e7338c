"""Verify a dataset: records, files, boxes, and Cycles' own masks."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import cache as kept
from functools import partial
from pathlib import Path

from hulldown.base.arguments import AnyPath, Count
from hulldown.base.errors import DatasetError, HulldownError
from hulldown.base.outside import MAX_DATA_BYTES, json_and_repeated_keys, read_file
from hulldown.base.terminal import progress_bar
from hulldown.dataset.record_checks import (
    Finding,
    find_camera_problems,
    find_label_problems,
    find_name_problems,
    find_record_problems,
    find_records_unlike_journal,
    find_reservation_problems,
    finding_lines,
    read_folder,
    sound_images_by_id,
)
from hulldown.dataset.store.document import ANNOTATIONS_NAME, COCO_NAME, JOURNAL_NAME
from hulldown.dataset.store.journal import lacks_newline
from hulldown.dataset.usable_labels import misread_boxes
from hulldown.dataset.verification.check_pictures import find_picture_problems
from hulldown.dataset.verification.check_plan import find_plan_differences
from hulldown.plan.library import Library, load_planned_library
from hulldown.plan.plan_file import read_plan
from hulldown.reading.confinement.watch import DEFAULT_LIMITS, ReadLimits
from hulldown.render.cycles_masks import MaskReport, verify_masks


class Findings(list[Finding]):
    """The problems of a dataset, and its comparison with rendered masks, if there is one."""

    masks: MaskReport | None = None

    def lines(self) -> list[str]:
        """Return the findings as lines, at most `MAX_LISTED_FINDINGS` of each kind."""
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
    folder = Path(dataset)
    coco = read_folder(folder)
    sound = sound_images_by_id(coco)
    findings = Findings(find_record_problems(coco["categories"], coco["images"], coco["annotations"]))
    findings += find_name_problems(coco)
    findings += find_camera_problems(coco["images"])
    findings += find_label_problems(coco["categories"], sound.values())
    findings += [Finding("error", "boxes", "; ".join(of)) for of in misread_boxes(sound.values())]
    findings += find_reservation_problems(coco)
    findings += find_records_unlike_journal(coco, folder / JOURNAL_NAME)
    if plan is not None:
        findings += find_plan_differences(coco, read_plan(plan), None if fast else library)
    findings += _find_repeated_keys(folder)
    if lacks_newline(folder / JOURNAL_NAME):
        problem = "its last line is cut off: its image is not in the dataset; render again"
        findings.append(Finding("warning", JOURNAL_NAME, problem))
    with progress_bar("checking", progress) as advance:
        findings += find_picture_problems(folder, coco, sound, fast=fast, progress=advance)
    if masks is not None and plan is not None:
        findings.masks = verify_masks(folder, plan, library(), count=masks)
        findings += findings.masks.findings
    return findings


def _find_repeated_keys(folder: Path) -> Iterator[Finding]:
    path = next((path for name in (ANNOTATIONS_NAME, COCO_NAME) if (path := folder / name).exists()), None)
    if path is None:
        if (folder / JOURNAL_NAME).exists():
            problem = "is not there yet: the run has not been closed; render again to finish it"
            yield Finding("warning", ANNOTATIONS_NAME, problem)
        return
    refuse = partial(DatasetError, path=path)
    try:
        _, repeated = json_and_repeated_keys(read_file(path, refuse, most=MAX_DATA_BYTES))
    except ValueError as error:  # it changed meanwhile
        raise refuse(f"isn't valid JSON ({error})") from None
    for key, times in repeated.items():
        yield Finding("error", path.name, f"{times} objects have the key {key!r} more than once: readers take the last")
