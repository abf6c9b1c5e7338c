"""A plan's remaining images for a dataset: order, names, and ids."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from jaxtyping import Int

from hulldown.dataset.coco import CocoDataset
from hulldown.dataset.store.runs import Run, plan_key
from hulldown.planning.plan_file import Plan
from hulldown.planning.row import Row


class Outline:
    """A plan's names, order, and numbers of labels, read completely before anything is written.

    Parameters
    ----------
    plan
        The plan.

    Raises
    ------
    ConfigError
        If a line is damaged.
    """

    def __init__(self, plan: Plan) -> None:
        self.stamp = stamp_of(plan.path)
        self.rows = [(sort_key(row), row.index, len(row.labeled), row.file_name) for row in plan]
        self.key = plan_key(plan.path)
        self.labels = np.array([row[2] for row in self.rows], dtype=np.int64)

    def first_annotations(self, run: Run) -> Int[np.ndarray, " images"]:
        """The id of each image's first label, which depends on the plan alone."""
        return np.cumsum(self.labels) - self.labels + run.annotation_offset + 1


class Remaining:
    """A plan's remaining rows, ordered so that workers can keep loaded assets.

    Parameters
    ----------
    outline
        The plan's outline.
    dataset
        The open dataset.
    wanted
        Number of rows, from the first.
    share
        The k-th of n equal parts of these, in rendering order: (k, n).

    Raises
    ------
    DatasetError
        If another record in the dataset has an id reserved for one of them.
    """

    def __init__(self, outline: Outline, dataset: CocoDataset, wanted: int, *, share: tuple[int, int] = (1, 1)) -> None:
        rows = outline.rows
        self.stamp = outline.stamp
        self.run: Run = dataset.run(outline.key, images=len(rows), annotations=int(outline.labels.sum()))
        self.first_annotation = outline.first_annotations(self.run)
        k, n = share
        wanted = min(wanted, len(rows))
        share_rows = sorted(rows[:wanted])[(k - 1) * wanted // n : k * wanted // n]  # neighbors stay together
        left = [(row, name) for row in share_rows if not dataset.finished(name := self.run.file_name(row[3]))]
        for (_, index, labels, _), name in left:
            first = int(self.first_annotation[index])
            dataset.check_free(name, self.run.image_offset + index + 1, range(first, first + labels))
        self.order, self.names = [row[1] for row, _ in left], {name for _, name in left}
        self.wanted, self.already = len(share_rows), len(share_rows) - len(self.order)


def sort_key(row: Row) -> tuple[str, str, str, str]:
    """Sort key of rows by loading time: scenery, vehicle, kind of weather, HDRI."""
    return row.scenery, row.target.vehicle, row.weather.kind if row.weather else "", row.hdri


def stamp_of(path: Path) -> tuple[int, int, int] | None:
    """Identity, size, and modification time of a file; None if there is none."""
    try:
        stat = path.stat()
    except OSError:
        return None
    return stat.st_ino, stat.st_size, stat.st_mtime_ns
