"""The table of `inspect`: whole names in any output, and few rows for dropped objects."""

import io
from dataclasses import replace

import pytest

from hulldown.geometry.terminal import Terminal
from hulldown.reading.report import FileReport, ObjectRow
from hulldown.reading.vehicle.paintable import MaterialRow
from hulldown.verbs import terminal
from hulldown.verbs.terminal import show_table

LONG = "Panzerkampfwagen_Geschuetzrohr_Muendungsbremse_links_oben_" * 3 + "1"


def report(*rows):
    return FileReport("vehicle", "a.blend", (6.0, 3.0, 2.0), 12, 1.0, "z", rows=rows)


def shown(monkeypatch, table, **console):
    file = io.StringIO()
    monkeypatch.setattr(terminal, "STDOUT", Terminal(file=file, highlight=False, **console))
    show_table(table)
    return file.getvalue()


def test_a_name_with_a_line_break_stays_in_one_line():
    odd = replace(report(), materials=(MaterialRow("Ty\nre", 1.0, (0.0, 0.0, 0.0), "is rubber"),))
    assert odd.lines()[-1] == "materials left alone: Ty\\nre (is rubber)"


def test_a_piped_table_has_whole_names_in_one_line(monkeypatch):
    # They were cut at 80 columns, but `drop` needs them.
    text = shown(monkeypatch, report(ObjectRow(LONG, "MESH", "hull", "by default")).table())
    assert any(LONG in line for line in text.splitlines())


def test_a_terminal_shows_every_character_of_a_name(monkeypatch):
    text = shown(
        monkeypatch, report(ObjectRow(LONG, "MESH", "hull", "by default")).table(), force_terminal=True, width=80
    )
    cells = [line.split("│")[1].strip() for line in text.splitlines() if line.count("│") > 2]
    assert LONG in "".join(cells)
    assert "…" not in text


def test_objects_dropped_for_one_reason_share_a_row():
    # Hidden and dropped objects filled 16 of 24 rows.
    hidden = [
        ObjectRow(f"helper {k} of mine", "MESH", "dropped", "hidden from render", 1, 5) for k in "abcdefghijklmnop"
    ]
    named = [ObjectRow(f"lamp {k} x", "LIGHT", "dropped", f"{f'lamp {k} x'!r} matches 'lamp'") for k in "abc"]
    lone = ObjectRow("bound", "MESH", "dropped", "'bound' matches 'bound'")
    table = report(hidden[0], ObjectRow("body", "MESH", "hull", "by default"), *hidden[1:], lone, *named).table()
    rows = list(zip(*(column.cells for column in table.columns[:4]), strict=True))
    assert [row[0].split(",")[0] for row in rows] == ["body", "helper a of mine", "bound", "lamp a x"]
    assert rows[1][0].endswith("helper l of mine and 4 more")
    assert rows[1][3] == "16"
    assert rows[3][2] == "its name matches 'lamp'"


@pytest.mark.parametrize("count", [1, 2])
def test_a_few_dropped_objects_keep_their_rows(count):
    rows = [ObjectRow(f"a{k}x", "MESH", "dropped", "hidden from render") for k in range(count)]
    assert report(*rows).table().row_count == count
