"""The `hulldown` command: arguments, progress, exit codes; no logic.

Messages and progress go to stderr, results to stdout, so that `--json` can be piped. Exit code 0: done; 1: done, but
something failed or was found; 2: a user's mistake, explained in one line; 130: stopped by Ctrl-C, or `render` by
SIGTERM.

Stages are imported where they're used, so that `hulldown --help` doesn't wait for SciPy.
"""

from __future__ import annotations

import argparse
import errno
import io
import sys
from collections.abc import Sequence
from pathlib import Path

from rich.markup import escape

from hulldown.base.errors import HulldownError, shortened
from hulldown.base.terminal import STDERR, say
from hulldown.verbs import cluster, planning, rendering, study, training
from hulldown.verbs.arguments import add_verb
from hulldown.verbs.output import DONE, FOUND, MISTAKE, STOPPED, show_result, silence_stdout, warnings_in_one_line

LONGEST_LINE = 2000  # characters of a message
# Errors of the file system that aren't bugs: a full disk, missing rights, a file instead of a folder or the reverse.
REFUSALS = (
    *(errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS, errno.EACCES, errno.EPERM),
    *(errno.ENOTDIR, errno.EISDIR, errno.ENAMETOOLONG, errno.ELOOP),
)

CHANGED = (errno.ENOENT, errno.EINVAL, errno.ESTALE)  # a named file that is gone, or something else than before


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line and return the exit code."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # an ASCII terminal must not fail a finished run
            stream.reconfigure(errors="backslashreplace")
    arguments = parser().parse_args(argv)
    try:
        with warnings_in_one_line():
            return arguments.run(arguments) or DONE
    except HulldownError as error:
        STDERR.print(f"hulldown: {escape(shortened(str(error), LONGEST_LINE))}", soft_wrap=True)
        return MISTAKE
    except KeyboardInterrupt:
        stopped = "the same command goes on from here" if arguments.resumes else "nothing was written"
        STDERR.print(f"hulldown: stopped; {stopped}")
        return STOPPED
    except BrokenPipeError:
        # The reader of stdout is gone, as with `head`.
        silence_stdout()
        return DONE
    except OSError as error:
        if error.errno not in REFUSALS and not (error.errno in CHANGED and error.filename):
            raise
        STDERR.print(f"hulldown: {escape(error.filename or 'stdout')}: {error.strerror}", soft_wrap=True)
        if error.filename is None:
            silence_stdout()
        return MISTAKE


def _doctor(arguments: argparse.Namespace) -> int:
    from hulldown.rendering.doctor import diagnose

    with STDERR.status("asking Blender"):
        diagnosis = diagnose()
    problems = [f"problem: {problem}" for problem in diagnosis.problems]
    show_result(arguments, diagnosis, diagnosis.table(), *problems or ["all well: this machine can plan and render"])
    return FOUND if diagnosis.problems else DONE


def _demo(arguments: argparse.Namespace) -> int:
    """Run the verbs of the demo one after the other."""
    folder = arguments.output
    config, plan, dataset = folder / "hulldown.toml", folder / "plan.jsonl", folder / "dataset"
    steps = [
        ["plan", config, "-o", plan],
        ["preview", plan, "-o", folder / "preview.png"],
        ["render", plan, "-o", dataset],
        ["verify", dataset, "--plan", plan],
    ]
    if not config.exists():
        steps.insert(0, ["init", folder, "--small"])
    for step in steps:
        words = [str(word) for word in step]
        STDERR.rule(escape(f"hulldown {' '.join(words)}"), align="left")
        if code := main(words):
            return code
    from hulldown.dataset.table import Dataset
    from hulldown.pictures.own_files import save_picture

    save_picture(Dataset.read(dataset).sheet(count=12, columns=3, masks=False), folder / "contact_sheet.png")
    say(f"look at {folder / 'contact_sheet.png'}; the dataset is {dataset / 'annotations.json'}")
    return DONE


def parser() -> argparse.ArgumentParser:
    """Return the command's arguments."""
    command = argparse.ArgumentParser(
        prog="hulldown", description="Plan, render and annotate synthetic detection datasets of vehicles on terrain."
    )
    subparsers = command.add_subparsers(required=True, metavar="VERB")

    for stage in (planning, rendering, cluster, training, study):
        stage.add(subparsers)
    add_verb(subparsers, "doctor", _doctor, "check this machine", "Reads nothing, writes nothing.")

    sub = add_verb(
        subparsers, "demo", _demo, "run all verbs on a small example",
        "Writes a project, a plan, a dataset of 12 images, a contact sheet.", resumes=True, json=False,
    )  # fmt: skip
    sub.add_argument(
        "-o", "--output", type=Path, default=Path("hulldown-demo"), metavar="DIR", help="default: hulldown-demo"
    )
    return command


if __name__ == "__main__":
    sys.exit(main())
