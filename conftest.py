"""Array shapes checked at calls, Hypothesis profiles, and the cost of a test run.

HULLDOWN_SHAPES chooses the modules whose calls are checked: `entry` (the default) checks the modules that users call,
`all` checks every module and takes three times as long, `off` checks none.
"""

import os
import re
import resource
import sys
import tomllib
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import pytest
from beartype import BeartypeConf, beartype
from hypothesis import HealthCheck, settings
from jaxtyping import install_import_hook

# BLAS threads would compete with the other test workers.
for library in ("OMP", "OPENBLAS", "MKL"):
    os.environ.setdefault(f"{library}_NUM_THREADS", "1")

PYPROJECT = tomllib.loads((Path(__file__).with_name("pyproject.toml")).read_text())
PACKAGES = PYPROJECT["tool"]["hatch"]["build"]["targets"]["wheel"]["only-include"]
CHECKED = {
    "entry": [
        "hulldown.geometry.meshes",
        "hulldown.placement.terrain",
        "hulldown.placement.settle",
        "hulldown.camera.intrinsics",
        "hulldown.camera.cameras",
        "hulldown.annotate.boxes",
    ],
    "all": [f"hulldown.{name.removesuffix('.py')}" for name in PACKAGES if name not in ("__init__.py", "py.typed")],
    "off": [],
}
# For the hook, which imports its checker by name: an int is a float, as for mypy (PEP 484).
sys.modules["shape_checker"] = checker = ModuleType("shape_checker")
checker.check = beartype(conf=BeartypeConf(is_pep484_tower=True))
install_import_hook(CHECKED[os.environ.get("HULLDOWN_SHAPES", "entry")], "shape_checker.check")

STARTED = pytest.StashKey[float]()

settings.register_profile("dev", max_examples=25, deadline=None)
settings.register_profile("ci", max_examples=50, deadline=None, derandomize=True)
settings.register_profile(
    "thorough", max_examples=2000, deadline=None, suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large]
)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "dev"))


# Commands that install packages for some tests.
INSTALLS = {
    **dict.fromkeys(("bpy", "mathutils"), "pip install 'hulldown[blender]'"),
    **dict.fromkeys(("dask", "distributed"), "pip install 'hulldown[cluster]'"),
    **dict.fromkeys(("datasets", "onnxruntime"), "pip install 'hulldown[readers]'"),
    **dict.fromkeys(
        [
            "albumentations",
            "cv2",
            "huggingface_hub",
            "lightning_fabric",
            "pyarrow",
            "pytorch_lightning",
            "rfdetr",
            "safetensors",
            "tensorboard",
            "torch",
            "torchvision",
            "transformers",
        ],
        "pip install 'hulldown[training]'",
    ),
}


def needed(report: pytest.CollectReport | pytest.TestReport) -> str | None:
    """Return the command to install, if a test or its module failed because an optional package is missing."""
    if not report.failed:
        return None
    found = re.search(r"ModuleNotFoundError: No module named '(\w+)", str(report.longrepr))
    return f"{found[1]} is missing: {INSTALLS[found[1]]}" if found and found[1] in INSTALLS else None


@pytest.hookimpl(wrapper=True)
def pytest_make_collect_report(collector: pytest.Collector) -> Iterator[None]:
    """Skip a module whose optional packages aren't installed."""
    report = yield
    if reason := needed(report):
        report.outcome, report.longrepr = "skipped", (str(collector.path), 1, f"Skipped: {reason}")
    return report


def cpu_seconds() -> float:
    """CPU seconds of this process and its ended children."""
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(use.ru_utime + use.ru_stime for use in used)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Iterator[None]:
    """Record the CPU seconds of a test, including its fixtures, for its last report."""
    item.stash[STARTED] = cpu_seconds()
    return (yield)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item, call: pytest.CallInfo[None]) -> Iterator[None]:
    """Skip a test whose optional packages aren't installed; add its CPU seconds to the report of its teardown."""
    report = yield
    if reason := needed(report):
        report.outcome, report.longrepr = "skipped", (str(item.path), 1, f"Skipped: {reason}")
    if report.when == "teardown":
        report.user_properties.append(("cpu_seconds", cpu_seconds() - item.stash[STARTED]))
    return report


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter, config: pytest.Config) -> None:
    """Print the ten slowest tests and the time per folder, in CPU seconds next to a loop timed in the same run."""
    reports = [r for rs in terminalreporter.stats.values() for r in rs if getattr(r, "when", None) == "teardown"]
    cost = {r.nodeid: seconds for r in reports for name, seconds in r.user_properties if name == "cpu_seconds"}
    if len(cost) < 100:
        return
    loop = reference_seconds()
    terminalreporter.section("CPU seconds")
    for test, seconds in Counter(cost).most_common(10):
        terminalreporter.write_line(f"{seconds:8.1f}  {test}")
    folders: Counter[str] = Counter()
    for test, seconds in cost.items():
        folders[str(Path(test.split("::")[0]).parent)] += seconds
    for folder, seconds in folders.most_common():
        terminalreporter.write_line(f"{seconds:8.1f}  {folder}/")
    total = sum(cost.values())
    terminalreporter.write_line(
        f"{total:8.1f}  in {len(cost)} tests, without collection: {total / loop:.0f} times a loop of {loop:.2f} s"
    )


def reference_seconds() -> float:
    """CPU seconds of 20 million additions in Python, as a measure of this machine."""
    start, total = cpu_seconds(), 0
    for number in range(20_000_000):
        total += number
    assert total
    return cpu_seconds() - start


def pytest_sessionfinish(session: pytest.Session) -> None:
    """With HULLDOWN_NO_SKIPS, a run with a skipped test fails, unless it needs an extra in HULLDOWN_WITHOUT."""
    reporter = session.config.pluginmanager.get_plugin("terminalreporter")
    worker = hasattr(session.config, "workerinput")
    without = [f"hulldown[{extra}]" for extra in os.environ.get("HULLDOWN_WITHOUT", "").split()]
    reasons = [str(report.longrepr) for report in reporter.stats.get("skipped", ())]
    unasked = [reason for reason in reasons if not any(extra in reason for extra in without)]
    if os.environ.get("HULLDOWN_NO_SKIPS") and not worker and unasked:
        print("skipped tests count as failures here: install what they name", file=sys.stderr)
        session.exitstatus = session.exitstatus or pytest.ExitCode.TESTS_FAILED
