"""Drawn paint: within the config's ranges, and a function of seed, position, and place alone."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from hulldown.planning.appearance.paint import OWN, PaintEntry, draw_coats
from hulldown.planning.search.draws import RandomStreams

COLORS = st.lists(st.one_of(st.just(OWN), st.integers(0, 0xFFFFFF).map(lambda n: f"#{n:06x}")), min_size=1, max_size=5)


def spread(low, high):
    return st.tuples(st.floats(low, high), st.floats(low, high)).map(lambda pair: tuple(sorted(pair)))


ENTRIES = st.lists(
    st.builds(
        PaintEntry,
        colors=COLORS.map(tuple),
        hue_deg=spread(-180.0, 180.0),
        saturation=spread(0.0, 10.0),
        value=spread(0.0, 10.0),
    ),
    max_size=3,
)
SEEDS = st.integers(0, 2**63 - 1)
POSITIONS = st.lists(st.integers(0, 10**9), min_size=1, max_size=20, unique=True)


@given(ENTRIES, SEEDS, POSITIONS, st.integers(0, 200))
def test_coats_are_within_the_config(entries, seed, positions, place):
    for coats in draw_coats(entries, RandomStreams(seed), position=np.array(positions), place=place):
        for coat, entry in zip(coats, entries, strict=True):
            assert (coat.color or OWN) in entry.colors
            assert coat.materials == list(entry.materials)
            for value, (low, high) in zip(
                (coat.hue_deg, coat.saturation, coat.value), (entry.hue_deg, entry.saturation, entry.value), strict=True
            ):
                assert low - 1e-9 <= value <= high + 1e-9


@given(ENTRIES, SEEDS, POSITIONS, st.data())
def test_coats_do_not_depend_on_other_rows(entries, seed, positions, data):
    places = data.draw(st.lists(st.integers(0, 200), min_size=len(positions), max_size=len(positions)))
    order = data.draw(st.permutations(range(len(positions))))
    together = draw_coats(entries, RandomStreams(seed), position=np.array(positions), place=np.array(places))
    for i in order:
        alone = draw_coats(entries, RandomStreams(seed), position=np.array(positions[i : i + 1]), place=places[i])
        assert alone == [together[i]]
