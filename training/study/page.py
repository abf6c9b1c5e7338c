"""A study's report for people, from report.json: the same blocks as Markdown and as HTML."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from itertools import groupby
from typing import Any, TypeAlias

from hulldown.dataset.reports.charts import differences, svg
from hulldown.dataset.reports.page import Block, Chart, Items, Section, Table, Words, page
from hulldown.training.evaluation.evaluation_page import number, ranged
from hulldown.training.study.charts import beside, over_photographs, png
from hulldown.training.study.paper import LABELS, PAPER, PHOTOGRAPHS, paper_figure
from hulldown.training.study.results import COUNTS, MEASURES
from hulldown.training.study.words import TITLES
from hulldown.training.subset import subset_name

OVER = ("f1", "recall", "precision", "ap50")
OVER_NAME = "over_photographs"
MOST_BARS = 30  # of a chart of bins
Record = Mapping[str, Any]


Pictures: TypeAlias = Mapping[str, tuple[bytes, bytes]]  # PNG and SVG of charts by name
TITLE = "Worth of synthetic images"


def charts_of(report: Record) -> dict[str, tuple[bytes, bytes]]:
    """PNG and SVG of every chart of a report, by name."""
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
            xlabel = "difference of recall (gray: the interval contains 0)"
            found[_bins_name(name)] = differences(f"recall: {name}", bars, xlabel=xlabel)
    return {name: (png(figure), svg(figure)) for name, figure in found.items()}


def sections(report: Record, pictures: Pictures) -> list[Section]:
    """Return the report's sections, with the pictures of `charts_of`."""

    def chart(name: str, says: str) -> list[Block]:
        return [Chart(pictures[name][1], says, name)] if name in pictures else []

    over = chart(OVER_NAME, "F1, recall, precision, and AP50 of each arm over the number of photographs, with bands")
    return [
        Section("Summary", [*over, Items(report["summary"]), *_setting(report), Words(report["sureness"])]),
        Section("Worth in photographs", _worth(report)),
        Section(
            "At each share of the photographs",
            [
                Words("As the paper's Figures 5 to 9. Counts are means over seeds; lines on bars are 95 % intervals."),
                *_at_each(report, chart),
            ],
        ),
        Section("Pairs of arms", _pairs(report)),
        Section("Where", _where(report, chart)),
        Section("Comparison with the paper", _paper(report)),
        Section("All runs", _runs(report)),
    ]


def markdown(shown: Sequence[Section]) -> str:
    """Return the report as Markdown; its charts are files next to it."""
    parts = [f"# {TITLE}"]
    for section in shown:
        parts.append(f"## {section.heading}")
        for block in section.blocks:
            match block:
                case Words(text):
                    parts.append(text)
                case Items(texts):
                    parts.append("\n".join(f"- {text}" for text in texts))
                case Table(header, rows, title):
                    lines = [header, ["---", *["---:"] * (len(header) - 1)], *rows]
                    cells = "\n".join(
                        "| " + " | ".join(cell.replace("|", r"\|") for cell in line) + " |" for line in lines
                    )
                    parts.append(f"{title}:\n\n{cells}" if title else cells)
                case Chart(_, says, name):
                    parts.append(f"![{says}]({name}.png)")
    return "\n\n".join(part for part in parts if part) + "\n"


def html(shown: Sequence[Section]) -> str:
    """Return the report as one self-contained page."""
    return page(TITLE, shown)


def _setting(report: Record) -> list[Block]:
    study = report["study"]
    train, sets = study["train"], study["datasets"]
    images = ", ".join(f"{one['images']} in {name}" for name, one in sets.items())
    threshold = study["threshold"]
    how = "its best F1 on the validation photographs" if threshold == "validation" else f"{threshold:g}, as configured"
    twice = " (matched: twice as many)" if "matched" in study["arms"] else ""
    told: list[Block] = [
        Words(
            f"{study['runs']} trainings of {train['model']} on {train['budget']:,} draws each{twice}, seeds "
            f"{', '.join(map(str, study['seeds']))}. Images: {images}. Classes: {', '.join(study['classes'])}. A "
            f"detection counts from the confidence of {how}, and is true at an IoU of {study['iou']:g} with a label of "
            "its class."
        )
    ]
    if report["missing"]:
        told.append(Words("Missing runs:"))
        told.append(Items([f"{name}: {reason}" for name, reason in report["missing"].items()]))
    return told


def _worth(report: Record) -> list[Block]:
    if not report["worth"]:
        return [Words("This needs two shares of the photographs, and an arm with synthetic images.")]
    note = (
        "How many more photographs the real arm needs to be as good. Between two shares its curve is "
        "interpolated over the logarithm of their number, and never extrapolated."
    )
    return [Words(note), Items([one["words"] for one in report["worth"]])]


def _at_each(report: Record, chart: Callable[[str, str], list[Block]]) -> list[Block]:
    told: list[Block] = []
    for fraction in _fractions(report):
        arms = " beside ".join(cell["arm"] for cell in _at(report, fraction))
        told += chart(f"real_{subset_name(fraction)}", f"{arms} at {100 * fraction:g} % of the photographs")
    rows = [
        [cell["name"], *(_count(cell[key]) for key in COUNTS),
         *(ranged(cell[key], cell["intervals"][key]) for key in MEASURES)]
        for cell in report["cells"]
    ]  # fmt: skip
    return [*told, Table(["", *TITLES.values()], rows, "all figures")]


def _pairs(report: Record) -> list[Block]:
    sentences = [[one["words"] for key, one in pair["measures"].items() if key in OVER] for pair in report["pairs"]]
    note = "Both have the same resamples of the test pictures. An interval that contains 0 shows no difference."
    return [Words(note), *map(Items, sentences)]


def _where(report: Record, chart: Callable[[str, str], list[Block]]) -> list[Block]:
    told: list[Block] = [
        Words(
            "Recall in the bins of `hulldown evaluate`, mixed minus real, with intervals from resampled test "
            "pictures. Of many bins, a few differ by chance. Listed are bins of at least ten labels whose interval "
            "excludes 0."
        )
    ]
    for name, one in report["bins"].items():
        told += [Words(f"{name}:"), Items(one["words"] or ["no bin with a shown difference"])]
        told += chart(_bins_name(name), f"differences of recall in bins, {name}")
        rows = [
            [f"{row['field']}: {row['bin']}", str(row["labels"]), *(number(value) for value in row["recall"]),
             ranged(row["difference"], row["interval"], sign="+")]
            for row in one["rows"]
        ]  # fmt: skip
        told.append(Table(["bin", "labels", "recall, real", "recall, mixed", "difference"], rows, f"all bins, {name}"))
    return told


def _paper(report: Record) -> list[Block]:
    cell_of = {(cell["fraction"], cell["arm"]): cell for cell in report["cells"]}
    rows = []
    for fraction, arm in [(fraction, arm) for fraction in PAPER for arm in ("real", "mixed")]:
        cell = cell_of.get((fraction, arm))
        row = [f"{arm} at {100 * fraction:g} %"]
        for key in ("precision", "recall", "f1"):
            row += [number(paper_figure(fraction, arm, key)), number(cell[key] if cell else None)]
        rows.append(row)
    header = ["", *(f"{TITLES[key]}, {whose}" for key in ("precision", "recall", "f1") for whose in ("paper", "here"))]
    return [
        Words(
            f"The paper's figures are of RF-DETR medium, {PHOTOGRAPHS} photographs, as many synthetic images, 25,000 "
            f"draws, and 320 test photographs with {LABELS:,} labels, from one training each, without intervals, as "
            "far as its text has them. Data, model, and budget differ: compare only whether and where the "
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
