"""Build all demo assets into a folder, in their own process, since Blender keeps state and may crash."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

from hulldown.base.errors import AssetError
from hulldown.demo.catalog import DISTRACTOR_FILES, HDRI_FILES, SCENERY_FILES, VEHICLE_FILES
from hulldown.reading.libraries import remedy_for_blender_output

ASSET_FILES = (*VEHICLE_FILES, *DISTRACTOR_FILES, *SCENERY_FILES, *HDRI_FILES)
MAX_ATTEMPTS = 3  # Blender crashes now and then; what it had built stays
BUILT_LINE_PREFIX = "hulldown built "  # starts a line of the child process that names a file


def build_demo_assets(
    folder: Path | str, *, seed: int = 0, progress: Callable[[int, int], None] | None = None, files: Sequence[str] = ASSET_FILES
) -> tuple[Path, ...]:
    """Build vehicles/, distractors/, sceneries/ and hdris/ of the demo below `folder`; existing files are kept."""
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    left, attempts = [file for file in files if not os.path.lexists(folder / file)], MAX_ATTEMPTS
    while left:
        code, output = _build_files_in_child(
            folder.resolve(), seed, left, lambda: progress and progress(len(files) - len(left), len(files))
        )
        if code == 0:
            break  # all are built, even if a line of Blender's swallowed one that names a file
        attempts -= 1
        if not left or (code < 0 and attempts):
            continue  # an error is explained by its output; only a crash is worth another attempt
        if remedy := remedy_for_blender_output("".join(output)):
            raise AssetError("building demo assets needs Blender", remedy=remedy)
        last = output[-1].strip() if output else f"exit status {code}"
        raise AssetError(f"Blender could not build the demo assets: {last}", path=folder)
    return tuple(folder / file for file in files)


def _build_files_in_child(folder: Path, seed: int, left: list[str], step: Callable[[], object]) -> tuple[int, list[str]]:
    """Build the files in `left`, and remove each from it when it's done; return exit status and last lines."""
    # -P: a folder `demo` where the user happens to be must not come first.
    command = [sys.executable, "-P", "-m", "hulldown.demo", str(folder), "--seed", str(seed), "--only"]
    output: list[str] = []
    with subprocess.Popen(
        [*command, *(Path(file).stem for file in left)],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        errors="replace",
    ) as child:
        for line in child.stdout or ():
            output = [*output[-20:], line]
            if line.startswith(BUILT_LINE_PREFIX):
                file = Path(line.removeprefix(BUILT_LINE_PREFIX).strip()).relative_to(folder).as_posix()
                if file in left:
                    left.remove(file)
                    step()
    return child.returncode, output
