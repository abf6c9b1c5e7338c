"""The verbs up to a plan: init, inspect, plan, check, preview."""

from __future__ import annotations

import argparse
import os
import shutil
from collections.abc import Mapping
from pathlib import Path

from hulldown.base.errors import AssetError, HulldownError
from hulldown.base.files import make_room
from hulldown.base.terminal import reading_status, say, warn
from hulldown.verbs.arguments import (
    Subparsers,
    add_cache,
    add_planned,
    add_read_limits,
    add_verb,
    at_least_one,
    picture_name,
    planned_library,
    read_limits,
)
from hulldown.verbs.output import DONE, FOUND, MISTAKE, show, show_result


def _init(arguments: argparse.Namespace) -> None:
    from hulldown.demo.project import AERIAL, create_project, write_config
    from hulldown.planning.config.template import bare_text
    from hulldown.planning.inputs.camera_file import read_camera

    values: dict[str, object] = dict(AERIAL) if arguments.aerial else {}
    if arguments.camera:
        values |= read_camera(arguments.camera)
    if arguments.source:
        return _init_from(arguments, values)
    make_room(arguments.folder / "hulldown.toml")
    if arguments.bare:
        config = write_config(arguments.folder, bare_text(values))
        say(f"wrote {config}; next: name your files in it, and hulldown inspect it")
        return
    config = create_project(arguments.folder, seed=arguments.seed, small=arguments.small, values=values)
    say(f"wrote {config}; next: hulldown plan {config} -o plan.jsonl")


def _init_from(arguments: argparse.Namespace, values: Mapping[str, object]) -> None:
    from hulldown.demo.project import CONFIG, refuse_config, write_config
    from hulldown.planning.config.asset_sections import CACHE_NAME
    from hulldown.planning.inputs.found_assets import asset_files, found_config, keep_doubts, missing_kinds, read_found

    refuse_config(arguments.folder / CONFIG)
    files = asset_files(arguments.source)
    cache, new = arguments.folder / CACHE_NAME, not arguments.folder.exists()
    try:
        found = read_found(arguments.source, files, cache, limits=read_limits(arguments))
    except AssetError:
        if new and cache.is_dir():
            shutil.rmtree(cache)
            arguments.folder.rmdir()
        raise
    make_room(arguments.folder / CONFIG)
    config = write_config(arguments.folder, found_config(arguments.source, found, arguments.folder, values))
    keep_doubts(found, arguments.source, config, cache)
    for word in missing_kinds(found):
        warn(f"no {word} was found in {arguments.source}; name one in {config}")
    used = len({file.path for file in found if file.kind})
    say(f"wrote {config} with {used} of {len(files)} files; next: look at its comments, and hulldown inspect {config}")


def _inspect(arguments: argparse.Namespace) -> int:
    from hulldown.pictures.own_files import make_room_for_picture
    from hulldown.planning.inputs.inspection import drawn_assets, inspect_file
    from hulldown.reading.inspect import Inspected, pages, write_pictures

    output, drawn = arguments.output, sum(map(drawn_assets, arguments.files))
    for page in pages(output, drawn) if output else ():
        make_room_for_picture(page)
    limits = read_limits(arguments)
    inspected: list[Inspected] = []
    refused = 0
    for path in arguments.files:
        try:
            with reading_status() as progress:
                new = inspect_file(
                    path, kind=arguments.kind, strict=arguments.strict, pictures=bool(output), progress=progress,
                    limits=limits,
                )  # fmt: skip
        except AssetError as error:
            if len(arguments.files) == 1:
                raise
            warn(str(error))
            refused += 1
            continue
        inspected += new
        for report in (one.report for one in new if not arguments.json):
            show(report.table(), *report.lines())
    if output and any(one.picture for one in inspected):
        say(f"wrote {', '.join(map(str, write_pictures(inspected, output)))}")
    show_result(arguments, [one.report for one in inspected])
    return MISTAKE if refused else DONE


def _plan(arguments: argparse.Namespace) -> int:
    from hulldown.planning.plan.lines import picture_of
    from hulldown.planning.write import plan

    if arguments.check:
        arguments.plan = arguments.config
        return _check(arguments)
    output = arguments.output
    if output is None:
        raise HulldownError("-o is missing", remedy="name the file to write, such as -o plan.jsonl")
    made = plan(
        arguments.config, output, workers=arguments.workers, strict=arguments.strict,
        poses=arguments.poses, cache=arguments.cache, limits=read_limits(arguments),
    )  # fmt: skip
    summary = made.summary
    show_result(arguments, summary.to_json(), *summary.tables(), *summary.notes())
    say(f"wrote {output} ({len(made)} images) and {picture_of(output, 'summary')}; next: hulldown preview {output}")
    return DONE


def _check(arguments: argparse.Namespace) -> int:
    from hulldown.planning.check import check_plan
    from hulldown.planning.plan_file import read_plan

    plan = read_plan(arguments.plan)
    findings = check_plan(plan, planned_library(plan, arguments).assets)
    show_result(arguments, findings, *findings)
    say(f"{len(plan)} images checked, {len(findings)} findings")
    return FOUND if findings else DONE


def _preview(arguments: argparse.Namespace) -> None:
    from hulldown.pictures.own_files import make_room_for_picture
    from hulldown.planning.pictures.preview import preview_sheet
    from hulldown.planning.plan.lines import picture_of
    from hulldown.planning.plan_file import read_plan

    plan = read_plan(arguments.plan)
    output = arguments.output or picture_of(arguments.plan, "preview")
    make_room_for_picture(output)
    preview_sheet(plan, planned_library(plan, arguments).assets, output, count=arguments.count)
    say(f"wrote {output}")


def _passes(arguments: argparse.Namespace) -> None:
    from hulldown.planning.pictures.passes import PASSES, write_passes
    from hulldown.planning.plan_file import read_plan

    plan = read_plan(arguments.plan)
    assets = planned_library(plan, arguments).assets
    passes = [name for name in PASSES if getattr(arguments, name)] or PASSES
    written = write_passes(plan, assets, arguments.output, passes=passes, count=arguments.count)
    show_result(arguments, dict.fromkeys(passes, written))
    say(f"wrote {', '.join(passes)} of {written} images into {arguments.output}")


def add(verbs: Subparsers) -> None:
    """Add these verbs to the command."""
    sub = add_verb(
        verbs, "init", _init, "start a project",
        "Writes hulldown.toml, commented, and demo vehicles, sceneries, HDRIs; or a config of your own files.",
        resumes=True, json=False,
    )  # fmt: skip
    sub.add_argument("folder", type=Path, metavar="DIR", help="folder to write; existing files are kept")
    sub.add_argument("--seed", type=int, default=0, help="seed of the demo assets (default: 0)")
    one_of = sub.add_mutually_exclusive_group()
    one_of.add_argument("--bare", action="store_true", help="only the config, for your own files; no demo assets")
    one_of.add_argument("--small", action="store_true", help="a config for 12 small images instead of a whole dataset")
    one_of.add_argument(
        "--from", dest="source", type=Path, metavar="FOLDER",
        help="only the config, with the vehicles, sceneries, and HDRIs in this folder",
    )  # fmt: skip
    sub.add_argument(
        "--aerial", action="store_true", help="cameras of a drone: 45 degrees down to straight down, at 30 to 300 m"
    )
    sub.add_argument(
        "--camera", type=Path, metavar="FILE",
        help="a camera's calibration by OpenCV or ROS (.yaml, .yml, .json) for the config",
    )  # fmt: skip
    add_read_limits(sub)

    sub = add_verb(
        verbs, "inspect", _inspect, "show how asset files are read",
        "Reads .blend, .glb, .gltf, .fbx, .obj, .tif, .exr or .hdr files, or configs and what they list, with their "
        "options; writes a table of each, and with -o a picture of vehicles and sceneries from four sides.",
    )  # fmt: skip
    sub.add_argument("files", type=Path, nargs="+", metavar="FILE", help="an asset, or a config (.toml)")
    sub.add_argument(
        "--as", dest="kind", choices=("vehicle", "scenery"),
        help="default: by the file's contents; a config's entries have their own kind",
    )  # fmt: skip
    sub.add_argument(
        "-o", "--output", type=picture_name, metavar="PNG", help="shaded picture, parts in colors; 12 a page"
    )
    sub.add_argument("--strict", action="store_true", help="refuse files with missing textures or libraries")
    add_read_limits(sub)

    sub = add_verb(
        verbs, "plan", _plan, "plan every pose of a dataset",
        "Reads a config and its assets; writes PLAN, one line an image, and a picture of its statistics next to it.",
        resumes=True,
    )  # fmt: skip
    sub.add_argument("config", type=Path, metavar="CONFIG", help="the config; with --check a plan")
    sub.add_argument("-o", "--output", type=Path, metavar="PLAN", help="file of the plan, such as plan.jsonl")
    sub.add_argument("--check", action="store_true", help="the same as `hulldown check`")
    sub.add_argument("--workers", type=at_least_one, default=os.cpu_count() or 1, help="processes (default: all cores)")
    sub.add_argument(
        "--strict",
        action="store_true",
        help="refuse missing textures and libraries, and vehicles without a place on a scenery",
    )
    sub.add_argument(
        "--poses", type=Path, metavar="POSES.csv",
        help="a line for each image: scenery, vehicle, place, camera; empty cells are planned",
    )  # fmt: skip
    add_cache(sub, "the config's; with --check .hulldown-cache next to the plan")
    add_read_limits(sub)

    sub = add_verb(
        verbs, "check", _check, "compare a plan with its config",
        "Reads a plan and the assets it names; plans again, and prints a line for each field that differs.",
    )  # fmt: skip
    sub.add_argument("plan", type=Path, metavar="PLAN")
    add_planned(sub)

    sub = add_verb(
        verbs,
        "preview",
        _preview,
        "shade a plan without Blender",
        "Reads a plan; writes a contact sheet with boxes.",
        json=False,
    )
    sub.add_argument("plan", type=Path, metavar="PLAN")
    sub.add_argument(
        "-o", "--output", type=picture_name, metavar="PNG", help="default: PLAN.preview.png, next to the plan"
    )
    sub.add_argument("--count", type=at_least_one, default=24, help="number of images, an even selection (default: 24)")
    add_planned(sub)

    sub = add_verb(
        verbs, "passes", _passes, "depth, normals, instances, and more of a plan's images",
        "Reads a plan and its assets; writes arrays and pictures of each image, and COCO panoptic; without Blender.",
        resumes=True,
    )  # fmt: skip
    sub.add_argument("plan", type=Path, metavar="PLAN")
    sub.add_argument("-o", "--output", type=Path, metavar="DIR", required=True, help="folder to write")
    for name, what in {
        "depth": "float32 meters along the optical axis and along the ray",
        "normal": "float32 normals in the world",
        "instance": "16-bit numbers of vehicles, ground, and obstacles",
        "part": "16-bit numbers of vehicles' parts",
        "category": "COCO panoptic: classes and instances",
    }.items():
        sub.add_argument(f"--{name}", action="store_true", help=f"{what} (default: all passes)")
    sub.add_argument("--count", type=at_least_one, help="number of images, an even selection (default: all)")
    add_planned(sub)
