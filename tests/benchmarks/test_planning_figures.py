"""Figures of planning in the docs were measured with the current config of `init`."""

import json
from pathlib import Path

from hulldown.benchmarks.planning import config_hash

DOCS = Path(__file__).parents[2] / "docs"


def test_the_table_was_measured_with_the_config_of_init():
    """If this fails, the config has changed: run `make bench BENCH=planning`."""
    figures = json.loads((DOCS / "benchmarks.json").read_text())["planning"]["figures"]
    assert figures["config"] == config_hash()
    assert f"SHA-256 {config_hash()}" in (DOCS / "benchmarks.md").read_text()
