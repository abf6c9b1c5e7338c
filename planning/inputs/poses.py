"""Poses that users give in a CSV file, with a line for each image and empty cells for values to plan."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterator, Mapping
from functools import partial
from itertools import pairwise
from pathlib import Path

from hulldown.base.errors import ConfigError
from hulldown.base.outside import MAX_DOCUMENT_BYTES, read_text
from hulldown.plan.given_poses import MAX_COORDINATE_M, GivenPoses, PoseLine, Vector

NAME_COLUMNS = ("scenery", "vehicle", "sequence")
NUMBER_COLUMNS = (*("x", "y", "z", "yaw_deg"), *("camera_x", "camera_y", "camera_z"), *("look_at_x", "look_at_y", "look_at_z"))
SEQUENCE_COLUMNS = ("scenery", "vehicle", "x", "y", "z", "yaw_deg")  # equal in all lines of a sequence
CAMERA, LOOK_AT = NUMBER_COLUMNS[4:7], NUMBER_COLUMNS[7:]


def read_poses(path: Path) -> GivenPoses:
    """Read the poses in a CSV file with commas or semicolons between its columns."""
    text = read_text(path, partial(ConfigError, path=path, remedy="name a CSV file"), most=MAX_DOCUMENT_BYTES)
    header = text.partition("\n")[0]
    table = csv.reader(io.StringIO(text, newline=""), delimiter=";" if ";" in header else ",", strict=True)
    try:
        columns = _parse_column_names(next(table, []), path)
        lines = [_parse_line(cells, columns, table.line_num, path) for cells in table if any(map(str.strip, cells))]
    except csv.Error as error:
        raise pose_line_error(path, table.line_num, f"is no CSV ({error})", "check its quotes") from None
    if not lines:
        raise ConfigError("has no poses", path=path, remedy="add a line for each image under the names of the columns")
    _refuse_bad_sequences(lines, path)
    return GivenPoses(path=path.name, lines=lines)


def _parse_column_names(cells: list[str], path: Path) -> list[str]:
    columns, known = [cell.strip() for cell in cells], f"columns are {', '.join((*NAME_COLUMNS, *NUMBER_COLUMNS))}"
    for k, name in enumerate(columns):
        if name not in NAME_COLUMNS and name not in NUMBER_COLUMNS:
            raise pose_line_error(path, 1, f"has the unknown column {name!r:.60}", known)
        if name in columns[:k]:
            raise pose_line_error(path, 1, f"has the column {name} twice", "remove one")
    if not columns:
        raise ConfigError("is empty", path=path, remedy=f"begin with a line of column names; {known}")
    return columns


def _parse_line(cells: list[str], columns: list[str], number: int, path: Path) -> PoseLine:
    if len(cells) != len(columns):
        raise pose_line_error(path, number, f"has {len(cells)} cells", f"the first line names {len(columns)} columns")
    given = {name: cell.strip() for name, cell in zip(columns, cells, strict=True) if cell.strip()}
    values = {name: _parse_number(given[name], name, number, path) for name in NUMBER_COLUMNS if name in given}
    for name, needed in _column_requirements(given):
        if needed not in given:
            raise pose_line_error(path, number, f"has {name} but no {needed}", f"give {needed}, or leave {name} empty")
    camera, look_at = _vector_or_none(values, CAMERA), _vector_or_none(values, LOOK_AT)
    if camera is not None and camera == look_at:
        raise pose_line_error(path, number, "column look_at_x: the camera looks at its own place", "change one of both")
    x, y, z, yaw_deg = map(values.get, NUMBER_COLUMNS[:4])
    scenery, vehicle, sequence = map(given.get, NAME_COLUMNS)
    return PoseLine(
        line=number, scenery=scenery, vehicle=vehicle, x=x, y=y, z=z, yaw_deg=yaw_deg,
        camera=camera, look_at=look_at, sequence=sequence,
    )  # fmt: skip


def _column_requirements(given: Mapping[str, str]) -> Iterator[tuple[str, str]]:
    groups = {**dict.fromkeys(("x", "y"), ("x", "y")), "z": ("x", "y"), "sequence": CAMERA}
    groups |= {**dict.fromkeys(CAMERA, (*CAMERA, "x", "y")), **dict.fromkeys(LOOK_AT, LOOK_AT)}
    for name in given:
        for needed in groups.get(name, ()):
            yield name, needed


def _parse_number(cell: str, name: str, number: int, path: Path) -> float:
    try:
        value = float(cell)
    except ValueError:
        value = math.nan
    if not abs(value) <= MAX_COORDINATE_M:
        unit = "degrees" if name == "yaw_deg" else "meters"
        raise pose_line_error(path, number, f"column {name}: {cell!r:.60} isn't a number within 1e9", f"give {unit} or nothing")
    return value


def _vector_or_none(values: Mapping[str, float], names: tuple[str, ...]) -> Vector | None:
    if names[0] not in values:
        return None
    x, y, z = (values[name] for name in names)
    return x, y, z


def _refuse_bad_sequences(lines: list[PoseLine], path: Path) -> None:
    """Check that the lines of a sequence follow each other, and have the same vehicle in the same place."""
    ended: set[str | None] = set()
    for before, line in pairwise(lines):
        if line.sequence != before.sequence:
            ended.add(before.sequence)
            if line.sequence is not None and line.sequence in ended:
                what = f"column sequence: {line.sequence!r:.60} goes on after other lines"
                raise pose_line_error(path, line.line, what, "keep a sequence's lines together, or name it otherwise")
        elif line.sequence is not None:
            for name in SEQUENCE_COLUMNS:
                if getattr(line, name) != getattr(before, name):
                    what = f"column {name}: differs from line {before.line} of sequence {line.sequence!r:.60}"
                    raise pose_line_error(path, line.line, what, "in a sequence only the camera moves")


def pose_line_error(path: Path, number: int, what: str, remedy: str) -> ConfigError:
    """Return the error of an invalid line of the file."""
    return ConfigError(f"line {number}: {what}", path=path, remedy=remedy)
