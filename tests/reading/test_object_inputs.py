"""What materials read of their objects: random numbers that pictures share, and doubts about what twins lack."""

import json
from pathlib import Path

import numpy as np

SCRIPT = "input_blends.py"


def test_random_numbers_are_those_of_the_file_whatever_else_is_loaded(written: Path):
    with np.load(written / "pictures.npz") as pictures:
        original, first, second = pictures.values()
    assert len(np.unique(np.round(original, 4))) == len(original) == 11
    np.testing.assert_allclose(first, original, atol=1e-6)
    np.testing.assert_array_equal(first, second)


def test_what_a_twin_lacks_is_a_doubt_that_names_the_materials(written: Path):
    found = json.loads((written / "doubts.json").read_text())
    (still,), (turned,) = ([text for text in found[up] if "bake" in text] for up in ("z", "y"))
    assert still.startswith("the materials 'tone', 'particle', 'placed' read")
    assert turned.startswith("the materials 'plain', 'tone', 'particle', 'placed' read")
