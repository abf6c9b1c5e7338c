"""Opacity read from materials, compared with Cycles' pictures."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from hulldown.assets.bundle import load_scenery
from hulldown.reading.pieces.asset_report import FileReport
from hulldown.reading.pieces.doubt import DoubtKind
from hulldown.reading.reader_process import export_asset
from hulldown.scene.instances import InstancedScene
from hulldown.scene.rays import RayList

SCRIPT = "cutout_blends.py"
STEP, PIXELS = 1.2, 50  # as in cutout_blends.py
# Lookups are exact; baked opacity, and the luminance of colors between texels, differ a little.
LOOSE = {"colored": 0.02, "red": 0.002, "mirror": 0.02, "two textures": 0.02, "both ways": 0.02, "ramp": 0.1, "noise": 0.02}
EXACT = 2e-3
FEW = 0.02  # share of pixels where a threshold lies between two roundings
BY_CHANCE = ("principled alpha",)  # half opaque Principled shaders let a random half of Cycles' rays through


@pytest.fixture(scope="module")
def cards(written: Path) -> tuple[dict[str, tuple[np.ndarray, np.ndarray]], FileReport]:
    """For each card the picture and its planned transmittance; the report."""
    shown, names = np.load(written / "shown.npy"), json.loads((written / "cards.json").read_text())
    exported = export_asset(written / "cards.blend", written, kind="scenery")
    scenery = load_scenery(exported.bundle)
    height, width = shown.shape
    x, z = np.meshgrid((np.arange(width) + 0.5) / PIXELS, (np.arange(height) + 0.5) / PIXELS)
    scene = InstancedScene(scenery.obstacle_meshes, scenery.instance_mesh, scenery.world_from_instance)
    n = x.size
    assert sorted(scenery.instance_names) == sorted(names)
    origins = np.column_stack([x.ravel(), np.full(n, -5.0), z.ravel()]) - scenery.origin
    planned = scene.transmittance(RayList(origins, np.tile([0.0, 1.0, 0.0], (n, 1)))).reshape(height, width)
    around = {name: (x > STEP * i + 0.01) & (x < STEP * i + 0.99) for i, name in enumerate(names)}
    return {name: (shown[at], planned[at]) for name, at in around.items()}, exported.report


def test_planned_transmittance_equals_cycles(cards):
    off = {}
    for name, (shown, planned) in cards[0].items():
        if name == "by angle":
            continue
        error = np.abs(shown - planned)
        wrong = (error > LOOSE.get(name, EXACT)).mean()
        if (wrong > FEW and name not in BY_CHANCE) or abs(shown.mean() - planned.mean()) > 0.01:
            off[name] = (float(wrong), float(shown.mean()), float(planned.mean()))
    assert not off


def test_opacity_that_depends_on_the_view_is_reported_and_counts_as_opaque(cards):
    by_material, report = cards
    assert (by_material["by angle"][1] == 0.0).all()
    about = [doubt.text for doubt in report.doubts if doubt.kind == DoubtKind.OPACITY]
    assert about == ["the material 'by angle' counts as opaque: its transparency depends on the node 'Layer Weight'"]


def test_a_missing_image_is_reported_and_counts_as_opaque(cards):
    by_material, report = cards
    assert (by_material["lost image"][1] == 0.0).all()
    assert [(Path(missing.path).name, missing.wanted_by) for missing in report.missing] == [("lost.png", ("lost image",))]
