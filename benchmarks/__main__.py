"""`python -m hulldown.benchmarks`: run every benchmark; write docs/benchmarks.md, its plots, and the raw figures.

Each benchmark module has three functions: `run(quick)` measures and returns JSON data, `report(results)` turns that
into a Markdown section, and `plots(results, folder)` draws it and returns the files. Peers take turns with hulldown in
the same process, so that the ratios hold on a noisy machine; tools such as pytest-benchmark finish one way before they
begin the next.
"""

from __future__ import annotations

import argparse
import importlib
import json
import multiprocessing
import platform
import subprocess
import time
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

import psutil
from rich.console import Console

from hulldown.base.code import package_version

ROOT = Path(__file__).parents[1]
SUITES = (
    "top_hits", "top_hits_demo", "settling", "visibility", "boxes", "coco", "planning", "rendering",
    "rendering_error", "cluster", "reading",
)  # fmt: skip
HARD_CASES = Path(__file__).with_name("hard-cases.md")  # the page without its measured table
LIBRARIES = ("embreex", "numpy", "scipy", "trimesh", "bpy", "distributed", "open3d", "pycocotools")


def main() -> int:
    """Run the suites named on the command line, or all, and rewrite the report from all results on disk."""
    parser = argparse.ArgumentParser(prog="make bench BENCH='...'", description=__doc__)
    parser.add_argument("suites", nargs="*", metavar="SUITE", help=f"any of: {', '.join(SUITES)} (default: all)")
    parser.add_argument("--quick", action="store_true", help="small sizes: minutes instead of an hour")
    parser.add_argument("--output", type=Path, default=ROOT / "docs", help="folder of benchmarks.md (default: docs)")
    arguments = parser.parse_args()
    if unknown := set(arguments.suites) - set(SUITES):
        parser.error(f"no such suite: {', '.join(sorted(unknown))}; there are {', '.join(SUITES)}")
    raw = arguments.output / "benchmarks.json"
    raw.parent.mkdir(parents=True, exist_ok=True)
    results = json.loads(raw.read_text()) if raw.exists() else {}
    console = Console(stderr=True)
    for name in arguments.suites or SUITES:
        started = time.perf_counter()
        with console.status(f"{name} ..."):
            figures = _in_own_process(name, arguments.quick)
        seconds = time.perf_counter() - started
        results[name] = {
            "quick": arguments.quick,
            "seconds": round(seconds),
            **commit(),
            "machine": machine(),
            "figures": figures,
        }
        raw.write_text(json.dumps(results, indent=1) + "\n")
        console.print(f"{name}: {seconds:.0f} s")
    (arguments.output / "benchmarks.md").write_text(document(results, arguments.output / "plots"))
    if "top_hits" in results:
        table = importlib.import_module("hulldown.benchmarks.top_hits").hard_cases(results["top_hits"]["figures"])
        (arguments.output / "hard-cases.md").write_text(HARD_CASES.read_text().replace("{{top_hits}}", table))
    console.print(f"wrote {arguments.output / 'benchmarks.md'}")
    return 0


def _in_own_process(suite: str, quick: bool) -> dict[str, Any]:
    """Run a suite in its own process, since Blender, once imported, stays in a process and its children."""
    run = importlib.import_module(f"hulldown.benchmarks.{suite}").run
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool:
        return pool.submit(run, quick).result()


def commit() -> dict[str, str]:
    """Return the commit that was measured, marked if the work tree has changes, and today's date."""
    git = ["git", "-C", str(ROOT)]
    known = subprocess.run([*git, "rev-parse", "--short", "HEAD"], capture_output=True, text=True).stdout.strip()
    changed = subprocess.run([*git, "status", "--porcelain", "-uno"], capture_output=True, text=True).stdout.strip()
    return {"commit": known + (" with changes" if changed else ""), "date": time.strftime("%Y-%m-%d")}


def machine() -> dict[str, str | int]:
    """Describe the machine and the libraries that were measured."""
    versions = {name: version for name in LIBRARIES if (version := package_version(name))}
    return {
        "processor": _processor(),
        "cores": psutil.cpu_count(logical=True) or 1,
        "memory_gb": round(psutil.virtual_memory().total / 2**30),
        "python": platform.python_version(),
        **versions,
    }


def _processor() -> str:
    cpuinfo = Path("/proc/cpuinfo")
    names = (
        [x.split(":", 1)[1].strip() for x in cpuinfo.read_text().splitlines() if x.startswith("model name")]
        if (cpuinfo.exists())
        else []
    )
    return names[0] if names else platform.processor() or platform.machine()


def document(results: dict, plots: Path) -> str:
    """docs/benchmarks.md from all results; draws the plots beside it."""
    plots.mkdir(parents=True, exist_ok=True)
    parts = [
        "# Benchmarks: speed against error",
        "Written by `make bench`; do not edit. Figures are medians of interleaved rounds in one process; trust their "
        "ratios. All figures and libraries' versions are in [benchmarks.json](benchmarks.json).",
    ]
    for name in SUITES:
        if name not in results:
            continue
        result = results[name]
        module = importlib.import_module(f"hulldown.benchmarks.{name}")
        drawn = module.plots(result["figures"], plots) or []
        on = f"{result['machine']['processor']}, {result['machine']['cores']} cores"
        note = "quick sizes, " if result["quick"] else ""
        parts += [
            module.report(result["figures"]).strip(),
            *(f"![{Path(p).stem.replace('_', ' ')}](plots/{Path(p).name})" for p in drawn),
            f"<sub>`BENCH={name}` at commit {result['commit']} ({result['date']}): {note}{result['seconds']} s, {on}</sub>",
        ]
    return "\n\n".join(parts) + "\n"


if __name__ == "__main__":
    raise SystemExit(main())
