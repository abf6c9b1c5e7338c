"""Real renders: a grey card is as bright as was asked for, whatever lights it, and the sky is seen as planned."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from benchmarks.exposure import error_ev
from camera.response import ALBEDO, displayed, metered, white_balance

pytestmark = pytest.mark.blender
BENCHMARKS = Path(__file__).parents[1] / "benchmarks"


def blender(script, folder, asked):
    given, answer = folder / "asked.json", folder / "answer.json"
    given.write_text(json.dumps(asked))
    subprocess.run(
        [sys.executable, "-P", str(BENCHMARKS / script), str(given), str(answer)], check=True, capture_output=True
    )
    return json.loads(answer.read_text())


def test_a_grey_card_is_as_bright_as_was_asked_for(tmp_path):
    kinds = ["overcast 0.3", "dusk 2", "lamp 50", "noon 0.53 degrees"]  # that sun has one or two pixels
    skies = blender("exposure_skies.py", tmp_path, {"kinds": kinds, "powers": [-8, 8], "rows": []})
    radiance = ALBEDO / np.pi * np.array([sky["irradiance"] for sky in skies])
    exact = metered(radiance).tolist()
    jobs = [{"hdri": sky["path"], "exposure": ev, "yaw": 0.7} for sky, ev in zip(skies, exact, strict=True)]
    first = jobs[0]
    jobs += [{**first, "visibility_m": 100.0}, {**first, "white_balance": 900.0}, {**first, "horizon": 0.8}]
    jobs += [{**first, "strength": 4.0, "exposure": exact[0] - 2.0}]
    levels = np.array(blender("exposure_blender.py", tmp_path, jobs))
    n = len(skies)
    assert [abs(error_ev(level)) < 0.1 for level in levels[: n + 1]] == [True] * (n + 1), "fog counts with nothing"
    balanced = displayed(white_balance(900.0) @ radiance[0] * 2.0 ** exact[0])
    np.testing.assert_allclose(levels[n + 1], balanced, atol=4.0)
    np.testing.assert_allclose(levels[n + 2], levels[0], atol=0.5)  # the light is the HDRI's, whatever is seen
    np.testing.assert_allclose(levels[n + 3], levels[0], atol=0.5)
