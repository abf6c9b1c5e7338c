"""A hash of the code that a process runs, so that two machines can tell whether they run the same."""

from __future__ import annotations

import ast
import hashlib
from collections.abc import Iterator
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PREFIX = __name__.removesuffix("geometry.code")  # of the names of modules
FOLDERS = (
    *("geometry", "assets", "placement", "camera", "annotate", "reading", "planning", "dataset"),
    *("render", "training", "demo", "verbs"),
)


@cache
def code_sha256(*modules: str) -> str:
    """SHA-256 of some of this package's modules and all others that they import, directly or not, in functions too.

    Parameters
    ----------
    modules
        Their names without the package's.
    """
    found: dict[str, bytes] = {}
    waiting = list(modules)
    while waiting:
        name = waiting.pop()
        path = ROOT.joinpath(*name.split(".")).with_suffix(".py")
        if name in found or not path.is_file():
            continue
        found[name] = path.read_bytes()
        waiting += _imported(found[name])
    lines = [f"{name} {hashlib.sha256(code).hexdigest()}" for name, code in sorted(found.items())]
    return hashlib.sha256("\n".join(lines).encode()).hexdigest()


def _imported(code: bytes) -> Iterator[str]:
    """Names of what may be modules of this package that some code imports."""
    for node in ast.walk(ast.parse(code)):
        names: list[str] = []
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module:
            names = [node.module, *(f"{node.module}.{alias.name}" for alias in node.names)]
        for name in names:
            if name.startswith(PREFIX) and name.removeprefix(PREFIX).split(".")[0] in FOLDERS:
                yield name.removeprefix(PREFIX)
