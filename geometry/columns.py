"""Frozen dataclasses of arrays as tables: every field is an array of n rows, or a table of n rows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields
from typing import Any, ClassVar, Protocol, TypeVar, runtime_checkable

import numpy as np
from jaxtyping import Int


@runtime_checkable
class Columns(Protocol):
    """A dataclass whose fields are arrays of the same length."""

    __dataclass_fields__: ClassVar[dict[str, Any]]


Table = TypeVar("Table", bound=Columns)


def take(table: Table, rows: Int[np.ndarray, " k"]) -> Table:
    """Return some rows of a table."""
    columns = (getattr(table, field.name) for field in fields(table))
    return type(table)(*(column[rows] if isinstance(column, np.ndarray) else take(column, rows) for column in columns))


def put(table: Table, rows: Int[np.ndarray, " k"], values: Table) -> None:
    """Overwrite some rows with those of another table."""
    for field in fields(table):
        column, new = getattr(table, field.name), getattr(values, field.name)
        if isinstance(column, np.ndarray):
            column[rows] = new
        else:
            put(column, rows, new)


def join(tables: Sequence[Table]) -> Table:
    """Concatenate one or more tables."""
    columns = ([getattr(table, field.name) for table in tables] for field in fields(tables[0]))
    return type(tables[0])(
        *(np.concatenate(parts) if isinstance(parts[0], np.ndarray) else join(parts) for parts in columns)
    )
