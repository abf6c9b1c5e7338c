"""A study's report for people, from the contents of report.json: charts, and the same blocks as HTML and Markdown."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from itertools import groupby
from typing import Any

from matplotlib.figure import Figure

from hulldown.dataset.reports.charts import differences, svg
from hulldown.dataset.reports.page import Block, Chart, Items, PageSection, Table, Words
from hulldown.training.evaluation.evaluation_page import number, ranged
from hulldown.training.study.charts import beside, over_photographs
from hulldown.training.study.results import COUNTS, MEASURES
from hulldown.training.study.words import TITLES
from hulldown.training.subset import subset_name

OVER = ("f1", "recall", "precision", "ap50")
OVER_NAME = "over_photographs"
MOST_BARS = 30  # of a chart of bins
TITLE = "Worth of synthetic images"
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
    for fraction in _fractions(report):
        own = _at(report, fraction)
        title = f"{100 * fraction:.10g} % of the photographs ({own[0]['photographs']:.0f})"
        found[f"real_{subset_name(fraction)}"] = beside(title, own)
    if report["cells"]:
        found[OVER_NAME] = over_photographs(report["cells"], OVER)
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


def sections(report: Record, charts: Mapping[str, Figure]) -> list[PageSection]:
    """The report's sections, with the charts of `charts_of`."""

    def chart(name: str, description: str) -> list[Block]:
        return [Chart(svg(charts[name]), description, name)] if name in charts else []

    over = chart(OVER_NAME, "F1, recall, precision and AP50 of each arm over the number of photographs, with bands")
    return [
        PageSection("Summary", [*over, Items(report["summary"]), *_setting(report), Words(report["sureness"])]),
        PageSection("Worth in photographs", _worth(report)),
        PageSection("Each share of the photographs", _at_each(report, chart)),
        PageSection("Pairs of arms", _pairs(report)),
        PageSection("Recall by bin", _where(report, chart)),
        PageSection("Comparison with the paper", _paper(report)),
        PageSection("All runs", _runs(report)),
    ]


def markdown(report: Sequence[PageSection]) -> str:
    """The report as Markdown, with charts from files next to it."""
    parts = [f"# {TITLE}"]
    for section in report:
        parts.append(f"## {section.heading}")
        for block in section.blocks:
            match block:
                case Words(text):
                    parts.append(text)
                case Items(texts):
                    parts.append("\n".join(f"- {text}" for text in texts))
                case Table(header, rows, title):
                    lines = [header, ["---", *["---:"] * (len(header) - 1)], *rows]
                    cells = [[cell.replace("|", r"\|") for cell in line] for line in lines]
                    parts.append("\n".join(f"| {' | '.join(line)} |" for line in cells))
                    if title:
                        parts.insert(-1, f"{title}:")
                case Chart(_, description, name):
                    parts.append(f"![{description}]({name}.png)")
    return "\n\n".join(part for part in parts if part) + "\n"


def _setting(report: Record) -> list[Block]:
    study = report["study"]
    train, sets = study["train"], study["datasets"]
    images = ", ".join(f"{one['images']} in {name}" for name, one in sets.items())
    threshold = study["threshold"]
    how = (
        "that of the best F1 on the validation photographs"
        if threshold == "validation"
        else f"{threshold:g}, as configured"
    )
    twice = " (matched: twice as many)" if "matched" in study["arms"] else ""
    blocks: list[Block] = [
        Words(
            f"{study['runs']} trainings of {train['model']} on {train['budget']:,} draws each{twice}, seeds "
            f"{', '.join(map(str, study['seeds']))}. Images: {images}. Classes: {', '.join(study['classes'])}. "
            f"Detections count if their confidence is at least {how}. A true positive has an IoU of at least "
            f"{study['iou']:g} with a label of its class."
        )
    ]
    if report["missing"]:
        blocks.append(Words("Missing runs:"))
        blocks.append(Items([f"{name}: {reason}" for name, reason in report["missing"].items()]))
    return blocks


def _worth(report: Record) -> list[Block]:
    if not report["worth"]:
        return [Words("No worth is shown. It needs at least two shares of the photographs and a synthetic arm.")]
    note = (
        "How many more photographs the real arm needs to be as good. Between two shares, its curve is a straight line "
        "over the logarithm of their number. There are no estimates beyond the available photographs."
    )
    return [Words(note), Items([one["words"] for one in report["worth"]])]


def _at_each(report: Record, chart: Callable[[str, str], list[Block]]) -> list[Block]:
    blocks: list[Block] = [
        Words("As the paper's Figures 5 to 9. Counts are means over seeds; lines on bars are 95 % intervals.")
    ]
    for fraction in _fractions(report):
        arms = ", ".join(cell["arm"] for cell in _at(report, fraction))
        blocks += chart(f"real_{subset_name(fraction)}", f"{arms} at {100 * fraction:g} % of the photographs")
    rows = [
        [cell["name"], *(_count(cell[key]) for key in COUNTS),
         *(ranged(cell[key], cell["intervals"][key]) for key in MEASURES)]
        for cell in report["cells"]
    ]  # fmt: skip
    return [*blocks, Table(["", *TITLES.values()], rows, "all figures")]


def _pairs(report: Record) -> list[Block]:
    sentences = [[one["words"] for key, one in pair["measures"].items() if key in OVER] for pair in report["pairs"]]
    note = "Both arms have the same resamples of the test pictures. An interval that includes 0 shows no difference."
    return [Words(note), *map(Items, sentences)]


def _where(report: Record, chart: Callable[[str, str], list[Block]]) -> list[Block]:
    blocks: list[Block] = [
        Words(
            "Recall in the bins of `hulldown evaluate`, mixed minus real, with intervals from resampled test "
            "pictures. Among many bins, a few intervals exclude 0 by chance. The sentences name bins of at least ten "
            "labels whose interval excludes 0."
        )
    ]
    for name, one in report["bins"].items():
        blocks += [Words(f"{name}:"), Items(one["words"] or ["No bin has an interval that excludes 0."])]
        blocks += chart(_bins_name(name), f"differences of recall in bins, {name}")
        rows = [
            [f"{row['field']}: {row['bin']}", str(row["labels"]), *(number(value) for value in row["recall"]),
             ranged(row["difference"], row["interval"], sign="+")]
            for row in one["rows"]
        ]  # fmt: skip
        blocks.append(
            Table(["bin", "labels", "recall, real", "recall, mixed", "difference"], rows, f"all bins, {name}")
        )
    return blocks


def _paper(report: Record) -> list[Block]:
    cell_of = {(cell["fraction"], cell["arm"]): cell for cell in report["cells"]}
    rows = []
    for fraction, arm in [(fraction, arm) for fraction in PAPER for arm in ("real", "mixed")]:
        cell = cell_of.get((fraction, arm))
        row = [f"{arm} at {100 * fraction:g} %"]
        for key, value in zip(PAPER_FIGURES, PAPER[fraction][arm], strict=True):
            row += [number(value), number(cell[key] if cell else None)]
        rows.append(row)
    header = ["", *(f"{TITLES[key]}, {whose}" for key in PAPER_FIGURES for whose in ("paper", "here"))]
    return [
        Words(
            "The paper trained RF-DETR medium once per arm on 420 photographs, as many synthetic images, "
            "and 25,000 draws, and tested on 320 photographs with 1,079 labels. Its text has no intervals and "
            "not all figures. Other data, models, and budgets give other figures; compare whether and where the "
            "difference between the arms changes its sign."
        ),
        Table(header, rows),
    ]


def _runs(report: Record) -> list[Block]:
    rows = [
        [one["name"], str(one["photographs"]), *(_count(one["drawn"].get(key, 0)) for key in ("real", "synthetic")),
         number(one["threshold"]), *(number(one[key]) for key in ("precision", "recall", "f1", "ap50", "ap")),
         _count(report["times"].get(one["name"]))]
        for one in report["runs"]
    ]  # fmt: skip
    figures = [TITLES[key] for key in ("precision", "recall", "f1", "ap50", "ap")]
    return [Table(["run", "photographs", "draws, real", "draws, synthetic", "threshold", *figures, "seconds"], rows)]


def _fractions(report: Record) -> list[float]:
    found = [cell["fraction"] for cell in report["cells"] if cell["fraction"] is not None]
    return [fraction for fraction, _ in groupby(sorted(found))]


def _at(report: Record, fraction: float) -> list[Record]:
    return [cell for cell in report["cells"] if cell["fraction"] == fraction]


def _bins_name(name: str) -> str:
    return "bins_" + "".join(c if c.isalnum() else "_" for c in name.replace(" %", "").replace(" at ", "_"))


def _count(value: float | int | None) -> str:
    return "–" if value is None or math.isnan(value) else f"{value:,.0f}"
