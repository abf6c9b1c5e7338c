"""The system libraries that Blender needs, and remedies if it doesn't start.

`make setup` runs this file before anything is installed, so it imports the standard library alone:
``python reading/libraries.py`` installs what is missing, as root on Debian or Ubuntu, and else tells how.
"""

from __future__ import annotations

import ctypes
import os
import re
import shutil
import subprocess
import sys

# What the bpy wheels need but don't bring, and the Debian or Ubuntu package that has it.
SYSTEM_LIBRARIES = {
    "libX11.so.6": "libx11-6",
    "libXrender.so.1": "libxrender1",
    "libXfixes.so.3": "libxfixes3",
    "libXi.so.6": "libxi6",
    "libXext.so.6": "libxext6",
    "libxkbcommon.so.0": "libxkbcommon0",
    "libSM.so.6": "libsm6",
    "libICE.so.6": "libice6",
    "libGL.so.1": "libgl1",
    "libEGL.so.1": "libegl1",  # opened when a grease pencil is drawn, without which Blender aborts
}
INSTALL_COMMAND = f"apt-get install {' '.join(SYSTEM_LIBRARIES.values())}"


def missing_libraries() -> tuple[str, ...]:
    """Return libraries of `SYSTEM_LIBRARIES` that this process can't load."""
    if not sys.platform.startswith("linux"):
        return ()
    return tuple(library for library in SYSTEM_LIBRARIES if not _can_load_library(library))


def _can_load_library(library: str) -> bool:
    try:
        ctypes.CDLL(library)
    except OSError:
        return False
    return True


def remedy_for_blender_output(output: str) -> str | None:
    """Return the remedy for a Blender that ended with this output; None if it doesn't suggest a missing library."""
    if "No module named 'bpy'" in output:
        return "install hulldown[blender]"
    if re.search(r"ImportError: lib\S+: cannot open shared object file", output):
        return f"Blender needs system libraries: run `{INSTALL_COMMAND}` as root"
    return None


def main() -> int:
    """Install missing libraries, or print the command for it and return 2."""
    if not (missing := missing_libraries()):
        return 0
    if os.geteuid() == 0 and shutil.which("apt-get"):
        quiet = {**os.environ, "DEBIAN_FRONTEND": "noninteractive"}
        command = [*INSTALL_COMMAND.split(), "--yes", "--quiet", "--no-install-recommends"]
        for step in (["apt-get", "update", "--quiet"], command):
            if subprocess.run(step, env=quiet, stdout=subprocess.DEVNULL, check=False).returncode:
                break
        if not (missing := missing_libraries()):
            return 0
    print(f"Blender needs {', '.join(missing)}. On Debian or Ubuntu: sudo {INSTALL_COMMAND}", file=sys.stderr)
    return 2


if __name__ == "__main__":
    sys.exit(main())
