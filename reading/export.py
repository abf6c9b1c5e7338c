"""A vehicle or scenery out of an asset file, read by Blender in a process of its own."""

from __future__ import annotations

import json
import os
import shutil
import sys
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from hulldown.geometry.errors import AssetError
from hulldown.reading.confinement.landlock import asset_folders, confined
from hulldown.reading.confinement.references import refuse_odd_references
from hulldown.reading.confinement.watch import DEFAULT_LIMITS, Ended, ReadLimits, watched
from hulldown.reading.formats import format_of
from hulldown.reading.options import Options
from hulldown.reading.report import FileReport

LAST_WORDS = 2000  # characters of what Blender said before it crashed
DEFAULTS = Options()


@dataclass(frozen=True, slots=True)
class Exported:
    """What reading a file left behind.

    Parameters
    ----------
    report
        What was found in the file and what was made of it.
    bundle
        The geometry, for `assets.bundle.load_vehicle` or `load_scenery`.
    tidy
        A .blend that holds what is rendered and nothing else, see `reading.blender.tidy`.
    files
        Absolute path of every file that the asset refers to: textures, libraries.
    """

    report: FileReport
    bundle: Path
    tidy: Path
    files: tuple[str, ...]


def export(
    path: Path | str,
    folder: Path | str,
    *,
    kind: str | None = None,
    name: str = "",
    options: Options = DEFAULTS,
    limits: ReadLimits = DEFAULT_LIMITS,
) -> Exported:
    """Read the file `path` once and write bundle and tidy twin into `folder`.

    Parameters
    ----------
    path
        A .blend, .glb, .gltf, .fbx or .obj file.
    folder
        Exists; files of an earlier export in it are overwritten.
    kind
        "vehicle", "scenery", or None to judge by what is in it.
    name
        What to call it; the file's name without suffix if empty.
    options
        How to read it.
    limits
        When reading it is given up.

    Raises
    ------
    AssetError
        If the file cannot be read, or does not hold what is wanted.
    """
    job = job_for(Path(path), Path(folder), kind=kind, name=name, options=options)
    return exported_by(job, ask_reader([job], limits=limits)[0])


def job_for(
    path: Path, folder: Path, *, kind: str | None, name: str = "", options: Options = DEFAULTS
) -> dict[str, Any]:
    """What to tell the reader; arguments as of `export`.

    Raises
    ------
    AssetError
        If the file is of no format that can be read.
    """
    kind_of_file = format_of(path)
    refuse_odd_references(path, kind_of_file)
    return {
        "given": str(path),
        "path": str(path.resolve()),
        "format": kind_of_file,
        "kind": kind,
        "name": name or path.stem,
        "options": asdict(options),
        "bundle": str(folder.resolve() / "bundle.npz"),
        "tidy": str(folder.resolve() / "tidy.blend"),
        "answer": str(folder.resolve() / "answer.json"),
    }


def exported_by(job: Mapping[str, Any], answer: Mapping[str, Any]) -> Exported:
    """What the reader has made of a job.

    Raises
    ------
    AssetError
        If it could make nothing of it.
    """
    if "error" in answer:
        raise AssetError(answer["error"]["problem"], path=job["given"], remedy=answer["error"]["remedy"])
    report = FileReport.from_json({**answer["report"], "path": job["given"]})
    return Exported(report, Path(job["bundle"]), Path(job["tidy"]), tuple(answer["files"]))


def ask_reader(jobs: Sequence[Mapping[str, Any]], *, limits: ReadLimits = DEFAULT_LIMITS) -> list[dict[str, Any]]:
    """Have jobs done one after the other by one process, confined and watched; the answer to each.

    Parameters
    ----------
    jobs
        As `job_for` makes them, with their `answer` in one folder, the only one that the process can write to.
    limits
        When it is given up.

    Raises
    ------
    AssetError
        If the process ends without an answer to one of them, which the file is named for.
    """
    folder = Path(jobs[0]["answer"]).parent
    job_files = []
    for number, job in enumerate(jobs):
        Path(job["answer"]).unlink(missing_ok=True)
        job_files.append(folder / f"job-{number}.json")
        job_files[-1].write_text(json.dumps(job), encoding="utf-8")
    temporary = Path(tempfile.mkdtemp(prefix="tmp-", dir=folder))
    # -P: a folder `reading` where the user happens to be must not come first. The matrices here are 4x4, for which
    # OpenBLAS would wake all its threads each time.
    command = [sys.executable, "-P", "-m", "hulldown.reading.blender.reader", *map(str, job_files)]
    try:
        ended = watched(
            confined(command, read=[f for job in jobs for f in asset_folders(Path(job["path"]))], write=[folder]),
            env={**os.environ, "OPENBLAS_NUM_THREADS": "1", "TMPDIR": str(temporary)},
            limits=limits,
        )
        return [_answer(job, ended) for job in jobs]
    finally:
        shutil.rmtree(temporary, ignore_errors=True)
        for job_file in job_files:
            job_file.unlink(missing_ok=True)


def _answer(job: Mapping[str, Any], ended: Ended) -> dict[str, Any]:
    """What the reader has answered; the first job without an answer is the one that it was at when it ended."""
    path, answer_file = job["given"], Path(job["answer"])
    if answer_file.is_file():
        answer: dict[str, Any] = json.loads(answer_file.read_text(encoding="utf-8"))
        return answer
    if ended.exceeded:
        raise AssetError(
            ended.exceeded, path=path, remedy="make it smaller, leave it out, or raise --read-timeout or --read-memory"
        )
    if "No module named 'bpy'" in ended.said:
        raise AssetError("needs Blender to be read", path=path, remedy="install hulldown[blender]")
    if ended.code < 0:
        raise AssetError(
            f"Blender crashed reading it (signal {-ended.code})",
            path=path,
            remedy="open it in Blender, save it again, or leave it out",
        )
    raise RuntimeError(f"{path}: reading it failed:\n{ended.said[-LAST_WORDS:]}")
