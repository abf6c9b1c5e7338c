"""TOML files as validated models. Every error is one line with the key and the allowed values."""

from __future__ import annotations

import difflib
from collections.abc import Iterator, Mapping
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import Any, TypeVar, get_args

from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from hulldown.base.errors import ConfigError, short_repr
from hulldown.base.outside import describe_path, parse_toml, read_text

POSSIBLE_CONFIG_KINDS = ("a config", "a JSON file", "another file", "empty")
Document = TypeVar("Document", bound=BaseModel)


def read_toml(path: Path, *, remedy: str | None = None) -> dict[str, Any]:
    """Read a TOML file; `remedy` is what to do if it can't be read."""
    if path.exists() and (kind := describe_path(path)) not in POSSIBLE_CONFIG_KINDS:
        raise ConfigError(f"is {kind}, not a config", path=path, remedy=remedy or "name a .toml file")
    text = read_text(path, partial(ConfigError, path=path, remedy=remedy))
    try:
        return parse_toml(text)
    except ValueError as error:
        raise ConfigError(f"isn't TOML: {error}", path=path, remedy="correct that line") from None


def validate_model(
    model: type[Document], data: Mapping[str, object], path: Path | None, *, removed: Mapping[str, str] = MappingProxyType({})
) -> Document:
    """Return the model of a file's data; `removed` has the replacements of keys and values of earlier versions."""
    try:
        return model.model_validate(dict(data))
    except ValidationError as error:
        first, *more = error.errors(include_url=False)
        tail = f" (and {len(more)} more)" if more else ""
        raise ConfigError(_explain_error(first, model, removed) + tail, path=path) from None


# Pydantic's terms for Python types, as TOML's.
_ALLOWED_TYPES = {
    "too_short": "expected at least one",
    "tuple_type": "expected a list",
    "model_type": "expected a table, such as [name] with its keys below",
    "model_attributes_type": "expected a table",
    "string_type": "expected a string",
    "bool_type": "expected true or false",
    "int_type": "expected a whole number",
    "int_from_float": "expected a whole number",
    "float_type": "expected a number",
}


def _explain_error(error: ErrorDetails, top: type[BaseModel], removed: Mapping[str, str]) -> str:
    """Return one line about one of pydantic's errors: key, value, and what is allowed."""
    steps = [s for s in error["loc"] if not (isinstance(s, str) and ("[" in s or s in ("int", "dict")))]
    key = "".join(f"[{s}]" if isinstance(s, int) else f".{s}" for s in steps).lstrip(".")
    is_unknown, declared = error["type"] == "extra_forbidden", ".".join(s for s in steps if isinstance(s, str))
    value = "" if is_unknown or isinstance(error["input"], dict) else f" = {short_repr(error['input'])}"
    if instead := removed.get(declared + value):
        return f"{key}{value} is gone; delete it: {instead}"
    if is_unknown:
        section = [s for s in steps[:-1] if isinstance(s, str)]
        near = _nearest_key(str(steps[-1]), section, top)
        hint = f"did you mean {near}?" if near else f"known here: {', '.join(sorted(_known_section_keys(section, top)))}"
        return f"unknown key {key}; {hint}"
    if error["type"] == "missing":
        return f"{key} is missing" if key else "is empty"
    allowed = _ALLOWED_TYPES.get(error["type"]) or error["msg"].removeprefix("Value error, ")
    allowed = allowed.replace("Input should be", "expected").replace("String should have", "expected")
    return f"{key}{value}: {allowed}" if key else allowed


def _nested_models(annotation: object) -> Iterator[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    for inner in get_args(annotation):
        yield from _nested_models(inner)


def _known_section_keys(section: list[str], model: type[BaseModel]) -> list[str]:
    """Return keys known in a section, given the names that lead to it."""
    for name in section:
        model = next(_nested_models(model.model_fields[name].annotation), model)
    return list(model.model_fields)


def _nearest_key(name: str, section: list[str], top: type[BaseModel]) -> str | None:
    """Return the known key most like `name`: in its own section if there is one, else anywhere, with its section."""
    if near := difflib.get_close_matches(name, _known_section_keys(section, top), n=1):
        return ".".join([*section, near[0]])
    elsewhere = {
        key: table
        for table, field in top.model_fields.items()
        for key in (_known_section_keys([table], top) if list(_nested_models(field.annotation)) else [])
    }
    if near := difflib.get_close_matches(name, elsewhere, n=1, cutoff=0.8):
        return f"{elsewhere[near[0]]}.{near[0]}"
    return None
