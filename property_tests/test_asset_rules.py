"""Names, clean-up, and parts are found for any names and positions of objects."""

import numpy as np
from hypothesis import assume, given
from hypothesis import strategies as st

from hulldown.geometry.transforms import rigid_matrix, rotation_z
from hulldown.reading.pieces.naming import (
    GROUND_WORDS,
    GUN_WORDS,
    HELPER_WORDS,
    TURRET_WORDS,
    first_matching_pattern,
    name_words,
)
from hulldown.reading.pieces.roles import Link, Piece, vehicle_roles
from hulldown.reading.vehicle.parts import find_parts
from hulldown.reading.vehicle.solids import PlacedPieces, find_solids
from hulldown.tests.reading.test_roles import piece

names = st.text(st.characters(codec="utf-8", exclude_categories=("Cs",)), max_size=20)
coordinates = st.floats(-50, 50).map(lambda x: round(x, 3))
sizes = st.floats(0.05, 8).map(lambda x: round(x, 3))


@given(names, st.integers(1, 999))
def test_numbers_added_by_blender_change_nothing(name: str, number: int) -> None:
    assume(name[-4:-3] != ".")
    numbered = f"{name}.{number:03}"
    assert name_words(numbered) == name_words(name)
    for patterns in (TURRET_WORDS, GUN_WORDS, GROUND_WORDS, HELPER_WORDS):
        assert first_matching_pattern(numbered, patterns) == first_matching_pattern(name, patterns)


@given(
    st.sampled_from(TURRET_WORDS + GUN_WORDS + GROUND_WORDS),
    st.sampled_from(["_", "-", " ", ".", ""]),
    st.sampled_from(["Left", "Old"]),
)
def test_a_word_is_found_in_any_spelling(word: str, gap: str, other: str) -> None:
    for name in (f"{word}{gap}{other}", f"{other}{gap}{word.capitalize()}", f"{word.upper()}{gap or '_'}{other}", f"{word}s"):
        assert first_matching_pattern(name, (word,)) == word
    if gap == "":
        assert first_matching_pattern(f"{word}ish", (word,)) is None


blocks = st.lists(st.tuples(st.tuples(*[coordinates] * 3), st.tuples(*[sizes] * 3)), min_size=1, max_size=6)


@given(blocks, st.permutations(range(3)))
def test_only_the_floor_under_a_vehicle_is_dropped(parts: list, order: list[int]) -> None:
    vehicle = [piece(f"Part {i}", size=size, at=np.add(low, np.array(size) / 2)) for i, (low, size) in enumerate(parts)]
    before = [role.use for role in vehicle_roles(vehicle)]
    assert before == ["vehicle"] * len(vehicle) or any(p.bounds[1, 2] - p.bounds[0, 2] < 0.2 for p in vehicle)
    low, high = np.min([p.bounds[0] for p in vehicle], axis=0), np.max([p.bounds[1] for p in vehicle], axis=0)
    reach = 3 * float((high - low)[:2].max())
    wide, under = (*(high - low)[:2] + 2 * reach, 0.001), (*(low + high)[:2] / 2, low[2] - 0.0005)
    floors = [piece(name, size=wide, at=under) for name in ("Floor", "Object_17", "Plane.003")]
    roles = [role.use for role in vehicle_roles([*(floors[i] for i in order), *vehicle])]
    assert roles == ["dropped"] * 3 + before


@given(st.floats(-3, 3), st.tuples(coordinates, coordinates, coordinates))
def test_parts_do_not_depend_on_the_vehicles_position_in_the_file(yaw: float, at: tuple) -> None:
    file_from_vehicle = rigid_matrix(rotation_z(yaw), np.array(at))
    cube = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
    spots = {"Hull": (0, 0, 0.5), "Turret": (0.4, 0.1, 1.5), "Gun": (1.2, 0.1, 1.5)}
    found = []
    for world in (np.eye(4), file_from_vehicle):
        pieces, points = [], []
        for name, spot in spots.items():
            pose = world @ rigid_matrix(np.eye(3), np.array(spot, float))
            pieces.append(Piece("m", (Link(name, (), "MESH", pose),), 0, pose, np.zeros((2, 3)), 12))
            stretch = np.array([4.0, 0.2, 0.2]) if name == "Gun" else np.ones(3)
            points.append(cube * stretch + spot + (np.array([2, 0, 0]) if name == "Gun" else 0))
        whole = PlacedPieces(pieces, points, find_solids((), ()), (), np.linalg.inv(world))
        found.append(find_parts(whole).moving)
    for here, there, name in zip(*found, ("Turret", "Gun"), strict=True):
        assert here.name == there.name == name.lower()
        assert np.allclose(here.pivot, there.pivot, atol=1e-9)
        assert np.allclose(here.axis, there.axis)
    assert np.allclose(found[0][0].pivot, spots["Turret"])
