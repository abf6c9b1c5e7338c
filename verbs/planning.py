"""The verbs up to a plan."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from rich.table import Table

from hulldown.base.arguments import AnyPath
from hulldown.verbs.command import Verb, VerbOutput
from hulldown.verbs.output import DONE, FOUND, MISTAKE

if TYPE_CHECKING:
    from hulldown.plan.plan_file import Plan
    from hulldown.planning.inputs.inspection import Inspection


def _init_output(config: Path) -> VerbOutput:
    return VerbOutput(result=config, said=[f"wrote {config}; next: hulldown inspect or plan it"])


def _inspect_output(found: Inspection) -> VerbOutput:
    shown: list[str | Table] = []
    for report in found.reports:
        shown += [report.table(), *report.lines()]
    return VerbOutput(
        result=found.reports,
        shown=shown,
        said=[f"wrote {found.picture}"] if found.picture else [],
        code=MISTAKE if found.refused else DONE,
    )


def _plan_output(plan: Plan) -> VerbOutput:
    summary, page = plan.summary, plan.path.with_suffix(".html")
    return VerbOutput(
        result=summary.to_json(),
        shown=[*summary.tables(), *summary.unmet_wish_notes()],
        said=[
            f"wrote {plan.path} ({len(plan)} images); next: hulldown preview {plan.path}, "
            f"or hulldown report {plan.path} -o {page}"
        ],
    )


def _check_output(found: Sequence[str]) -> VerbOutput:
    return VerbOutput(result=found, shown=found, said=[f"{len(found)} findings"], code=FOUND if found else DONE)


def _preview_output(picture: Path) -> VerbOutput:
    return VerbOutput(result=picture, said=[f"wrote {picture}"])


def _passes_output(images: Mapping[str, int], output: AnyPath) -> VerbOutput:
    said = f"wrote {', '.join(images)} of {max(images.values())} images into {output}"
    return VerbOutput(result=images, said=[said])


VERBS = {
    "init": Verb("demo.project:create_project", _init_output, resumes=True),
    "inspect": Verb("planning.inputs.inspection:inspect_files", _inspect_output),
    "plan": Verb("planning.write:plan_dataset", _plan_output, resumes=True),
    "check": Verb("planning.check:check_plan", _check_output),
    "preview": Verb("plan.pictures.preview:write_preview_sheet", _preview_output),
    "passes": Verb("plan.pictures.passes:write_passes", _passes_output, resumes=True),
}
