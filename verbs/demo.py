"""The verbs doctor, and demo, which runs other verbs one after the other."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from rich.markup import escape

from hulldown.base.arguments import AnyPath
from hulldown.base.terminal import STDERR_TERMINAL
from hulldown.verbs import planning, rendering
from hulldown.verbs.command import Verb, VerbOutput, run_command
from hulldown.verbs.output import DONE, FOUND

if TYPE_CHECKING:
    from hulldown.render.doctor import Diagnosis


def run_demo(*, output: AnyPath = "hulldown-demo") -> int:
    """Run all verbs on a small example.

    Writes a project, a plan, a dataset of 12 images, and a contact sheet. The same command continues one that was
    stopped.

    Parameters
    ----------
    output
        The folder to write into.
    """
    folder = Path(output)
    config, plan, dataset = folder / "hulldown.toml", folder / "plan.jsonl", folder / "dataset"
    steps = [
        ["plan", config, "-o", plan],
        ["preview", plan, "-o", folder / "preview.png"],
        ["render", plan, "-o", dataset],
        ["verify", dataset, "--plan", plan, "--masks", "12"],
    ]
    if not config.exists():
        steps.insert(0, ["init", folder, "--small"])
    for step in steps:
        words = [str(word) for word in step]
        STDERR_TERMINAL.rule(escape(f"hulldown {' '.join(words)}"), align="left")
        if code := run_command(words, planning.VERBS | rendering.VERBS):
            return code
    from hulldown.dataset.table import Dataset
    from hulldown.pictures.own_files import save_picture

    save_picture(Dataset.read(dataset).sheet(count=12, columns=3, masks=False), folder / "contact_sheet.png")
    return DONE


def _demo_output(code: int, output: AnyPath) -> VerbOutput:
    written = f"look at {Path(output) / 'contact_sheet.png'}; the dataset is {Path(output) / 'dataset/annotations.json'}"
    return VerbOutput(result=output, said=[] if code else [written], code=code)


def _doctor_output(diagnosis: Diagnosis) -> VerbOutput:
    problems = [f"problem: {problem}" for problem in diagnosis.problems]
    shown = problems or ["all well: this machine can plan and render"]
    return VerbOutput(result=diagnosis, shown=[diagnosis.table(), *shown], code=FOUND if problems else DONE)


VERBS = {
    "doctor": Verb("render.doctor:diagnose_machine", _doctor_output),
    "demo": Verb("verbs.demo:run_demo", _demo_output, resumes=True),
}
