"""The verbs from a plan to a dataset and what is made of it."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from hulldown.base.arguments import AnyPath
from hulldown.verbs.command import Verb, VerbOutput
from hulldown.verbs.output import DONE, FOUND, STOPPED

if TYPE_CHECKING:
    from hulldown.dataset.join import Joined
    from hulldown.dataset.reports.dataset_report import Comparison
    from hulldown.render.supervisor import RenderReport
    from hulldown.render.verify import Findings


def _show_render(report: RenderReport, output: AnyPath) -> VerbOutput:
    done = (
        f"{report.rendered} images rendered, {report.already} were there, {len(report.failed)} failed "
        f"in {report.seconds:.0f} s; next: hulldown verify {output}"
    )
    return VerbOutput(
        result=report,
        said=[done, *(["stopped; the same command goes on from here"] if report.interrupted else [])],
        warnings=[f"reasons are in {Path(output) / 'failures.jsonl'}"] if report.failed else [],
        code=STOPPED if report.interrupted else DONE if report.complete else FOUND,
    )


def _scene(path: Path) -> VerbOutput:
    return VerbOutput(result=path, said=[f"wrote {path}; open it in Blender, and press F12 for the picture"])


def _show_cluster(_: None) -> VerbOutput:
    return VerbOutput(result=None)


def _show_join(joined: Joined, output: AnyPath) -> VerbOutput:
    missing = f"{joined.missing} planned images are not there yet, {joined.failed} of them given up"
    return VerbOutput(
        result=joined,
        said=[f"{joined.added} images added, {joined.already} were there; next: hulldown verify {output}"],
        warnings=[f"{missing}; join again when there are more"] if joined.missing else [],
    )


def _show_findings(found: Findings, dataset: AnyPath) -> VerbOutput:
    errors = sum(finding.severity == "error" for finding in found)
    masks = f", {len(found.masks.rows)} masks rendered" if found.masks else ""
    return VerbOutput(
        result=found,
        shown=[*([found.masks.table()] if found.masks else []), *found.lines()],
        said=[f"{dataset}: {errors} errors, {len(found) - errors} warnings{masks}"],
        code=FOUND if errors else DONE,
    )


def _show_page(comparison: Comparison | None, output: AnyPath) -> VerbOutput:
    rows = comparison.rows() if comparison else []
    lines = [f"{distance}  {title} ({keys})" for title, distance, keys in rows]
    return VerbOutput(result=comparison and comparison.distances(), shown=lines, said=[f"wrote {output}"])


def _show_export(counts: Mapping[str, int], output: AnyPath) -> VerbOutput:
    return VerbOutput(result=counts, said=[f"wrote {output}: " + ", ".join(f"{n} {name}" for name, n in counts.items())])


VERBS = {
    "render": Verb("render.supervisor:render_remaining", _show_render, resumes=True),
    "blend": Verb("render.export_scene:export_scene", _scene),
    "cluster": Verb("cluster.scheduler:run_cluster", _show_cluster),
    "join": Verb("dataset.join:join_datasets", _show_join, resumes=True),
    "verify": Verb("render.verify:verify_dataset", _show_findings),
    "report": Verb("dataset.reports.dataset_report:report_dataset", _show_page),
    "export": Verb("dataset.exports.export:export_dataset", _show_export),
}
