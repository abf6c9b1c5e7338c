"""A plan's order and names, and parts of it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
from cyclopts import Parameter
from jaxtyping import Int

from hulldown.base.arguments import Count, make_option_parser
from hulldown.dataset.store.reservations import Reservation, plan_file_key
from hulldown.plan.plan_file import Plan
from hulldown.plan.row import Row

SortKey = tuple[str, str, str, int, str]
OutlineRow = tuple[SortKey, int, int, str]  # with index, number of labels, and file name


class Outline:
    """The names, order, and numbers of labels of a plan, which is read completely before anything is written."""

    def __init__(self, plan: Plan) -> None:
        self.stamp = file_stamp(plan.path)
        self.rows = [(row_sort_key(row), row.index, len(row.labeled), row.file_name) for row in plan]
        self.key = plan_file_key(plan.path)
        self.labels = np.array([labels for _, _, labels, _ in self.rows], dtype=np.int64)

    def first_annotation_ids(self, reservation: Reservation) -> Int[np.ndarray, " images"]:
        """Return the id of each image's first label, which depends on the plan alone."""
        return np.cumsum(self.labels) - self.labels + reservation.annotation_offset + 1


def parse_plan_share(text: str) -> tuple[int, int]:
    """Return k and n of "k/n"."""
    k, n = map(int, text.split("/"))
    if not 1 <= k <= n:
        raise ValueError(text)
    return k, n


PART_PARSER = make_option_parser("K/N with K from 1 to N, such as 3/8", parse_plan_share, metavar="K/N")


@Parameter(name="*")
@dataclass(frozen=True, slots=True)
class Part:
    """Images of a plan.

    Parameters
    ----------
    limit
        Only the first images of the plan, this many.
    share
        Of these the K-th of N equal shares, for N machines; then `hulldown join`. In Python (K, N).
    """

    limit: Count | None = None
    share: Annotated[tuple[int, int], PART_PARSER, Parameter(show_default=False)] = (1, 1)

    def __post_init__(self) -> None:
        if self.limit is not None and self.limit < 0:
            raise ValueError(f"limit: expected at least 0, got {self.limit}")
        if not 1 <= self.share[0] <= self.share[1]:
            raise ValueError(f"share: expected (k, n) with k from 1 to n, got {self.share}")

    def part_rows(self, outline: Outline) -> list[OutlineRow]:
        """Return the part's rows, ordered so that workers can keep loaded assets; shares have neighbors."""
        rows, (k, n) = sorted(outline.rows[: self.limit]), self.share
        return rows[(k - 1) * len(rows) // n : k * len(rows) // n]


WHOLE_PLAN = Part()


def row_sort_key(row: Row) -> SortKey:
    """Return a row's sort key, the costliest change first: scenery, vehicle, weather, position with vehicles, HDRI."""
    return row.scenery, row.target.vehicle, row.weather.kind if row.weather else "", row.position, row.hdri


def file_stamp(path: Path) -> tuple[int, int, int] | None:
    """Return identity, size, and modification time of a file; None if there is none."""
    try:
        stat = path.stat()
    except OSError:
        return None
    return stat.st_ino, stat.st_size, stat.st_mtime_ns
