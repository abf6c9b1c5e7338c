"""Defaults, allowed values, and meanings of a config's keys, read from the schema.

`python -m hulldown.planning.config.config_keys` rewrites the tables of docs/config.md.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

import tomlkit
from pydantic.fields import FieldInfo
from pydantic.json_schema import JsonSchemaValue

from hulldown.planning.config.asset_sections import DistractorEntry, SceneryEntry, VehicleEntry
from hulldown.planning.config.schema import Config
from hulldown.planning.config.section import Section

PAGE = Path(__file__).parents[2] / "docs" / "config.md"
ENTRIES: Mapping[str, type[Section]] = MappingProxyType(
    {"vehicle": VehicleEntry, "distractor": DistractorEntry, "scenery": SceneryEntry}
)
_SIGNS = {"exclusiveMinimum": ">", "minimum": ">=", "exclusiveMaximum": "<", "maximum": "<="}


@dataclass(frozen=True, slots=True)
class Key:
    """A key of a section, with its meaning."""

    name: str
    default: str | None  # default, example: its default as TOML, None for a key without, and the example of such a key
    example: str | None
    required: bool
    allowed: str  # its range or choices; empty if the meaning describes them
    meaning: str


def keys_of(section: type[Section]) -> list[Key]:
    """Return a section's keys, without its subsections, in the order of the schema."""
    declared = section.model_json_schema()["properties"]
    return [
        _key(name, field, declared[name])
        for name, field in section.model_fields.items()
        if not (isinstance(field.annotation, type) and issubclass(field.annotation, Section))
    ]


def sections() -> dict[str, type[Section]]:
    """Return the config's sections by name."""
    inner = {name: field.annotation for name, field in Config.model_fields.items()}
    return {name: kind for name, kind in inner.items() if isinstance(kind, type) and issubclass(kind, Section)}


def toml_value(value: object) -> str:
    """Return a value as one line of TOML."""
    if isinstance(value, Mapping):
        pairs = [f"{tomlkit.key([key]).as_string()} = {toml_value(inner)}" for key, inner in value.items()]
        return f"{{ {', '.join(pairs)} }}"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(map(toml_value, value)) + "]"
    return tomlkit.item(value).as_string()


def _key(name: str, field: FieldInfo, declared: JsonSchemaValue) -> Key:
    default = None if field.is_required() or field.default is None else field.default
    return Key(
        name=name,
        default=None if default is None or (name == "name" and default == "") else toml_value(default),
        example=toml_value(field.examples[0]) if field.examples else None,
        required=field.is_required(),
        allowed=_allowed(declared),
        meaning=" ".join((field.description or "").split()),
    )


def _allowed(declared: JsonSchemaValue) -> str:
    """Return the range or the choices of a key, given its JSON schema; empty for a key of several types."""
    (kind, *others) = [kind for kind in declared.get("anyOf", [declared]) if kind != {"type": "null"}]
    if others:
        return ""
    kind = kind.get("additionalProperties", kind)  # of a table's values, and of a list's numbers
    kind = kind.get("prefixItems", [kind])[0]
    if "enum" in kind:
        return ", ".join(map(toml_value, kind["enum"]))
    bounds: dict[str, float] = {sign: kind[bound] for bound, sign in _SIGNS.items() if bound in kind}
    if bounds.keys() == {">=", "<="}:
        return _interval(bounds[">="], bounds["<="])
    return ", ".join(f"{sign} {_number(bound)}" for sign, bound in bounds.items())


def _interval(low: float, high: float) -> str:
    between = " to " if low < 0 else "\N{EN DASH}"
    return f"{_number(low)}{between}{_number(high)}"


def _number(value: float) -> str:
    return f"{value:,.10g}" if abs(value) < 1e15 else f"2^{math.log2(value):g}"


def table(section: type[Section], *, without: type[Section] | None = None) -> str:
    """Return a Markdown table of a section's keys, except those that `without` declares identically."""
    declared = keys_of(without) if without else []
    rows = ["| key | default (allowed) | meaning |", "|---|---|---|"]
    for key in keys_of(section):
        if key in declared:
            continue
        default = "required" if key.required else "" if key.default is None else f"`{key.default}`"
        allowed = f" (`{key.allowed}`)" if key.allowed else ""
        rows.append(f"| `{key.name}` | {(default + allowed).strip()} | {_escaped(key.meaning)} |")
    return "\n".join(rows)


def _escaped(text: str) -> str:
    """Escape Markdown's emphasis, links, and cells."""
    return re.sub(r"(\*|\||_(?=\W)|\[\[)", r"\\\1", text)


def page(text: str) -> str:
    """Return the page with the tables below its comments, such as <!-- keys of camera -->, written anew."""

    def filled(found: re.Match[str]) -> str:
        name = found[1]
        kind = Config if name == "the config" else {**sections(), **ENTRIES}[name]
        return f"<!-- keys of {name} -->\n{table(kind, without=VehicleEntry if kind is DistractorEntry else None)}\n"

    return re.sub(r"<!-- keys of ([\w ]+) -->\n(?:\|.*\n)*", filled, text)


if __name__ == "__main__":
    PAGE.write_text(page(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
