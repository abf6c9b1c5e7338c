"""A file's report as a person reads it."""

import io
import math

from rich.console import Console

from reading.report import FileReport, PartRow, Row


def report(path: str) -> FileReport:
    size = (7.0, 3.0, 2.0)
    return FileReport(
        kind="vehicle",
        path=path,
        size=size,
        triangles=1234,
        unit=0.01,
        up="y",
        rows=(Row("Hull [old]", "MESH", "hull", "by default", 2, 617, size), Row("Sun", "LIGHT", "dropped", "[light]")),
        parts=(
            PartRow(
                "turret",
                "hull",
                (0.0, 0.0, 1.5),
                (0.0, 0.0, 1.0),
                (-math.pi / 6, math.pi / 6),
                "origin of 'Turret [a]'",
            ),
        ),
        doubts=("odd [/very]",),
    )


def test_the_table_has_every_name_as_it_is() -> None:
    console = Console(width=160, file=io.StringIO())
    console.print(report("a [/new] one/tank[v].blend").table())
    said = console.file.getvalue()
    for words in ("a [/new] one/tank[v].blend: vehicle", "Hull [old]", "7.00 x 3.00 x 2.00", "617", "[light]"):
        assert words in said


def test_notes_say_size_parts_and_doubts() -> None:
    assert report("tank.blend").notes() == [
        "size 7.00 x 3.00 x 2.00 m, 1,234 triangles, y up, 1 unit = 0.01 m",
        "turret on hull: pivot (0.00, 0.00, 1.50), axis (0.00, 0.00, 1.00), -30 to 30 degrees; origin of 'Turret [a]'",
        "doubt: odd [/very]",
    ]
