"""The schema's keys in print, for `hulldown init` and, by `python -m` with this module, docs/config.md's tables."""

from __future__ import annotations

import math
import re
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

import tomlkit
from pydantic.fields import FieldInfo
from pydantic.json_schema import JsonSchemaValue

from hulldown.plan.config.asset_sections import DistractorEntry, SceneryEntry, VehicleEntry
from hulldown.plan.config.scene_sections import RENDER_PROFILES
from hulldown.plan.config.schema import Config
from hulldown.plan.config.section import Section

CONFIG_PAGE = Path(__file__).parents[2] / "docs" / "config.md"
ENTRY_SECTIONS: Mapping[str, type[Section]] = MappingProxyType(
    {"vehicle": VehicleEntry, "distractor": DistractorEntry, "scenery": SceneryEntry}
)
_BOUND_SIGNS = {"exclusiveMinimum": ">", "minimum": ">=", "exclusiveMaximum": "<", "maximum": "<="}
_LINE_WIDTH = 120
_MAX_COMMENTED_WIDTH = 60  # a wider line has its comment above
# One of two alternatives must be given, so the first one gets a value. A detector that has seen no picture without its
# class finds it in cars (docs/study.md).
_GIVEN = MappingProxyType(
    {"budget.images_per_class": 140, "budget.background_share": 0.25, "budget.background_distractors": 1.0}
)
_PROFILE_KEYS = frozenset(f"render.{key}" for key in RENDER_PROFILES["paper"])  # a profile gives their defaults
_ASSET_LISTS = MappingProxyType({"vehicle": "vehicles", "distractor": "distractors", "scenery": "sceneries"})
_LISTED_KEYS = ("hdris", *_ASSET_LISTS.values())  # these keys of [assets] have their own format


@dataclass(frozen=True, slots=True)
class DocumentedKey:
    """A key of a section, with its default or example, range, and meaning."""

    name: str
    default: str | None  # default, example: its default as TOML, None for a key without, and the example of such a key
    example: str | None
    required: bool
    allowed: str  # its range or choices; empty if the meaning describes them
    meaning: str


def documented_section_keys(section: type[Section]) -> list[DocumentedKey]:
    """Return a section's keys, without its subsections, in the order of the schema."""
    declared = section.model_json_schema()["properties"]
    return [
        _documented_key(name, field, declared[name])
        for name, field in section.model_fields.items()
        if not (isinstance(field.annotation, type) and issubclass(field.annotation, Section))
    ]


def config_sections() -> dict[str, type[Section]]:
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


def _documented_key(name: str, field: FieldInfo, declared: JsonSchemaValue) -> DocumentedKey:
    default = None if field.is_required() or field.default is None else field.default
    return DocumentedKey(
        name=name,
        default=None if default is None or (name == "name" and default == "") else toml_value(default),
        example=toml_value(field.examples[0]) if field.examples else None,
        required=field.is_required(),
        allowed=_allowed_values_text(declared),
        meaning=" ".join((field.description or "").split()),
    )


def _allowed_values_text(declared: JsonSchemaValue) -> str:
    """Return the range or the choices in a key's JSON schema; empty for a key of several types."""
    (kind, *others) = [kind for kind in declared.get("anyOf", [declared]) if kind != {"type": "null"}]
    if others:
        return ""
    kind = kind.get("additionalProperties", kind)  # of a table's values, and of a list's numbers
    kind = kind.get("prefixItems", [kind])[0]
    if "enum" in kind:
        return ", ".join(map(toml_value, kind["enum"]))
    bounds: dict[str, float] = {sign: kind[bound] for bound, sign in _BOUND_SIGNS.items() if bound in kind}
    if bounds.keys() == {">=", "<="}:
        return _format_interval(bounds[">="], bounds["<="])
    return ", ".join(f"{sign} {_format_number(bound)}" for sign, bound in bounds.items())


def _format_interval(low: float, high: float) -> str:
    between = " to " if low < 0 else "\N{EN DASH}"
    return f"{_format_number(low)}{between}{_format_number(high)}"


def _format_number(value: float) -> str:
    return f"{value:,.10g}" if abs(value) < 1e15 else f"2^{math.log2(value):g}"


def config_text(
    *,
    vehicles: Sequence[Mapping[str, object]],
    sceneries: Sequence[Mapping[str, object]],
    hdris: Sequence[str],
    distractors: Sequence[Mapping[str, object]] = (),
    values: Mapping[str, object] = MappingProxyType({}),
    notes: Mapping[str, Sequence[str]] = MappingProxyType({}),
    proposals: Mapping[str, Mapping[str, object]] = MappingProxyType({}),
    remarks: Sequence[str] = (),
) -> str:
    """Return a config for these assets, every key explained; `notes` and `proposals` are comments by name or path."""
    given, others = {**_GIVEN, **values}, config_sections()
    of_assets = [key for key in documented_section_keys(others.pop("assets")) if key.name not in _LISTED_KEYS]
    blocks = [
        "# hulldown config. Every key has its default here, except in [budget]; delete what you don't want to change.\n"
        "# Paths are relative to this file's folder. A range is [low, high]; one number is a range of one value.\n",
        _pop_key_lines(documented_section_keys(Config), "", given),
        "[assets]\n"
        + _pop_key_lines(of_assets, "assets", given)
        + f"hdris = {_pattern_list_text(hdris, notes)}  # patterns of .exr or .hdr files: light and backdrop\n",
        *(_asset_kind_comments(kind) for kind in ENTRY_SECTIONS),
        *(
            _comment_lines(notes.get(name := str(entry.get("name", entry["path"])), ()))
            + _entry_text(f"assets.{kind}", entry)
            + _comment_lines([f"{key} = {toml_value(value)}" for key, value in proposals.get(name, {}).items()])
            for kind, listed in (("vehicles", vehicles), ("distractors", distractors), ("sceneries", sceneries))
            for entry in listed
        ),
        _comment_lines(remarks),
        *(f"[{name}]\n" + _pop_key_lines(documented_section_keys(kind), name, given) for name, kind in others.items()),
    ]
    if given:
        raise ValueError(f"values: the config has no key {min(given)!r}")
    return "\n".join(block for block in blocks if block)


def _pop_key_lines(keys: Sequence[DocumentedKey], section: str, given: dict[str, object]) -> str:
    """Return a line for each key, commented out if it has no default; used values are removed from `given`."""
    pairs = []
    for key in keys:
        path = f"{section}.{key.name}".lstrip(".")
        off = "# " if path not in given and (key.default is None or path in _PROFILE_KEYS) else ""
        value = toml_value(given.pop(path)) if path in given else key.default or key.example
        pairs.append((f"{off}{key.name} = {value}", key))
    return _align_comments(pairs)


def _align_comments(pairs: Sequence[tuple[str, DocumentedKey]]) -> str:
    """Align the comments of lines; a long comment continues on the next lines, and a long line has it above."""
    column = max((len(text) for text, _ in pairs if len(text) <= _MAX_COMMENTED_WIDTH), default=0)
    lines = []
    for text, key in pairs:
        choices = f" ({key.allowed})" if key.allowed.startswith('"') else ""
        if len(text) > column:
            lines += [f"# {line}\n" for line in textwrap.wrap(key.meaning + choices, _LINE_WIDTH - 2)] + [f"{text}\n"]
            continue
        first, *more = textwrap.wrap(key.meaning + choices, _LINE_WIDTH - column - 4)
        lines += [f"{text:<{column}}  # {first}\n", *(f"{'':<{column}}  # {line}\n" for line in more)]
    return "".join(lines)


def _asset_kind_comments(kind: str) -> str:
    keys = documented_section_keys(ENTRY_SECTIONS[kind])
    needed = " and ".join(key.name for key in keys if key.required)
    head = f"[[assets.{_ASSET_LISTS[kind]}]] is a {kind}: {needed} must be given. Optional keys:"
    if kind == "distractor":
        keys = [key for key in keys if key not in documented_section_keys(ENTRY_SECTIONS["vehicle"])]
        head = "[[assets.distractors]] is no target, such as a civilian car. It has the keys of a vehicle, and:"
    pairs = [(f"  {key.name} = {key.default or key.example or '...'}", key) for key in keys]
    return _comment_lines([head, *_align_comments([pair for pair in pairs if not pair[1].required]).splitlines()])


def _comment_lines(lines: Sequence[str], indent: str = "") -> str:
    def printable(text: str) -> str:
        return "".join(c if c.isprintable() else c.encode("unicode_escape").decode("ascii") for c in text)

    return "".join(f"{indent}# {printable(line)}\n" for line in lines)


def _pattern_list_text(patterns: Sequence[str], notes: Mapping[str, Sequence[str]]) -> str:
    """Return a list of patterns in one line, or one line per pattern if any has comments."""
    if not any(notes.get(pattern) is not None for pattern in patterns):
        return toml_value(list(patterns))
    indent = " " * 4
    lines = [f"{_comment_lines(notes.get(name, ()), indent)}{indent}{toml_value(name)},\n" for name in patterns]
    return f"[\n{''.join(lines)}]"


def _entry_text(name: str, entry: Mapping[str, object]) -> str:
    return "\n".join([f"[[{name}]]", *(f"{key} = {toml_value(value)}" for key, value in entry.items()), ""])


def example_config_text(values: Mapping[str, object] = MappingProxyType({})) -> str:
    """Return a config with the names of example files; `values` are as for `config_text`."""
    return config_text(
        vehicles=[{"path": "vehicles/tank.blend", "category": "main battle tank"}],
        sceneries=[{"path": "sceneries/hills.blend"}],
        hdris=["hdris/*.exr"],
        values=values,
    )


def key_table_markdown(section: type[Section], *, without: type[Section] | None = None) -> str:
    """Return a Markdown table of a section's keys, except those that `without` declares identically."""
    declared = documented_section_keys(without) if without else []
    rows = ["| key | default (allowed) | meaning |", "|---|---|---|"]
    for key in documented_section_keys(section):
        if key in declared:
            continue
        default = "required" if key.required else "" if key.default is None else f"`{key.default}`"
        allowed = f" (`{key.allowed}`)" if key.allowed else ""
        rows.append(f"| `{key.name}` | {(default + allowed).strip()} | {_escape_markdown(key.meaning)} |")
    return "\n".join(rows)


def _escape_markdown(text: str) -> str:
    return re.sub(r"(\*|\||_(?=\W)|\[\[)", r"\\\1", text)


def fill_key_tables(text: str) -> str:
    """Return the page with new tables below its comments, such as <!-- keys of camera -->."""

    def filled(found: re.Match[str]) -> str:
        name = found[1]
        kind = Config if name == "the config" else {**config_sections(), **ENTRY_SECTIONS}[name]
        known = VehicleEntry if kind is DistractorEntry else None
        return f"<!-- keys of {name} -->\n{key_table_markdown(kind, without=known)}\n"

    return re.sub(r"<!-- keys of ([\w ]+) -->\n(?:\|.*\n)*", filled, text)


if __name__ == "__main__":
    CONFIG_PAGE.write_text(fill_key_tables(CONFIG_PAGE.read_text(encoding="utf-8")), encoding="utf-8")
