"""Materials that read more than a mesh look alike in a file and in its tidy twins, in Cycles' pictures."""

import json
from pathlib import Path

import numpy as np
import pytest

SCRIPT = "input_blends.py"
CARD, PIXELS = 14.4, 12  # pixels from card to card, and of a card, as in input_blends.py
EXACT = 2e-4  # of float32 positions some 50 units from the origin, and of half a turn of light


@pytest.mark.parametrize("twin", ["scenery", "vehicle"])
def test_materials_read_the_same_of_twins(written: Path, twin: str):
    names = json.loads((written / "cards.json").read_text())
    with np.load(written / "pictures.npz") as pictures:
        original, shown = pictures["original"], pictures[twin]
    off = {}
    for number, name in enumerate(names):
        across = slice(round(CARD * number) + 2, round(CARD * number + PIXELS) - 2)
        there, here = original[2:-2, across], shown[2:-2, across]
        assert there.any() or name == "lacking", f"{name} isn't in the picture"
        if (error := float(np.abs(here - there).max())) > EXACT:
            off[name] = error
    assert off == {}
