"""Export a vehicle or scenery from an asset file, by a separate Blender process."""

from __future__ import annotations

import json
import os
import sys
import tempfile
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import partial
from pathlib import Path
from typing import NoReturn, TypedDict, TypeVar

from hulldown.base.errors import AssetError
from hulldown.base.outside import convert_parsed_value, read_json
from hulldown.reading.confinement.landlock import confine_command, readable_asset_folders
from hulldown.reading.confinement.references import refuse_odd_references
from hulldown.reading.confinement.watch import DEFAULT_LIMITS, ReadLimits, run_limited_command
from hulldown.reading.libraries import remedy_for_blender_output
from hulldown.reading.pieces.asset_report import FileReport
from hulldown.reading.pieces.formats import file_format
from hulldown.reading.pieces.options import DEFAULT_OPTIONS, Options

ANSWER_NAME = "answer.json"
PICTURE_NAME = "picture.png"
DIFFERENCES_NAME = "differences.png"
Found = TypeVar("Found")


@dataclass(frozen=True, slots=True)
class Job:
    """A job for the reading process."""

    path: str  # the file, as the user names it
    # exists; everything is written into it: bundle and tidy twin of an asset, the map of an HDRI, the answer
    folder: str
    format: str  # "blend", "gltf", "fbx", "obj", "geotiff", or "hdri"
    kind: str | None = None  # kind, options: as for `export_asset`
    options: Options = field(default_factory=Options)

    def file(self, name: str) -> Path:
        """Return a file in the folder."""
        return Path(self.folder, name)


@dataclass(frozen=True, slots=True)
class FoundAsset:
    """The reading process's answer about an asset: the report, and absolute paths of all files it refers to."""

    report: FileReport
    files: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Exported:
    """The files and the report of an export."""

    report: FileReport  # the report about the file
    bundle: Path  # the geometry, for `assets.bundle.load_vehicle` or `load_scenery`
    tidy: Path  # a .blend with only the rendered objects; see `reading.blender.tidy`
    picture: Path | None  # of a vehicle, see `reading.blender.vehicle_picture`; None for a scenery
    differences: Path | None  # a picture of what was lost, see `reading.blender.file_pictures`; None if nothing was
    files: tuple[str, ...]  # absolute path of every file that the asset refers to: textures, libraries
    # SHA-256 of each, from a cache; None if it can't be read
    hashes: Mapping[str, str | None] = field(default_factory=dict)


def export_asset(
    path: Path | str,
    folder: Path | str,
    *,
    kind: str | None = None,
    options: Options = DEFAULT_OPTIONS,
    limits: ReadLimits = DEFAULT_LIMITS,
) -> Exported:
    """Read `path` once as its kind (None: judged by contents), and write bundle and tidy twin into `folder`."""
    job = reader_job(Path(path), Path(folder), kind=kind, options=options)
    run_reader_jobs([job], limits=limits)
    return finished_export(job)


def reader_job(path: Path, folder: Path, *, kind: str | None, options: Options = DEFAULT_OPTIONS) -> Job:
    """Return the reader's job; arguments as for `export_asset`."""
    kind_of_file = file_format(path)
    refuse_odd_references(path, kind_of_file)
    if kind_of_file == "geotiff":
        kind = kind or "scenery"
    return Job(str(path), str(folder.resolve()), kind_of_file, kind, options)


def finished_export(job: Job) -> Exported:
    """Return the export of a finished job."""
    found = read_job_answer(job, FoundAsset)
    return exported_in_folder(Path(job.folder), found.report, found.files)


def exported_in_folder(folder: Path, report: FileReport, files: Iterable[str]) -> Exported:
    """Return the export whose files are in a folder."""
    picture = folder / PICTURE_NAME if report.kind == "vehicle" else None
    differences = folder / DIFFERENCES_NAME if (folder / DIFFERENCES_NAME).is_file() else None
    return Exported(report, folder / "bundle.npz", folder / "tidy.blend", picture, differences, tuple(files))


def run_reader_jobs(jobs: Sequence[Job], *, limits: ReadLimits = DEFAULT_LIMITS) -> None:
    """Run jobs one after the other in one confined and watched process; `read_job_answer` has their answers."""
    readable = [folder for job in jobs for folder in readable_asset_folders(Path(job.path))]
    with tempfile.TemporaryDirectory(prefix="tmp-", dir=jobs[0].folder, ignore_cleanup_errors=True) as temporary:
        job_files = [Path(temporary, f"{number}.json") for number in range(len(jobs))]
        for job, job_file in zip(jobs, job_files, strict=True):
            job.file(ANSWER_NAME).unlink(missing_ok=True)
            job_file.write_text(json.dumps(asdict(job)), encoding="utf-8")
        # -P: a folder `reading` in the working directory must not be imported. The matrices here are 4x4, for which
        # OpenBLAS would wake all its threads each time.
        command = [sys.executable, "-P", "-m", "hulldown.reading.blender.reader", *map(str, job_files)]
        ended = run_limited_command(
            confine_command(command, read=readable, write=[job.folder for job in jobs]),
            env={**os.environ, "OPENBLAS_NUM_THREADS": "1", "TMPDIR": temporary},
            limits=limits,
        )
    for job in jobs:
        if not job.file(ANSWER_NAME).is_file():  # it was at this one when it ended
            _raise_reader_failure(job.path, *ended)


class Refused(TypedDict):
    """The reading process's refusal of a file: the value of its answer's only key, "error"."""

    problem: str
    path: str
    remedy: str | None


def read_job_answer(job: Job, kind: type[Found]) -> Found:
    """Return the reading process's answer about a file, as an object of this type."""
    # Its process had opened a file from outside.
    refuse = partial(AssetError, path=job.path, remedy="open it in Blender, save it again, or leave it out")
    answer = read_json(job.file(ANSWER_NAME), dict[str, object], refuse, what="readable: its process gave no answer")
    try:
        if "error" in answer:
            raise AssetError(**convert_parsed_value(answer["error"], Refused))
        return convert_parsed_value(answer, kind)
    except ValueError as error:
        raise refuse(f"isn't readable: its process gave another answer ({error})") from None


def _raise_reader_failure(path: str, code: int, last_words: str, exceeded: str) -> NoReturn:
    if exceeded:
        remedy = "make it smaller, leave it out, or raise --read-timeout or --read-memory"
        raise AssetError(exceeded, path=path, remedy=remedy)
    if missing := remedy_for_blender_output(last_words):
        raise AssetError("needs Blender to be read", path=path, remedy=missing)
    if code < 0:
        problem = f"Blender crashed reading it (signal {-code})"
        raise AssetError(problem, path=path, remedy="open it in Blender, save it again, or leave it out")
    with tempfile.NamedTemporaryFile("w", prefix="hulldown-reading-", suffix=".log", delete=False) as log:
        log.write(last_words)
    last = (last_words.strip().splitlines() or [f"exit code {code}"])[-1]
    raise AssetError(f"reading it failed: {last:.300}", path=path, remedy=f"please report it, with {log.name}")
