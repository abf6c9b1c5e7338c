"""A study's report for people, from the contents of report.json: charts, and a page in HTML and Markdown."""

from __future__ import annotations

import re
from collections.abc import Mapping
from itertools import chain, groupby
from operator import itemgetter
from typing import Any

from matplotlib.figure import Figure

from hulldown.dataset.reports.charts import differences
from hulldown.dataset.reports.page import number, ranged, render
from hulldown.training.study.charts import beside, over_photographs
from hulldown.training.study.results import COUNTS, MEASURES
from hulldown.training.study.words import TITLES
from hulldown.training.subset import subset_name

OVER = ("f1", "recall", "precision", "ap50")
MOST_BARS = 30  # of a chart of bins
Record = Mapping[str, Any]
# The paper's precision, recall, and F1 (sections 3 and 4) by fraction and arm.
PAPER = {
    0.05: {"real": (0.88, 0.20, 0.32), "mixed": (0.91, 0.41, 0.57)},
    0.1: {"real": (0.81, 0.23, 0.35), "mixed": (0.86, 0.38, 0.53)},
    0.25: {"real": (0.95, 0.55, 0.70), "mixed": (0.88, 0.74, 0.80)},
    0.5: {"real": (0.98, 0.47, 0.64), "mixed": (0.96, 0.53, 0.69)},
    1.0: {"real": (0.93, 0.64, 0.76), "mixed": (0.97, 0.48, 0.65)},
}
PAPER_FIGURES = ("precision", "recall", "f1")


def charts_of(report: Record) -> dict[str, Figure]:
    """The charts of a report by name."""
    found = {}
    for fraction, cells in _shares(report).items():
        title = f"{100 * fraction:.10g} % of the photographs ({cells[0]['photographs']:.0f})"
        found[_share_name(fraction)] = beside(title, cells)
    if report["cells"]:
        found["over_photographs"] = over_photographs(report["cells"], OVER)
    for name, one in report["bins"].items():
        rows = [row for row in one["rows"] if row["interval"] is not None and row["labels"] >= 10][:MOST_BARS]
        if rows:
            bars = [
                (f"{row['field']}: {row['bin']} (n {row['labels']})", row["difference"], *row["interval"])
                for row in rows
            ]
            xlabel = "difference of recall (gray: the interval includes 0)"
            found[_bins_name(name)] = differences(f"recall: {name}", bars, xlabel=xlabel)
    return found


def page(report: Record, charts: Mapping[str, Figure], *, layout: str = "page.html") -> str:
    """The report as HTML or, with ``page.md``, as Markdown with charts from files next to it.

    `charts` are those of `charts_of`.
    """
    data = {
        "report": report,
        "charts": charts,
        "titles": TITLES,
        "shares": {
            _share_name(share): f"{', '.join(cell['arm'] for cell in cells)} at {100 * share:g} % of the photographs"
            for share, cells in _shares(report).items()
        },
        "figures": [
            [cell["name"], *(number(cell[key], digits=0) for key in COUNTS),
             *(ranged(cell[key], cell["intervals"][key]) for key in MEASURES)]
            for cell in report["cells"]
        ],
        "pairs": [[pair["measures"][key]["words"] for key in OVER] for pair in report["pairs"]],
        "bins_name": _bins_name,
        "paper": _paper(report),
    }  # fmt: skip
    text = render("training/study/page.jinja", data, layout=layout)
    return text if layout == "page.html" else re.sub(r"\n{3,}", "\n\n", text).rstrip() + "\n"


def _paper(report: Record) -> list[list[str]]:
    """Rows of the paper's figures, each followed by the study's."""
    cell_of = {(cell["fraction"], cell["arm"]): cell for cell in report["cells"]}
    rows = []
    for fraction, arms in PAPER.items():
        for arm, figures in arms.items():
            cell = cell_of.get((fraction, arm), {})
            pairs = [(number(value), number(cell.get(key))) for key, value in zip(PAPER_FIGURES, figures, strict=True)]
            rows.append([f"{arm} at {100 * fraction:g} %", *chain(*pairs)])
    return rows


def _shares(report: Record) -> dict[float, list[Record]]:
    """The cells of each share of the photographs, smallest share first."""
    cells = sorted((cell for cell in report["cells"] if cell["fraction"] is not None), key=itemgetter("fraction"))
    return {fraction: list(group) for fraction, group in groupby(cells, itemgetter("fraction"))}


def _share_name(fraction: float) -> str:
    return f"real_{subset_name(fraction)}"


def _bins_name(name: str) -> str:
    return "bins_" + "".join(c if c.isalnum() else "_" for c in name.replace(" %", "").replace(" at ", "_"))
