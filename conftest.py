"""Checks array shapes at every call under test, and registers the Hypothesis profiles.

HULLDOWN_SHAPES=off leaves the checks of shapes out, which take two thirds of the time of what `make fuzz` tries.
"""

import os
import tomllib
from pathlib import Path

from hypothesis import HealthCheck, settings
from jaxtyping import install_import_hook

PYPROJECT = tomllib.loads((Path(__file__).with_name("pyproject.toml")).read_text())
PACKAGES = PYPROJECT["tool"]["hatch"]["build"]["targets"]["wheel"]["only-include"]
if os.environ.get("HULLDOWN_SHAPES") != "off":
    install_import_hook([package.removesuffix(".py") for package in PACKAGES], "beartype.beartype")

settings.register_profile("dev", max_examples=25, deadline=None)
settings.register_profile("ci", max_examples=50, deadline=None, derandomize=True)
settings.register_profile(
    "thorough",
    max_examples=2000,
    deadline=None,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large],
)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "dev"))
