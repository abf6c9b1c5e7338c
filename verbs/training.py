"""The verbs from datasets to an evaluated detector."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from hulldown.base.arguments import AnyPath
from hulldown.verbs.command import Verb, VerbOutput
from hulldown.verbs.output import DONE, FOUND

if TYPE_CHECKING:
    from hulldown.training.detectors.detector import Run
    from hulldown.training.evaluation.detector_report import DetectorReport, DetectorReports
    from hulldown.training.predict import Predicted
    from hulldown.training.study.study_comparison import StudyReport
    from hulldown.training.study.train_study import StudyOutcome


def _subset_output(counts: Mapping[str, int], output: AnyPath) -> VerbOutput:
    sizes = ", ".join(f"{n} images in {name}" for name, n in counts.items())
    return VerbOutput(result=counts, said=[f"wrote {output}: {sizes}"])


def _augment_output(_: None, output: AnyPath) -> VerbOutput:
    return VerbOutput(result=output, said=[f"wrote {output}"])


def _train_output(run: Run, output: AnyPath, valid: AnyPath | None) -> VerbOutput:
    found = run.figures.valid
    figures = [f"on {valid}: AP {found['ap']:.3f}, AP50 {found['ap50']:.3f}"] if found else []
    written = f"wrote {output}; next: hulldown predict {output} DATASET -o predictions.json"
    return VerbOutput(result=run, said=[*figures, written])


def _predict_output(
    done: Predicted, pictures: Sequence[AnyPath], output: AnyPath, drawn: AnyPath | None, threshold: float
) -> VerbOutput:
    unknown = f"{pictures[0]} has no class {', '.join(done.unknown)}: detections of it count as false positives"
    counts = ", ".join(f"{n} {name}" for name, n in done.counts.items()) or "nothing"
    again = f", {done.already} of them done before" if done.already else ""
    return VerbOutput(
        result=done,
        said=[
            f"found with a score of at least {threshold:g}: {counts}",
            *([f"look at {drawn}"] if drawn else []),
            f"wrote {output}: {done.detections} detections in {done.images} images{again}",
        ],
        warnings=[unknown] if done.unknown else [],
    )


def _export_model_output(about: Mapping[str, object], output: AnyPath) -> VerbOutput:
    return VerbOutput(result=about, said=[f"wrote {output}; {about['input']}; {about['output']}"])


def _evaluate_output(found: DetectorReport | DetectorReports, output: AnyPath) -> VerbOutput:
    return VerbOutput(result=found, said=[*found.lines(), f"look at {Path(output) / 'report.html'}"])


def _study_init_output(config: Path) -> VerbOutput:
    return VerbOutput(result=config, said=[f"wrote {config}; next: hulldown study run {config} -o STUDY"])


def _study_run_output(done: StudyOutcome, output: AnyPath) -> VerbOutput:
    finished, left = len(done.finished) + len(done.already), len(done.failed) + len(done.elsewhere)
    runs = f"{finished} of {finished + left} runs are finished"
    return VerbOutput(
        result=done,
        said=[f"{runs}; next: hulldown study report {output}"],
        warnings=[f"{name} was set aside: {reason}" for name, reason in done.failed.items()],
        code=FOUND if done.failed else DONE,
    )


def _study_report_output(found: StudyReport, study: AnyPath) -> VerbOutput:
    return VerbOutput(result=found, said=[*found.summary, f"look at {Path(study) / 'report.html'}"])


VERBS = {
    "subset": Verb("training.subset:write_subsets", _subset_output),
    "augment": Verb("training.sheet:write_augmentation_sheet", _augment_output),
    "train": Verb("training.train:train_detector", _train_output, resumes=True),
    "predict": Verb("training.predict:predict_detections", _predict_output, resumes=True),
    "export_model": Verb("training.onnx_model:export_model", _export_model_output),
    "evaluate": Verb("training.evaluation.evaluation_report:evaluate_detections", _evaluate_output),
    "study init": Verb("training.study.config:write_study_config", _study_init_output),
    "study run": Verb("training.study.train_study:train_study", _study_run_output, resumes=True),
    "study report": Verb("training.study.study_page:write_study_report", _study_report_output),
}
