"""The `hulldown` command: arguments, progress, exit codes; no logic.

Messages and progress go to stderr, results to stdout, so that `--json` can be piped. Exit code 0: done; 1: done, but
something failed or was found; 2: a mistake of the user's, said in one line; 130: stopped by Ctrl-C, or `render` by
SIGTERM.

Stages are imported where they are used: `hulldown --help` must not wait for SciPy.
"""

from __future__ import annotations

import argparse
import dataclasses
import errno
import json
import math
import os
import sys
import unicodedata
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.segment import Segment

from geometry.errors import HulldownError


class _Terminal(Console):
    def render(self, renderable: Any, options: Any = None) -> Iterator[Segment]:
        """As Rich does, but names from other people's files cannot steer the terminal."""
        for segment in super().render(renderable, options):
            yield segment if segment.control else Segment(printable(segment.text), segment.style)

    def on_broken_pipe(self) -> None:
        """Leave it to `main`: Rich would end the process with exit code 1, as if something had been found."""
        raise BrokenPipeError


def printable(text: str) -> str:
    r"""The text with what would steer a terminal written out: escape codes, returns, changes of direction.

    Examples
    --------
    >>> print(printable("tank" + chr(27) + "[2J" + chr(0x202E)))
    tank\x1b[2J\u202e
    """
    if text.isprintable():
        return text
    return "".join(c if c == "\n" or not unicodedata.category(c).startswith("C") else _written_out(c) for c in text)


def _written_out(char: str) -> str:
    return char.encode("unicode_escape").decode("ascii")


STDERR = _Terminal(stderr=True, highlight=False)
STDOUT = _Terminal(highlight=False)
LONGEST_LINE = 2000  # characters of a message
DONE, FOUND, MISTAKE, STOPPED = 0, 1, 2, 130
# What a disk or its owner refuses is nobody's bug, nor is a file where a folder must be, or the other way round.
REFUSALS = (
    *(errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EACCES, errno.EPERM),
    *(errno.ENOTDIR, errno.EISDIR, errno.ENAMETOOLONG, errno.ELOOP),
)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line and return the exit code."""
    arguments = _parser().parse_args(argv)
    try:
        with _warnings_in_one_line():
            return arguments.run(arguments)
    except HulldownError as error:
        STDERR.print(f"hulldown: {escape(_in_one_line(str(error)))}", soft_wrap=True)
        return MISTAKE
    except KeyboardInterrupt:
        goes_on = arguments.run in (_init, _plan, _render, _join, _demo)
        STDERR.print(f"hulldown: stopped; {'the same command goes on from here' if goes_on else 'nothing was written'}")
        return STOPPED
    except BrokenPipeError:
        # The reader of our stdout has gone, as `head` does; nothing more can be said there.
        _silence_stdout()
        return DONE
    except OSError as error:
        if error.errno not in REFUSALS:
            raise
        STDERR.print(f"hulldown: {escape(error.filename or 'stdout')}: {error.strerror}", soft_wrap=True)
        _silence_stdout()
        return MISTAKE


def _in_one_line(message: str) -> str:
    """A message without line breaks of the names in it, and with its middle left out where it fills a screen."""
    line = " ".join(message.splitlines())
    return line if len(line) <= LONGEST_LINE else f"{line[: LONGEST_LINE // 2]} ... {line[-LONGEST_LINE // 2 :]}"


@contextmanager
def _warnings_in_one_line() -> Iterator[None]:
    """What a stage warns the user of is shown as everything else is, without a place in the code."""
    with warnings.catch_warnings():
        elsewhere = warnings.showwarning

        def show(message: Warning | str, category: type[Warning], *where: Any, **more: Any) -> None:
            if category is UserWarning:
                _warn(str(message))
            else:
                elsewhere(message, category, *where, **more)

        warnings.showwarning = show
        yield


def _silence_stdout() -> None:
    """What is still buffered must not fail again when Python ends."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _init(arguments: argparse.Namespace) -> int:
    from demo.project import create_project

    _make_room(arguments.folder / "hulldown.toml")
    with _progress("building demo assets") as advance:
        config = create_project(arguments.folder, seed=arguments.seed, small=arguments.small, progress=advance)
    _say(f"wrote {config}; next: hulldown plan {config} -o plan.jsonl")
    return DONE


def _inspect(arguments: argparse.Namespace) -> int:
    from planning.config import load_config
    from planning.loading import inspect_config
    from reading.inspect import Inspected, inspect, write_pictures

    if arguments.output:
        _make_room_for_picture(arguments.output)
    inspected: list[Inspected] = []
    for path in arguments.files:
        with _reading() as progress:
            shared = {
                "strict": arguments.strict,
                "pictures": bool(arguments.output),
                "progress": progress,
                "limits": _read_limits(arguments),
            }
            if path.suffix.lower() == ".toml":
                found = inspect_config(load_config(path), **shared)
            else:
                found = [inspect(path, kind=arguments.kind, **shared)]
        if not arguments.json:
            for one in found:
                STDOUT.print(one.report.table())
                _list(one.report.notes())
        inspected += found
    if arguments.output:
        write_pictures(inspected, arguments.output)
    if arguments.json:
        _print_json([one.report.to_json() for one in inspected])
    return DONE


def _plan(arguments: argparse.Namespace) -> int:
    from planning.config import load_config
    from planning.loading import load_assets
    from planning.write import write_plan

    if arguments.check:
        arguments.plan = arguments.config
        return _check(arguments)
    if arguments.output is None:
        raise HulldownError("-o is missing", remedy="say where to write the plan, such as -o plan.jsonl")
    if arguments.output.suffix.lower() == ".png":
        raise HulldownError(
            "a plan is text, and its picture gets this name", path=arguments.output, remedy="name it .jsonl"
        )
    config = load_config(arguments.config)
    _make_room(arguments.output)
    _make_room_for_picture(_picture_of(arguments.output, "summary"))
    with _reading() as progress:
        assets = load_assets(
            config,
            strict=arguments.strict,
            cache=arguments.cache,
            progress=progress,
            warn=_warn,
            limits=_read_limits(arguments),
        )
    with _progress("planning") as advance:
        plan = write_plan(config, assets, arguments.output, workers=arguments.workers, progress=advance)
    return _summarise(plan, arguments)


def _summarise(plan: Any, arguments: argparse.Namespace) -> int:
    from planning.summary import summarise

    summary = summarise(plan)
    picture = _picture_of(arguments.output, "summary")
    summary.draw(picture)
    if arguments.json:
        _print_json(summary.to_json())
    else:
        for table in summary.tables():
            STDOUT.print(table)
    _say(f"wrote {arguments.output} ({len(plan)} images) and {picture}; next: hulldown preview {arguments.output}")
    return DONE


def _check(arguments: argparse.Namespace) -> int:
    from planning.check import check_plan
    from planning.loading import load_planned_assets
    from planning.plan_file import read_plan

    plan = read_plan(arguments.plan)
    with _reading() as progress:
        assets = load_planned_assets(plan, cache=arguments.cache, progress=progress, limits=_read_limits(arguments))
    with _progress("checking") as advance:
        findings = check_plan(plan, assets, progress=advance)
    if arguments.json:
        _print_json(findings)
    else:
        _list(findings)
    _say(f"{len(plan)} images checked, {len(findings)} limits broken")
    return FOUND if findings else DONE


def _preview(arguments: argparse.Namespace) -> int:
    from planning.loading import load_planned_assets
    from planning.plan_file import read_plan
    from planning.preview import preview_sheet

    plan = read_plan(arguments.plan)
    output = arguments.output or _picture_of(arguments.plan, "preview")
    _make_room_for_picture(output)
    with _reading() as progress:
        assets = load_planned_assets(plan, cache=arguments.cache, progress=progress, limits=_read_limits(arguments))
    with _progress("shading") as advance:
        preview_sheet(plan, assets, output, count=arguments.count, progress=advance)
    _say(f"wrote {output}")
    return DONE


def _render(arguments: argparse.Namespace) -> int:
    from render.pool import DEFAULT_LIMITS
    from render.supervisor import render_plan

    with _progress("rendering") as advance:

        def show(progress: Any) -> None:
            if progress.line:
                _say(progress.line)
            advance(progress.finished, progress.images)

        report = render_plan(
            arguments.plan,
            arguments.output,
            workers=arguments.workers,
            device=arguments.device,
            limit=arguments.limit,
            share=arguments.share,
            blender=arguments.blender,
            limits=dataclasses.replace(DEFAULT_LIMITS, job_s=arguments.image_timeout),
            read_limits=_read_limits(arguments),
            cache=arguments.cache,
            progress=show,
        )
    if arguments.json:
        _print_json(dataclasses.asdict(report))
    _say(
        f"{report.rendered} images rendered, {report.already} were there, {len(report.failed)} failed "
        f"in {report.seconds:.0f} s; next: hulldown verify {arguments.output}"
    )
    if report.failed:
        _warn(f"reasons are in {arguments.output / 'failures.jsonl'}")
    if report.interrupted:
        _say("stopped; the same command goes on from here")
        return STOPPED
    return DONE if report.complete else FOUND


def _join(arguments: argparse.Namespace) -> int:
    from dataset.join import join

    with _progress("joining") as advance:
        joined = join(arguments.parts, arguments.output, allow_links=arguments.allow_links, progress=advance)
    if arguments.json:
        _print_json(dataclasses.asdict(joined))
    _say(f"{joined.added} images added, {joined.already} were there; next: hulldown verify {arguments.output}")
    if joined.missing:
        _warn(
            f"{joined.missing} planned images are not there yet, {joined.failed} of them given up; "
            "join again when there are more"
        )
    return DONE


def _verify(arguments: argparse.Namespace) -> int:
    from dataset.verify import verify

    if arguments.masks and not arguments.plan:
        raise HulldownError("--masks needs --plan, whose poses are rendered again")
    look, findings = _look(arguments)
    with _progress("checking") as advance:
        options = {"plan": arguments.plan, "fast": arguments.fast, "look": look, "progress": advance}
        findings += verify(arguments.dataset, **options)
    checked = 0
    if arguments.masks:
        from render.masks import verify_masks

        with _progress("rendering masks") as advance:
            measured = verify_masks(
                arguments.dataset, arguments.plan, count=arguments.masks, cache=arguments.cache, progress=advance
            )
        checked = len(measured.rows)
        findings += measured.findings
        if not arguments.json:
            STDOUT.print(measured.table())
    if arguments.json:
        _print_json([dataclasses.asdict(finding) for finding in findings])
    else:
        _list([str(finding) for finding in findings])
    errors = sum(finding.severity == "error" for finding in findings)
    masks = f", {checked} masks rendered" if arguments.masks else ""
    _say(f"{arguments.dataset}: {errors} errors, {len(findings) - errors} warnings{masks}")
    return FOUND if errors else DONE


def _look(arguments: argparse.Namespace) -> tuple[Any, list[Any]]:
    """What `verify` looks for in pictures of a plan, and what it has to say if it cannot."""
    if arguments.plan is None or arguments.fast:
        return None, []
    from dataset.check_skies import sky_check
    from dataset.document import read_coco
    from dataset.records import Finding
    from planning.plan_file import read_plan

    coco = read_coco(arguments.dataset)
    try:
        with _reading():
            return sky_check(read_plan(arguments.plan), coco, cache=arguments.cache), []
    except HulldownError as error:
        return None, [Finding("warning", arguments.plan.name, f"skies are not looked at: {error}")]


def _export(arguments: argparse.Namespace) -> int:
    from dataset.split import export

    with _progress("linking images") as advance:
        counts = export(
            arguments.dataset,
            arguments.output,
            layout=arguments.format,
            fractions=arguments.split,
            allow_links=arguments.allow_links,
            progress=advance,
        )
    if arguments.json:
        _print_json(counts)
    _say(f"wrote {arguments.output}: " + ", ".join(f"{n} {name}" for name, n in counts.items()))
    return DONE


def _subset(arguments: argparse.Namespace) -> int:
    from training.subset import write_subsets

    with _progress("linking images") as advance:
        counts = write_subsets(
            arguments.dataset, arguments.output, fractions=arguments.fractions, seed=arguments.seed,
            stratified=arguments.stratified, progress=advance,
        )  # fmt: skip
    if arguments.json:
        _print_json(counts)
    _say(f"wrote {arguments.output}: " + ", ".join(f"{n} images in {name}" for name, n in counts.items()))
    return DONE


def _augment(arguments: argparse.Namespace) -> int:
    from training.extra import require_extra

    require_extra()
    from training.sheet import augmentation_sheet

    _make_room(arguments.output)
    with _progress("augmenting") as advance:
        sheet = augmentation_sheet(
            arguments.dataset, rows=arguments.rows, seed=arguments.seed, config=arguments.config, progress=advance
        )
    sheet.save(arguments.output)
    _say(f"wrote {arguments.output}")
    return DONE


def _train(arguments: argparse.Namespace) -> int:
    from training.extra import require_extra
    from training.settings import FLAGS, load_settings

    settings = load_settings(arguments.config, {name: getattr(arguments, name) for name in FLAGS})
    require_extra()
    from training.train import train

    with _stages() as advance:
        run = train(
            dict(arguments.data), arguments.output, settings=settings, valid=arguments.valid,
            workers=arguments.workers, device=arguments.device, progress=advance, say=_say,
        )  # fmt: skip
    if arguments.json:
        _print_json(run)
    _say(f"wrote {arguments.output}; next: hulldown predict {arguments.output} DATASET -o predictions.json")
    return DONE


def _predict(arguments: argparse.Namespace) -> int:
    from training.extra import require_extra

    require_extra()
    from training.predict import predict

    _make_room(arguments.output)
    with _progress("predicting") as advance:
        done = predict(
            arguments.detector, arguments.dataset, arguments.output, device=arguments.device, batch=arguments.batch,
            progress=advance,
        )  # fmt: skip
    if done.unknown:
        _warn(f"{arguments.dataset} has no class {', '.join(done.unknown)}: what is found of it counts as false alarms")
    if arguments.json:
        _print_json(dataclasses.asdict(done))
    _say(
        f"wrote {arguments.output}: {done.detections} detections in {done.images} images, {done.already} of them done "
        f"before; next: hulldown evaluate {arguments.dataset} {arguments.output} -o report"
    )
    return DONE


def _evaluate(arguments: argparse.Namespace) -> int:
    from training.evaluation import evaluate_files

    with _progress("evaluating") as advance:
        found = evaluate_files(
            arguments.dataset,
            arguments.predictions,
            arguments.output,
            threshold=arguments.threshold,
            iou=arguments.iou,
            validation=arguments.validation or (),
            progress=advance,
        )
    if arguments.json:
        _print_json(found)
    for name, one in found.get("runs", {found.get("predictions"): found}).items():
        figures = (f"{key} {_figure(one['overall'][key])}" for key in ("precision", "recall", "f1", "ap50"))
        _say(f"{name}: {', '.join(figures)}")
    _say(f"look at {arguments.output / 'report.html'}")
    return DONE


def _figure(value: float | None) -> str:
    return "undefined" if value is None else f"{value:.3f}"


def _doctor(arguments: argparse.Namespace) -> int:
    from render.doctor import diagnose

    with STDERR.status("asking Blender"):
        diagnosis = diagnose()
    if arguments.json:
        _print_json(dataclasses.asdict(diagnosis))
    else:
        STDOUT.print(diagnosis.table())
        _list([f"problem: {problem}" for problem in diagnosis.problems])
        if not diagnosis.problems:
            _list(["all well: this machine can plan and render"])
    return FOUND if diagnosis.problems else DONE


def _demo(arguments: argparse.Namespace) -> int:
    """The verbs one after the other, as a user would type them."""
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
    from annotate.sheets import save_sheet
    from dataset.overlay import dataset_sheet

    save_sheet(dataset_sheet(dataset, count=12, columns=3, masks=False), folder / "contact_sheet.png")
    _say(f"look at {folder / 'contact_sheet.png'}; the dataset is {dataset / 'annotations.json'}")
    return DONE


def _make_room(path: Path) -> None:
    """Make the folder of a file that shall be written, before the long work, or refuse."""
    if path.is_dir():
        raise HulldownError("is a folder", path=path, remedy="name a file in it")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise HulldownError(
            f"cannot be written ({error.strerror})", path=path, remedy="choose a folder that you may write to"
        ) from None


def _make_room_for_picture(path: Path) -> None:
    """As `_make_room`, and refuse to replace what is no picture of ours."""
    from annotate.sheets import refuse_foreign

    _make_room(path)
    refuse_foreign(path)


def _picture_of(plan: Path, what: str) -> Path:
    """The name of a picture of a plan, which says whose it is and of what."""
    return plan.with_name(f"{plan.name}.{what}.png")


def _list(lines: Sequence[str]) -> None:
    """On stdout, a line each however narrow the terminal."""
    for line in lines:
        STDOUT.print(escape(line), soft_wrap=True)


def _say(line: str) -> None:
    STDERR.print(escape(line), soft_wrap=True)


def _warn(line: str) -> None:
    STDERR.print(f"[yellow]warning:[/] {escape(line)}", soft_wrap=True)


def _print_json(value: Any) -> None:
    sys.stdout.write(json.dumps(value, indent=2, default=str) + "\n")
    sys.stdout.flush()


@contextmanager
def _reading() -> Iterator[Callable[[str], None]]:
    """A sign of life on stderr; yields what is to be called with the path that is read."""
    with STDERR.status("reading assets") as status:
        yield lambda path: status.update(f"reading {escape(path)}")


@contextmanager
def _progress(title: str) -> Iterator[Callable[[int, int], None]]:
    """A bar on stderr; yields what is to be called with the steps done and their total."""
    columns = (
        TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), TimeRemainingColumn(),
    )  # fmt: skip
    bar = Progress(*columns, console=STDERR)
    task = bar.add_task(title, total=None)

    def advance(done: int, total: int) -> None:
        bar.start()
        bar.update(task, completed=done, total=total)

    try:
        yield advance
    finally:
        # A bar that never started has nothing to say: a mistake stays one line.
        if bar.live.is_started:
            bar.stop()


@contextmanager
def _stages() -> Iterator[Callable[[str, int, int], None]]:
    """Bars on stderr, one after the other; yields what is to be called with a title, the steps done, their total."""
    with ExitStack() as bars:
        advance: dict[str, Callable[[int, int], None]] = {}

        def show(title: str, done: int, total: int) -> None:
            if title not in advance:
                bars.close()
                advance[title] = bars.enter_context(_progress(title))
            advance[title](done, total)

        yield show


def _picture(text: str) -> Path:
    if Path(text).suffix.lower() != ".png":
        raise argparse.ArgumentTypeError(f"expected the name of a .png file, got {text!r}")
    return Path(text)


def _read_limits(arguments: argparse.Namespace) -> Any:
    from reading.watch import GIB, ReadLimits

    memory = arguments.read_memory
    return ReadLimits(
        silence_s=arguments.read_timeout or ReadLimits().silence_s,
        memory_bytes=None if memory is None else round(memory * GIB),
    )


def _add_read_limits(sub: argparse.ArgumentParser) -> None:
    sub.add_argument(
        "--read-timeout", type=_positive, metavar="SECONDS",
        help="give an asset up that has got nowhere for so long (default: 900)",
    )  # fmt: skip
    sub.add_argument(
        "--read-memory", type=_positive, metavar="GIB",
        help="give an asset up that takes more memory (default: its share of nine tenths of the machine's)",
    )  # fmt: skip


def _positive(text: str) -> float:
    try:
        number = float(text)
    except ValueError:
        number = 0.0
    if not 0.0 < number < math.inf:
        raise argparse.ArgumentTypeError(f"expected a number above 0, got {text!r}")
    return number


def _shares(text: str) -> tuple[float, ...]:
    try:
        shares = tuple(float(word) for word in text.split(","))
    except ValueError:
        shares = ()
    # What is no number fails each comparison.
    if len(shares) != 3 or not all(share >= 0 for share in shares) or not abs(sum(shares) - 1.0) <= 1e-6:
        raise argparse.ArgumentTypeError(f"expected three shares that add up to 1, such as 0.7,0.2,0.1, got {text!r}")
    return shares


def _fractions(text: str) -> tuple[float, ...]:
    try:
        return tuple(float(word) for word in text.split(","))
    except ValueError:
        raise argparse.ArgumentTypeError(f"expected shares such as 1,0.5,0.25, got {text!r}") from None


def _named(text: str) -> tuple[str, Path]:
    name, equals, folder = text.partition("=")
    if not (name and equals and folder):
        raise argparse.ArgumentTypeError(f"expected NAME=DIR, such as real=photographs, got {text!r}")
    return name, Path(folder)


def _threshold(text: str) -> float | str:
    return text if text == "best" else _fraction(text)


def _fraction(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = -1.0
    if not 0.0 <= value <= 1.0:
        raise argparse.ArgumentTypeError(f"expected a number from 0 to 1, got {text!r}")
    return value


def _overlap(text: str) -> float:
    if (value := _fraction(text)) == 0.0:
        raise argparse.ArgumentTypeError("expected an overlap above 0, got 0")
    return value


def _share(text: str) -> tuple[int, int]:
    words = text.split("/")
    if len(words) == 2 and all(word.isdecimal() for word in words) and 1 <= int(words[0]) <= int(words[1]):
        return int(words[0]), int(words[1])
    raise argparse.ArgumentTypeError(f"expected K/N with K from 1 to N, such as 3/8, got {text!r}")


def _at_least_one(text: str) -> int:
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"expected a whole number of at least 1, got {text!r}")
    return int(text)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="hulldown", description="Plan, render and annotate synthetic detection datasets of vehicles on terrain."
    )
    verbs = parser.add_subparsers(required=True, metavar="VERB")

    def verb(name: str, run: Callable[[argparse.Namespace], int], does: str, more: str) -> argparse.ArgumentParser:
        sub = verbs.add_parser(name, help=does, description=f"{does[0].upper()}{does[1:]}. {more}")
        sub.set_defaults(run=run)
        if name not in ("init", "preview", "augment", "demo"):
            sub.add_argument("--json", action="store_true", help="machine-readable result on stdout")
        return sub

    def cache(sub: argparse.ArgumentParser, where: str) -> None:
        sub.add_argument(
            "--cache", type=Path, metavar="DIR", help=f"folder of what is read of assets (default: {where})"
        )

    def allow_links(sub: argparse.ArgumentParser) -> None:
        sub.add_argument(
            "--allow-links", type=Path, metavar="DIR", action="append", default=[],
            help="folder that pictures which are links may lead to, besides their dataset; may be repeated",
        )  # fmt: skip

    sub = verb(
        "init", _init, "start a project", "Writes hulldown.toml, commented, and demo vehicles, sceneries, HDRIs."
    )
    sub.add_argument("folder", type=Path, metavar="DIR", help="folder to write; what is there already is kept")
    sub.add_argument("--seed", type=int, default=0, help="of the demo assets (default: 0)")
    sub.add_argument("--small", action="store_true", help="a config for 12 small images in place of a whole dataset")

    sub = verb(
        "inspect", _inspect, "show what will be used of asset files",
        "Reads .blend, .glb, .gltf, .fbx or .obj files, or configs and what they list, with their options; writes a "
        "table of each, and with -o a picture from four sides.",
    )  # fmt: skip
    sub.add_argument("files", type=Path, nargs="+", metavar="FILE", help="an asset, or a config (.toml)")
    sub.add_argument(
        "--as", dest="kind", choices=("vehicle", "scenery"),
        help="default: judged by what is in the file; a config says it itself",
    )  # fmt: skip
    sub.add_argument("-o", "--output", type=_picture, metavar="PNG", help="shaded picture of all, parts in colours")
    sub.add_argument("--strict", action="store_true", help="refuse files with missing textures or libraries")
    _add_read_limits(sub)

    sub = verb(
        "plan", _plan, "plan every pose of a dataset",
        "Reads a config and its assets; writes PLAN, one line an image, and a picture of its statistics beside it.",
    )  # fmt: skip
    sub.add_argument("config", type=Path, metavar="CONFIG", help="the config; with --check a plan")
    sub.add_argument("-o", "--output", type=Path, metavar="PLAN", help="the plan to write, such as plan.jsonl")
    sub.add_argument("--check", action="store_true", help="the same as `hulldown check`")
    sub.add_argument(
        "--workers", type=_at_least_one, default=os.cpu_count() or 1, help="processes (default: all cores)"
    )
    sub.add_argument("--strict", action="store_true", help="refuse assets with missing textures or libraries")
    cache(sub, "the config's; with --check .hulldown-cache beside the plan")
    _add_read_limits(sub)

    sub = verb(
        "check", _check, "recompute every limit of a plan",
        "Reads a plan and the assets it names; prints a line for each limit of the plan's own config that is broken.",
    )  # fmt: skip
    sub.add_argument("plan", type=Path, metavar="PLAN")
    _add_read_limits(sub)
    cache(sub, ".hulldown-cache beside the plan")

    sub = verb("preview", _preview, "shade a plan without Blender", "Reads a plan; writes a contact sheet with boxes.")
    sub.add_argument("plan", type=Path, metavar="PLAN")
    sub.add_argument("-o", "--output", type=_picture, metavar="PNG", help="default: PLAN.preview.png, beside the plan")
    sub.add_argument("--count", type=_at_least_one, default=24, help="images, evenly from the plan (default: 24)")
    _add_read_limits(sub)
    cache(sub, ".hulldown-cache beside the plan")

    sub = verb(
        "render", _render, "render a plan with Blender Cycles",
        "Reads a plan and the assets it names; writes images, annotations.json and a journal. Resumes by itself.",
    )  # fmt: skip
    sub.add_argument("plan", type=Path, metavar="PLAN")
    sub.add_argument("-o", "--output", type=Path, metavar="DATASET", required=True, help="added to if it is there")
    sub.add_argument("--workers", type=_at_least_one, help="processes (default: one a GPU, or one)")
    sub.add_argument(
        "--device",
        default="auto",
        choices=("auto", "cpu", "gpu", "optix", "cuda", "hip", "oneapi", "metal"),
        help="default: auto, a GPU if there is one",
    )
    sub.add_argument("--limit", type=_at_least_one, metavar="N", help="only the first N images of the plan")
    sub.add_argument(
        "--share", type=_share, default=(1, 1), metavar="K/N",
        help="of these the K-th of N equal shares, for N machines; then `hulldown join`",
    )  # fmt: skip
    sub.add_argument("--blender", metavar="PATH", help="an installed Blender to use in place of the bpy module")
    sub.add_argument(
        "--image-timeout", type=_positive, metavar="SECONDS",
        help="give a picture up after so long (default: 20 times as long as the longest of the first five took)",
    )  # fmt: skip
    _add_read_limits(sub)
    cache(sub, ".hulldown-cache beside the plan")

    sub = verb(
        "join", _join, "put parts of a dataset together",
        "Reads datasets, such as the shares of a plan that several machines have rendered; appends to DATASET what it "
        "does not have, pictures as hard links where the disk allows. Join again when there are more images.",
    )  # fmt: skip
    sub.add_argument("parts", type=Path, nargs="+", metavar="PART", help="a dataset; it stays as it is")
    sub.add_argument("-o", "--output", type=Path, metavar="DATASET", required=True, help="made if it is not there")
    allow_links(sub)

    sub = verb(
        "verify", _verify, "check a dataset",
        "Reads a dataset; prints what is wrong with records, images and boxes. Exit code 1 if something is.",
    )  # fmt: skip
    sub.add_argument("dataset", type=Path, metavar="DATASET")
    sub.add_argument("--plan", type=Path, metavar="PLAN", help="a plan it was rendered from, to compare row by row")
    sub.add_argument("--fast", action="store_true", help="open no picture, compare no hash")
    sub.add_argument("--masks", type=_at_least_one, metavar="N", help="render N masks and compare (needs --plan)")
    cache(sub, ".hulldown-cache beside the plan")

    sub = verb(
        "export", _export, "split a dataset for training",
        "Reads a dataset; writes train, valid and test; shots of one position stay together.",
    )  # fmt: skip
    sub.add_argument("dataset", type=Path, metavar="DATASET")
    sub.add_argument("-o", "--output", type=Path, metavar="DIR", required=True, help="a new or an empty folder")
    sub.add_argument("--format", choices=("coco", "yolo"), default="coco", help="default: coco")
    sub.add_argument(
        "--split", type=_shares, default=(0.7, 0.2, 0.1), metavar="A,B,C",
        help="shares of train, valid and test (default: 0.7,0.2,0.1)",
    )  # fmt: skip
    allow_links(sub)

    sub = verb(
        "subset", _subset, "make nested smaller datasets of one",
        "Reads a dataset; writes OUT/100, OUT/50 and so on, each within the larger ones, pictures as hard links.",
    )  # fmt: skip
    sub.add_argument("dataset", type=Path, metavar="DATASET")
    sub.add_argument("-o", "--output", type=Path, metavar="OUT", required=True, help="a new or an empty folder")
    sub.add_argument(
        "--fractions", type=_fractions, default=(1.0, 0.5, 0.25, 0.1, 0.05), metavar="A,B,...",
        help="shares of the images (default: 1,0.5,0.25,0.1,0.05)",
    )  # fmt: skip
    sub.add_argument("--seed", type=int, default=0, help="another seed, other subsets (default: 0)")
    sub.add_argument("--stratified", action="store_true", help="keep the proportion of classes in each")

    sub = verb(
        "augment", _augment, "show what augmentation makes of a dataset's pictures",
        "Reads a dataset; writes a sheet: in each row a picture as it is and eight times augmented, with its boxes.",
    )  # fmt: skip
    sub.add_argument("dataset", type=Path, metavar="DATASET")
    sub.add_argument("-o", "--output", type=_picture, metavar="PNG", required=True)
    sub.add_argument("--seed", type=int, default=0, help="another seed, other augmentations (default: 0)")
    sub.add_argument("--rows", type=_at_least_one, default=6, help="pictures, evenly from the dataset (default: 6)")
    sub.add_argument("--config", type=Path, metavar="TOML", help="of a training; its [augmentation] is used")

    sub = verb(
        "train", _train, "train a detector under a fixed budget",
        "Reads datasets; writes RUN with weights, metrics, config and draws. What is left out here stands in the "
        "config, or is what suits the model. The same command goes on with a run that was stopped.",
    )  # fmt: skip
    sub.add_argument(
        "--data", type=_named, action="append", required=True, metavar="NAME=DIR",
        help="a dataset to draw pictures from, such as real=photographs; once for each",
    )  # fmt: skip
    sub.add_argument("-o", "--output", type=Path, metavar="RUN", required=True, help="the run's folder")
    sub.add_argument("--valid", type=Path, metavar="DIR", help="a dataset to measure the result on; it decides nothing")
    sub.add_argument("--config", type=Path, metavar="TOML", help="keys: see docs/training.md")
    sub.add_argument("--model", help="small, for a CPU; or nano, rf-small, medium, large of RF-DETR (default: medium)")
    sub.add_argument("--budget", type=_at_least_one, help="pictures drawn, with replacement (default: 25000)")
    sub.add_argument("--seed", type=int, help="of draws, augmentation and weights (default: 0)")
    sub.add_argument("--resolution", type=_at_least_one, help="pixels that the model sees (default: the model's)")
    sub.add_argument("--weights", metavar="FILE", help="to start from, or none (default: RF-DETR's pre-trained ones)")
    sub.add_argument("--device", default="auto", choices=("auto", "cpu", "gpu"), help="default: auto, GPUs if any")
    sub.add_argument("--workers", type=int, help="processes that augment pictures (default: the cores but one)")

    sub = verb(
        "predict", _predict, "detect in every image of a dataset",
        "Reads a run, or a checkpoint of RF-DETR, and a dataset; writes COCO results. The same command goes on with "
        "what was stopped.",
    )  # fmt: skip
    sub.add_argument("detector", type=Path, metavar="RUN", help="folder of a finished training, or a checkpoint")
    sub.add_argument("dataset", type=Path, metavar="DATASET", help="a folder, or a COCO file beside its pictures")
    sub.add_argument("-o", "--output", type=Path, metavar="PREDICTIONS", required=True, help="a .json file")
    sub.add_argument(
        "--device", default="auto", help="a name that PyTorch knows (default: auto, a GPU if there is one)"
    )
    sub.add_argument("--batch", type=_at_least_one, default=8, help="images at once (default: 8)")

    sub = verb(
        "evaluate", _evaluate, "judge detections: what, where, why, how sure",
        "Reads a dataset and COCO results of any detector; writes report.html, report.json, metrics.csv and sheets of "
        "misses and false alarms. Several files of results are compared with the first.",
    )  # fmt: skip
    sub.add_argument("dataset", type=Path, metavar="DATASET", help="a folder, or a COCO file beside its pictures")
    sub.add_argument("predictions", type=Path, nargs="+", metavar="PREDICTIONS", help="a file of COCO results")
    sub.add_argument("-o", "--output", type=Path, metavar="DIR", required=True, help="folder of the report")
    choice = sub.add_mutually_exclusive_group()
    choice.add_argument(
        "--threshold", type=_threshold, default=0.5, metavar="T",
        help="confidence from which detections count (default: 0.5); best: of the best F1 on DATASET, which flatters",
    )  # fmt: skip
    choice.add_argument(
        "--validation", type=Path, nargs="+", metavar="FILE",
        help="another dataset and the detections in it, of each detector: the threshold is that of the best F1 there",
    )  # fmt: skip
    sub.add_argument("--iou", type=_overlap, default=0.5, metavar="T", help="overlap of a find (default: 0.5)")

    verb("doctor", _doctor, "say what this machine can do", "Reads nothing, writes nothing.")

    sub = verb("demo", _demo, "everything, small", "Writes a project, a plan, a dataset of 12 images, a contact sheet.")
    sub.add_argument(
        "-o", "--output", type=Path, default=Path("hulldown-demo"), metavar="DIR", help="default: hulldown-demo"
    )
    return parser


if __name__ == "__main__":
    sys.exit(main())
