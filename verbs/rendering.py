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


def _render_output(report: RenderReport, output: AnyPath) -> VerbOutput:
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


def _blend_output(path: Path) -> VerbOutput:
    return VerbOutput(result=path, said=[f"wrote {path}; open it in Blender, and press F12 for the picture"])


def _cluster_output(_: None) -> VerbOutput:
    return VerbOutput(result=None)


def _join_output(joined: Joined, output: AnyPath) -> VerbOutput:
    missing = f"{joined.missing} planned images are not there yet, {joined.failed} of them given up"
    return VerbOutput(
        result=joined,
        said=[f"{joined.added} images added, {joined.already} were there; next: hulldown verify {output}"],
        warnings=[f"{missing}; join again when there are more"] if joined.missing else [],
    )


def _verify_output(found: Findings, dataset: AnyPath) -> VerbOutput:
    errors = sum(finding.severity == "error" for finding in found)
    masks = f", {len(found.masks.rows)} masks rendered" if found.masks else ""
    return VerbOutput(
        result=found,
        shown=[*([found.masks.table()] if found.masks else []), *found.lines()],
        said=[f"{dataset}: {errors} errors, {len(found) - errors} warnings{masks}"],
        code=FOUND if errors else DONE,
    )


def _report_output(comparison: Comparison | None, output: AnyPath) -> VerbOutput:
    rows = comparison.rows() if comparison else []
    lines = [f"{distance}  {title} ({keys})" for title, distance, keys in rows]
    return VerbOutput(result=comparison and comparison.distances(), shown=lines, said=[f"wrote {output}"])


def _export_output(counts: Mapping[str, int], output: AnyPath) -> VerbOutput:
    return VerbOutput(result=counts, said=[f"wrote {output}: " + ", ".join(f"{n} {name}" for name, n in counts.items())])


VERBS = {
    "render": Verb("render.supervisor:render_remaining_images", _render_output, resumes=True),
    "blend": Verb("render.export_scene:export_scene", _blend_output),
    "cluster": Verb("cluster.scheduler:run_local_cluster", _cluster_output),
    "join": Verb("dataset.join:join_datasets", _join_output, resumes=True),
    "verify": Verb("render.verify:verify_dataset", _verify_output),
    "report": Verb("dataset.reports.dataset_report:report_dataset", _report_output),
    "export": Verb("dataset.exports.export:export_dataset", _export_output),
}
