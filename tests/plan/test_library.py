"""Usual lengths of vehicles by category, then by name; `inspect` and `init` doubt what `plan` would refuse."""

import pytest

from hulldown.plan.library import odd_length_class_and_range, with_odd_length_doubt
from hulldown.reading.pieces.asset_report import FileReport


def report_of(length: float) -> FileReport:
    return FileReport("vehicle", "car-truck-tanker.glb", (length, length / 4, length / 3), 12, 1.0, "z")


@pytest.mark.parametrize(
    ("names", "kind"),
    [
        (("truck", "car-truck-tanker"), None),
        (("", "car-tanker"), "car"),
        (("", "car-truck"), None),
        (("vehicle", "mbt_1"), None),
    ],
)
def test_the_category_outweighs_the_name(names: tuple[str, str], kind: str | None) -> None:
    odd = odd_length_class_and_range(names, report_of(10.8))
    assert (odd and odd[0]) == kind


def test_an_odd_length_is_doubted_once() -> None:
    doubted = with_odd_length_doubt(report_of(0.5), "truck")
    (doubt,) = doubted.doubts
    assert "it is 50 cm long, and a truck has 3 to 30 m; set scale" in doubt.text
    assert with_odd_length_doubt(doubted, "truck") == doubted
    assert with_odd_length_doubt(report_of(10.8), "truck").doubts == ()
