"""The verbs from a plan to a dataset: render, join, verify, export."""

from __future__ import annotations

import argparse
from collections.abc import Iterable
from functools import cache, partial
from pathlib import Path

from hulldown.base.errors import HulldownError
from hulldown.base.terminal import say, warn
from hulldown.verbs.arguments import (
    Choices,
    Subparsers,
    add_allow_links,
    add_planned,
    add_verb,
    at_least_one,
    at_least_zero,
    fraction,
    one_of_shares,
    page_name,
    planned_library,
    positive,
    three_shares,
)
from hulldown.verbs.cluster import add_scheduler, scheduler_of
from hulldown.verbs.output import DONE, FOUND, STOPPED, show, show_result


def _render(arguments: argparse.Namespace) -> int:
    from hulldown.rendering.pool import Engine
    from hulldown.rendering.process import Limits
    from hulldown.rendering.supervisor import Part, render_bar, render_plan

    alone = next((name for name in ("workers", "blender") if getattr(arguments, name) is not None), None)
    if alone and arguments.scheduler is not None:
        raise HulldownError(f"--{alone} is for this machine; with --scheduler, the cluster's workers have their own")
    engine = Engine(
        workers=arguments.workers,
        device=arguments.device,
        blender=arguments.blender,
        scheduler=scheduler_of(arguments),
        require_confinement=arguments.require_confinement,
        limits=Limits(job_s=arguments.image_timeout),
    )
    library, part = planned_library(arguments.plan, arguments), Part(limit=arguments.limit, share=arguments.share)
    with render_bar() as advance:
        report = render_plan(arguments.plan, arguments.output, library, engine=engine, part=part, progress=advance)
    show_result(arguments, report)
    say(
        f"{report.rendered} images rendered, {report.already} were there, {len(report.failed)} failed "
        f"in {report.seconds:.0f} s; next: hulldown verify {arguments.output}"
    )
    if report.failed:
        warn(f"reasons are in {arguments.output / 'failures.jsonl'}")
    if report.interrupted:
        say("stopped; the same command goes on from here")
        return STOPPED
    return DONE if report.complete else FOUND


def _join(arguments: argparse.Namespace) -> None:
    from hulldown.dataset.join import join

    joined = join(arguments.parts, arguments.output, allow_links=arguments.allow_links)
    show_result(arguments, joined)
    say(f"{joined.added} images added, {joined.already} were there; next: hulldown verify {arguments.output}")
    if joined.missing:
        warn(
            f"{joined.missing} planned images are not there yet, {joined.failed} of them given up; "
            "join again when there are more"
        )


def _verify(arguments: argparse.Namespace) -> int:
    from hulldown.dataset.records import listed
    from hulldown.dataset.verification.verify import verify

    if arguments.masks and not arguments.plan:
        raise HulldownError("--masks needs --plan, whose poses are rendered again")
    library = cache(partial(planned_library, arguments.plan, arguments))
    findings = verify(arguments.dataset, arguments.plan, fast=arguments.fast, assets=library)
    checked = 0
    if arguments.masks:
        from hulldown.rendering.cycles_masks import verify_masks

        measured = verify_masks(arguments.dataset, arguments.plan, library(), count=arguments.masks)
        checked = len(measured.rows)
        findings += measured.findings
        if not arguments.json:
            show(measured.table())
    show_result(arguments, findings, *listed(findings))
    errors = sum(finding.severity == "error" for finding in findings)
    masks = f", {checked} masks rendered" if arguments.masks else ""
    say(f"{arguments.dataset}: {errors} errors, {len(findings) - errors} warnings{masks}")
    return FOUND if errors else DONE


def _layouts() -> Iterable[str]:
    from hulldown.dataset.exports.export import LAYOUTS

    return LAYOUTS


def _export(arguments: argparse.Namespace) -> None:
    from hulldown.dataset.exports.export import export
    from hulldown.dataset.usable_labels import LabelFloors

    floors = LabelFloors(
        min_box_px=arguments.min_box_px,
        min_visible_fraction=arguments.min_visible_fraction,
        max_truncated_fraction=arguments.max_truncated_fraction,
        below=arguments.below,
    )
    counts = export(
        arguments.dataset, arguments.output, layout=arguments.format, fractions=arguments.split,
        polygons_within=arguments.polygons, floors=floors, clip=arguments.clip, allow_links=arguments.allow_links,
    )  # fmt: skip
    show_result(arguments, counts)
    say(f"wrote {arguments.output}: " + ", ".join(f"{n} {name}" for name, n in counts.items()))


def _report(arguments: argparse.Namespace) -> None:
    from hulldown.dataset.reports.dataset_report import report

    comparison = report(
        arguments.source, arguments.output, photographs=arguments.photographs, most=arguments.images,
        library=None if arguments.source.is_dir() else planned_library(arguments.source, arguments),
    )  # fmt: skip
    if comparison:
        lines = (f"{distance}  {title} ({keys})" for title, distance, keys in comparison.rows())
        show_result(arguments, comparison, *lines)
    say(f"wrote {arguments.output}")


def add(verbs: Subparsers) -> None:
    """Add these verbs to the command."""
    sub = add_verb(
        verbs, "render", _render, "render a plan with Blender Cycles",
        "Reads a plan and the assets it names; writes images, annotations.json and a journal. Resumes by itself.",
        resumes=True,
    )  # fmt: skip
    sub.add_argument("plan", type=Path, metavar="PLAN")
    sub.add_argument("-o", "--output", type=Path, metavar="DATASET", required=True, help="the dataset, which may exist")
    sub.add_argument("--workers", type=at_least_one, help="processes (default: one per GPU, or one)")
    sub.add_argument(
        "--device",
        default="auto",
        choices=("auto", "cpu", "gpu", "optix", "cuda", "hip", "oneapi", "metal"),
        help="default: auto, a GPU if there is one",
    )
    sub.add_argument("--limit", type=at_least_one, metavar="N", help="only the first N images of the plan")
    sub.add_argument(
        "--share", type=one_of_shares, default=(1, 1), metavar="K/N",
        help="of these the K-th of N equal shares, for N machines; then `hulldown join`",
    )  # fmt: skip
    add_scheduler(sub, "render on the workers of a Dask cluster: tcp://HOST:8786, or the file of its scheduler (.json)")
    sub.add_argument("--blender", metavar="PATH", help="an installed Blender instead of the bpy module")
    sub.add_argument(
        "--image-timeout", type=positive, metavar="SECONDS",
        help="time limit of a picture (default: 20 times the longest of the first five)",
    )  # fmt: skip
    add_planned(sub)

    sub = add_verb(
        verbs, "join", _join, "put parts of a dataset together",
        "Reads datasets, such as the shares of a plan from several machines; appends missing images to DATASET, "
        "pictures as hard links if the disk allows. Join again when there are more images.",
        resumes=True,
    )  # fmt: skip
    sub.add_argument("parts", type=Path, nargs="+", metavar="PART", help="a dataset, which isn't changed")
    sub.add_argument("-o", "--output", type=Path, metavar="DATASET", required=True, help="the target, made if missing")
    add_allow_links(sub)

    sub = add_verb(
        verbs, "verify", _verify, "check a dataset",
        "Reads a dataset; prints problems of records, images, and boxes. Exit code 1 if there are any.",
    )  # fmt: skip
    sub.add_argument("dataset", type=Path, metavar="DATASET")
    sub.add_argument("--plan", type=Path, metavar="PLAN", help="a plan it was rendered from, to compare row by row")
    sub.add_argument("--fast", action="store_true", help="don't open pictures or compare hashes")
    sub.add_argument("--masks", type=at_least_one, metavar="N", help="render N masks and compare (needs --plan)")
    add_planned(sub)

    sub = add_verb(
        verbs, "report", _report, "show a dataset or a plan as a page",
        "Reads a dataset's folder or a plan; writes one page with tables, charts, maps and thumbnails that filter.",
    )  # fmt: skip
    sub.add_argument("source", type=Path, metavar="DATASET|PLAN")
    sub.add_argument("-o", "--output", type=page_name, metavar="FILE.html", required=True)
    sub.add_argument(
        "--images", type=at_least_one, default=1000, metavar="N",
        help="most thumbnails, an even selection (default: 1000)",
    )  # fmt: skip
    sub.add_argument(
        "--beside", dest="photographs", type=Path, metavar="PHOTOGRAPHS",
        help="a COCO folder or file of photographs, whose boxes, brightness, and contrast are shown next to this one's",
    )  # fmt: skip
    add_planned(sub)

    sub = add_verb(
        verbs, "export", _export, "split a dataset for training",
        "Reads a dataset; writes train, valid and test; shots of one position stay together.",
    )  # fmt: skip
    sub.add_argument("dataset", type=Path, metavar="DATASET")
    sub.add_argument("-o", "--output", type=Path, metavar="DIR", required=True, help="a new or an empty folder")
    sub.add_argument(
        "--format", default="coco", metavar="FORMAT", choices=Choices(_layouts),
        help="%(choices)s (default: coco)",
    )  # fmt: skip
    sub.add_argument(
        "--polygons", type=at_least_zero, nargs="?", const=0.3, metavar="PIXELS",
        help="masks as polygons within this many pixels of the outline (default: 0.3)",
    )  # fmt: skip
    sub.add_argument(
        "--split", type=three_shares, default=(0.7, 0.2, 0.1), metavar="A,B,C",
        help="shares of train, valid and test (default: 0.7,0.2,0.1)",
    )  # fmt: skip
    sub.add_argument("--min-box-px", type=at_least_zero, default=0.0, metavar="PX", help="least side of a label's box")
    sub.add_argument("--min-visible-fraction", type=fraction, default=0.0, metavar="SHARE", help="least of a label")
    sub.add_argument("--max-truncated-fraction", type=fraction, default=1.0, metavar="SHARE", help="largest of a label")
    sub.add_argument(
        "--below", choices=("ignored", "left_out"), default="ignored",
        help="labels beyond these limits get iscrowd = 1, or are left out, as always in yolo (default: ignored)",
    )  # fmt: skip
    sub.add_argument("--clip", action="store_true", help="clip boxes that leave their image by more than a pixel too")
    add_allow_links(sub)
