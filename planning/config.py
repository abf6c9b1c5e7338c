"""Reading a config file: TOML in, a checked `Config` out, every mistake named with its key and what is allowed."""

from __future__ import annotations

import difflib
import tomllib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, get_args

from pydantic import ValidationError

from geometry.errors import ConfigError, shown
from planning.schema import Config, Section

HDRI_SUFFIXES = (".exr", ".hdr")

__all__ = ["Config", "hdri_paths", "load_config", "parse_config"]


def load_config(path: str | Path) -> Config:
    """The config in a TOML file, complete with defaults.

    Raises
    ------
    ConfigError
        Naming file, key, value and what is allowed.
    """
    path = Path(path)
    try:
        data = tomllib.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise ConfigError("no such file", path=path, remedy="`hulldown init` writes one to start from") from None
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"cannot be read: {error}", path=path) from None
    except (ValueError, RecursionError) as error:  # integers of 5,000 digits and lists of 1,000 lists are not its own
        raise ConfigError(f"is no TOML: {error}", path=path) from None
    return parse_config(data, path=path)


def parse_config(data: Mapping[str, Any], *, path: Path | None = None) -> Config:
    """The config in nested dictionaries, as TOML or a plan's header holds them.

    Raises
    ------
    ConfigError
        Naming file, key, value and what is allowed.
    """
    try:
        config = Config.model_validate(dict(data))
    except ValidationError as error:
        first, *more = error.errors(include_url=False)
        tail = f" (and {len(more)} more)" if more else ""
        raise ConfigError(_explained(dict(first)) + tail, path=path) from None
    return config.read_from(path)


# What pydantic says in words of Python, in words of TOML.
_ALLOWED = {
    "too_short": "expected at least one",
    "tuple_type": "expected a list",
    "model_type": "expected a table",
    "model_attributes_type": "expected a table",
    "string_type": "expected a string",
    "bool_type": "expected true or false",
    "int_type": "expected a whole number",
    "int_from_float": "expected a whole number",
    "float_type": "expected a number",
}


def _explained(error: Mapping[str, Any]) -> str:
    """One line for one of pydantic's errors: key, value, what is allowed."""
    steps = [s for s in error["loc"] if not (isinstance(s, str) and ("[" in s or s in ("int", "dict")))]
    key = "".join(f"[{s}]" if isinstance(s, int) else f".{s}" for s in steps).lstrip(".")
    if error["type"] == "extra_forbidden":
        section = [s for s in steps[:-1] if isinstance(s, str)]
        near = _nearest(str(steps[-1]), section)
        hint = f"did you mean {near}?" if near else f"known here: {', '.join(sorted(_fields(section)))}"
        return f"unknown key {key}; {hint}"
    if error["type"] == "missing":
        return f"{key} is missing" if key else "is empty"
    allowed = _ALLOWED.get(error["type"]) or error["msg"].removeprefix("Value error, ")
    allowed = allowed.replace("Input should be", "expected").replace("String should have", "expected")
    value = "" if isinstance(error["input"], dict) else f" = {shown(error['input'])}"
    return f"{key}{value}: {allowed}" if key else allowed


def _models(annotation: Any) -> Iterator[type[Section]]:
    if isinstance(annotation, type) and issubclass(annotation, Section):
        yield annotation
    for inner in get_args(annotation):
        yield from _models(inner)


def _fields(section: list[str]) -> list[str]:
    """Keys known in a section, given the names that lead to it."""
    model: type[Section] = Config
    for name in section:
        model = next(_models(model.model_fields[name].annotation), model)
    return list(model.model_fields)


def _nearest(name: str, section: list[str]) -> str | None:
    """The known key most like `name`: in its own section if there is one, else anywhere, with its section."""
    if near := difflib.get_close_matches(name, _fields(section), n=1):
        return ".".join([*section, near[0]])
    elsewhere = {
        key: top
        for top in Config.model_fields
        for key in (_fields([top]) if list(_models(Config.model_fields[top].annotation)) else [])
    }
    if near := difflib.get_close_matches(name, elsewhere, n=1, cutoff=0.8):
        return f"{elsewhere[near[0]]}.{near[0]}"
    return None


def hdri_paths(config: Config) -> dict[str, Path]:
    """Name and path of every HDRI that `assets.hdris` matches, in the order of the patterns, then by name.

    Raises
    ------
    ConfigError
        If a pattern matches no file, or two files would have one name.
    """
    found: dict[str, Path] = {}
    for pattern in config.assets.hdris:
        folder = Path(Path(pattern).anchor) if Path(pattern).is_absolute() else config.folder
        relative = str(Path(pattern).relative_to(folder)) if Path(pattern).is_absolute() else pattern
        try:
            matches = sorted(p for p in folder.glob(relative) if p.is_file())
        except (ValueError, NotImplementedError, OSError) as error:
            raise ConfigError(f"assets.hdris: {pattern!r} is no pattern of files ({error})", path=config.path) from None
        if wrong := [match.name for match in matches if match.suffix.lower() not in HDRI_SUFFIXES]:
            raise ConfigError(
                f"assets.hdris: {pattern!r} matches {wrong[0]!r}, which is no {' or '.join(HDRI_SUFFIXES)} file",
                path=config.path,
                remedy="narrow the pattern, such as 'hdris/*.exr'",
            )
        if not matches:
            raise ConfigError(
                f"assets.hdris: {pattern!r} matches no file in {folder}",
                path=config.path,
                remedy="put .exr or .hdr files there or change the pattern",
            )
        for match in matches:
            if found.setdefault(match.stem, match) != match:
                raise ConfigError(
                    f"assets.hdris: {found[match.stem]} and {match} have one name",
                    path=config.path,
                    remedy="rename one of them",
                )
    return found
