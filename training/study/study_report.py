"""The report of a study: report.json for programs; report.html and charts for people."""

from __future__ import annotations

import json
from pathlib import Path

import msgspec

from hulldown.base.arguments import AnyPath
from hulldown.base.files import replace_file
from hulldown.training.study.study_comparison import StudyReport, compared_runs
from hulldown.training.study.study_page import draw_charts, figure_png, study_page


def write_report(study: AnyPath) -> StudyReport:
    """Compare the arms of a study.

    Reads a study, finished or not; writes report.html, report.json, and charts into it.

    Parameters
    ----------
    study
        The folder of `hulldown study run`.
    """
    study = Path(study)
    report = compared_runs(study)
    charts = draw_charts(report)
    for name, (_, figure) in charts.items():
        replace_file(study / f"{name}.png", figure_png(figure))
    text = json.dumps(msgspec.to_builtins(report), indent=2, ensure_ascii=False)
    replace_file(study / "report.json", text.encode() + b"\n")
    replace_file(study / "report.html", study_page(report, charts).encode())
    return report
