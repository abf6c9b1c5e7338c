import numpy as np
import pytest

from placement.verdict import Verdict, count, describe


def test_counts_explain_a_hopeless_config():
    codes = np.repeat([Verdict.TOO_STEEP, Verdict.OK, Verdict.OBSTACLE, Verdict.OFF_GROUND], [7100, 4, 2850, 46])
    assert count(codes) == {Verdict.OK: 4, Verdict.OFF_GROUND: 46, Verdict.TOO_STEEP: 7100, Verdict.OBSTACLE: 2850}
    assert describe(count(codes)) == (
        "of 10,000 tries 71 % were too steep at the spot, 28 % were too near an obstacle, 0.5 % had no ground below, "
        "0.1 % were taken"
    )


@pytest.mark.parametrize(
    ("counts", "sentence"),
    [
        ({}, "nothing was tried"),
        ({Verdict.OK: 1}, "of 1 try 100 % were taken"),
        ({Verdict.GAP: 2}, "of 2 tries 100 % left too wide a gap under the vehicle, 0 % were taken"),
        ({Verdict.OK: 9999, Verdict.VEHICLE: 1},
         "of 10,000 tries 0.1 % were too near another vehicle, 99.9 % were taken"),
    ],
)  # fmt: skip
def test_nothing_and_everything_are_said_exactly(counts, sentence):
    assert describe(counts) == sentence


def test_every_verdict_has_words():
    assert len({v.phrase for v in Verdict}) == len(Verdict)
