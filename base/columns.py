"""Frozen dataclasses of arrays as tables, whose fields are arrays or tables of n rows; rows as objects."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import fields
from typing import Any, ClassVar, Protocol, TypeVar, runtime_checkable

import numpy as np
from jaxtyping import Int


@runtime_checkable
class Columns(Protocol):
    """A dataclass whose fields are arrays of the same length."""

    __dataclass_fields__: ClassVar[dict[str, Any]]


Table = TypeVar("Table", bound=Columns)
RowObject = TypeVar("RowObject")


def take(table: Table, rows: Int[np.ndarray, " k"]) -> Table:
    """Return some rows of a table."""
    columns = (getattr(table, field.name) for field in fields(table))
    return type(table)(*(column[rows] if isinstance(column, np.ndarray) else take(column, rows) for column in columns))


def put_rows(table: Table, rows: Int[np.ndarray, " k"], values: Table) -> None:
    """Overwrite some rows with those of another table."""
    for field in fields(table):
        column, new = getattr(table, field.name), getattr(values, field.name)
        if isinstance(column, np.ndarray):
            column[rows] = new
        else:
            put_rows(column, rows, new)


def join_rows(tables: Sequence[Table]) -> Table:
    """Concatenate one or more tables."""
    columns = ([getattr(table, field.name) for table in tables] for field in fields(tables[0]))
    return type(tables[0])(
        *(np.concatenate(parts) if isinstance(parts[0], np.ndarray) else join_rows(parts) for parts in columns)
    )


def row_objects(kind: Callable[..., RowObject], columns: Mapping[str, Iterable[object]]) -> list[RowObject]:
    """Return an object for each row of columns of the same length; their names are its fields."""
    return [kind(**dict(zip(columns, values, strict=True))) for values in zip(*columns.values(), strict=True)]
