"""Checks array shapes at every call under test, and registers the Hypothesis profiles."""

import os

from hypothesis import HealthCheck, settings
from jaxtyping import install_import_hook

PACKAGES = ["geometry", "assets", "placement", "camera", "annotate", "planning", "render", "cli"]
install_import_hook(PACKAGES, "beartype.beartype")

settings.register_profile("dev", max_examples=25, deadline=None)
settings.register_profile("ci", max_examples=50, deadline=None, derandomize=True)
settings.register_profile(
    "thorough",
    max_examples=2000,
    deadline=None,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large],
)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "dev"))
