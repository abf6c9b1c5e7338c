"""The config that `hulldown init` writes: every key with its default, its meaning, and its allowed values."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from types import MappingProxyType

from hulldown.planning.config.config_keys import ENTRIES, Key, keys_of, sections, toml_value
from hulldown.planning.config.render_section import PROFILES
from hulldown.planning.config.schema import Config

_WIDTH = 120
_LONGEST = 60  # of a line with a comment beside it
# One of two alternatives must be given, so the first one gets a value.
_GIVEN = MappingProxyType({"budget.images_per_class": 140})

# A profile gives defaults for these keys.
_BY_PROFILE = MappingProxyType({"render": tuple(PROFILES["paper"])})
_LISTS = MappingProxyType({"vehicle": "vehicles", "distractor": "distractors", "scenery": "sceneries"})
_LISTED = ("hdris", *_LISTS.values())  # keys of [assets] that get their own format


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
    """Return a complete config for these assets, with a comment on every key.

    `notes` and `proposals` are comments above an asset's entry and keys that are commented out below it, by its name or
    path.
    """
    given = {**_GIVEN, **values}
    blocks = [
        "# hulldown config. Every key has its default here; delete what you don't want to change.\n"
        "# Paths are relative to this file's folder. A range is [low, high]; one number is a range of one value.\n",
        _lines(keys_of(Config), "", given),
        "[assets]\n"
        + _lines([key for key in keys_of(sections()["assets"]) if key.name not in _LISTED], "assets", given)
        + f"hdris = {_patterns(hdris, notes)}  # patterns of .exr or .hdr files: light and backdrop\n",
        *(_comment_on(kind) for kind in ENTRIES),
        *(
            _comments(notes.get(name := str(entry.get("name", entry["path"])), ()))
            + _table(f"assets.{kind}", entry)
            + _comments([f"{key} = {toml_value(value)}" for key, value in proposals.get(name, {}).items()])
            for kind, listed in (("vehicles", vehicles), ("distractors", distractors), ("sceneries", sceneries))
            for entry in listed
        ),
        _comments(remarks),
        *(f"[{name}]\n" + _lines(keys_of(kind), name, given) for name, kind in sections().items() if name != "assets"),
    ]
    if given:
        raise ValueError(f"values: the config has no key {min(given)!r}")
    return "\n".join(block for block in blocks if block)


def _lines(keys: Sequence[Key], section: str, given: dict[str, object]) -> str:
    """Return a line for each key, commented out if it has no default; removes the values it uses from `given`."""
    pairs = []
    for key in keys:
        path = f"{section}.{key.name}".lstrip(".")
        by_profile = key.name in _BY_PROFILE.get(section, ())
        off = "# " if path not in given and (key.default is None or by_profile) else ""
        value = toml_value(given.pop(path)) if path in given else key.default or key.example
        pairs.append((f"{off}{key.name} = {value}", key))
    return _aligned(pairs)


def _aligned(pairs: Sequence[tuple[str, Key]]) -> str:
    """Align the comments of lines; a long comment continues on the next lines, and a long line has it above."""
    column = max((len(text) for text, _ in pairs if len(text) <= _LONGEST), default=0)
    lines = []
    for text, key in pairs:
        choices = f" ({key.allowed})" if key.allowed.startswith('"') else ""
        if len(text) > column:
            lines += [f"# {line}\n" for line in textwrap.wrap(key.meaning + choices, _WIDTH - 2)] + [f"{text}\n"]
            continue
        first, *more = textwrap.wrap(key.meaning + choices, _WIDTH - column - 4)
        lines += [f"{text:<{column}}  # {first}\n", *(f"{'':<{column}}  # {line}\n" for line in more)]
    return "".join(lines)


def _comment_on(kind: str) -> str:
    """Return the keys of a kind of table as comments."""
    keys = keys_of(ENTRIES[kind])
    head = f"A table of {kind}:"
    if kind in _LISTS:
        needed = " and ".join(key.name for key in keys if key.required)
        head = f"[[assets.{_LISTS[kind]}]] is a {kind}: {needed} must be given. Optional keys:"
    if kind == "distractor":
        keys = [key for key in keys if key not in keys_of(ENTRIES["vehicle"])]
        head = "[[assets.distractors]] is no target, such as a civilian car. It has the keys of a vehicle, and:"
    pairs = [(f"  {key.name} = {key.default or key.example or '...'}", key) for key in keys]
    return _comments([head, *_aligned([pair for pair in pairs if not pair[1].required]).splitlines()])


def _comments(lines: Sequence[str], indent: str = "") -> str:
    """Return each line as a comment, with unprintable characters escaped."""

    def printable(text: str) -> str:
        return "".join(c if c.isprintable() else c.encode("unicode_escape").decode("ascii") for c in text)

    return "".join(f"{indent}# {printable(line)}\n" for line in lines)


def _patterns(patterns: Sequence[str], notes: Mapping[str, Sequence[str]]) -> str:
    """Return a list of patterns in one line, or one line per pattern if any has comments."""
    if not any(notes.get(pattern) is not None for pattern in patterns):
        return toml_value(list(patterns))
    indent = " " * 4
    lines = [f"{_comments(notes.get(name, ()), indent)}{indent}{toml_value(name)},\n" for name in patterns]
    return f"[\n{''.join(lines)}]"


def _table(name: str, entry: Mapping[str, object]) -> str:
    return "\n".join([f"[[{name}]]", *(f"{key} = {toml_value(value)}" for key, value in entry.items()), ""])


def bare_text(values: Mapping[str, object] = MappingProxyType({})) -> str:
    """Return a config with the names of example files; `values` as in `config_text`."""
    return config_text(
        vehicles=[{"path": "vehicles/tank.blend", "category": "main battle tank"}],
        sceneries=[{"path": "sceneries/hills.blend"}],
        hdris=["hdris/*.exr"],
        values=values,
    )
