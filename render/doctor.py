"""Diagnose a machine: versions, Blender's system libraries, and Cycles' devices."""

from __future__ import annotations

import importlib.util
import platform
import subprocess
import sys
from dataclasses import dataclass, field

from rich.markup import escape
from rich.table import Table

from hulldown.base.code import package_version
from hulldown.base.outside import parse_json
from hulldown.base.terminal import STDERR_TERMINAL
from hulldown.reading.confinement.landlock import NETWORK_ABI, describe_confinement, landlock_version, unconfined_reason
from hulldown.reading.libraries import INSTALL_COMMAND, SYSTEM_LIBRARIES, missing_libraries

REPORTED_PACKAGES = ("hulldown", "bpy", "embreex", "trimesh", "numpy", "scipy", "pycocotools", "pydantic", "pillow")

# Runs in a child process: bpy may crash while loading, and needs a main thread.
PROBE_SCRIPT = """
import json, bpy
from hulldown.render.blender.cycles import available_devices
print("@@" + json.dumps({"blender": bpy.app.version_string, "devices": available_devices()}))
"""


@dataclass(frozen=True, slots=True)
class Diagnosis:
    """What a machine has; without `problems` it can plan and render, and without Landlock `landlock` is 0."""

    python: str
    system: str
    versions: dict[str, str | None]
    missing_libraries: dict[str, str]
    blender: str | None
    landlock: int = 0
    devices: list[dict[str, str]] = field(default_factory=list)
    problems: list[str] = field(default_factory=list)

    @property
    def confinement_summary(self) -> str:
        """How files from elsewhere are confined on this machine."""
        if unconfined_reason():
            return f"{describe_confinement()}; only hulldown's list of risky features protects this machine"
        return (
            describe_confinement()
            if self.landlock >= NETWORK_ABI
            else f"{describe_confinement()}, which doesn't cover the network"
        )

    def table(self) -> Table:
        """Return a table without the problems, for a terminal."""
        table = Table(show_header=False, box=None)
        table.add_row("python", self.python)
        table.add_row("system", self.system)
        for name, version in self.versions.items():
            table.add_row(name, version or "not installed")
        table.add_row("Blender", self.blender or "does not start")
        table.add_row("confinement", self.confinement_summary)
        for device in self.devices:
            table.add_row(f"device {device['kind']}", escape(device["name"]))
        return table


def diagnose_machine() -> Diagnosis:
    """Check this machine.

    Reads nothing, writes nothing.
    """
    with STDERR_TERMINAL.status("asking Blender"):
        return _make_diagnosis()


def _make_diagnosis() -> Diagnosis:
    versions = {name: package_version(name) for name in REPORTED_PACKAGES}
    missing = {library: SYSTEM_LIBRARIES[library] for library in missing_libraries()}
    problems = []
    if missing:
        problems.append(f"Blender lacks {', '.join(missing)}; run: {INSTALL_COMMAND}")
    blender, devices = None, []
    if importlib.util.find_spec("bpy") is None:
        problems.append("the bpy module is not installed; run: pip install 'hulldown[blender]' (Python 3.11 or 3.13)")
    elif not missing:
        found = _probe_blender()
        if isinstance(found, str):
            problems.append(f"Blender does not start: {found}")
        else:
            blender, devices = found["blender"], found["devices"]
    system = platform.platform()
    return Diagnosis(platform.python_version(), system, versions, missing, blender, landlock_version(), devices, problems)


def _probe_blender() -> dict | str:
    # -P: modules in the working directory must not be imported.
    command = [sys.executable, "-P", "-c", PROBE_SCRIPT]
    try:
        child = subprocess.run(command, capture_output=True, text=True, timeout=300)
    except subprocess.TimeoutExpired:
        return "no answer within 300 s"
    for line in child.stdout.splitlines():
        if line.startswith("@@"):
            return parse_json(line[2:].encode(), dict)
    last = (child.stderr.strip().splitlines() or [f"exit code {child.returncode}"])[-1]
    return last
