"""Reading a config file: TOML in, a checked `Config` out, every mistake named with its key and what is allowed."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from hulldown.geometry.errors import ConfigError
from hulldown.geometry.toml_files import read_toml, validated
from hulldown.planning.config.schema import Config

HDRI_SUFFIXES = (".exr", ".hdr")

__all__ = ["Config", "hdri_paths", "load_config", "parse_config"]


def load_config(path: str | os.PathLike[str]) -> Config:
    """The config in a TOML file, complete with defaults.

    Raises
    ------
    ConfigError
        Naming file, key, value and what is allowed.
    """
    path = Path(path)
    return parse_config(read_toml(path, remedy="`hulldown init` writes one to start from"), path=path)


def parse_config(data: Mapping[str, Any], *, path: Path | None = None) -> Config:
    """The config in nested dictionaries, as TOML or a plan's header holds them.

    Raises
    ------
    ConfigError
        Naming file, key, value and what is allowed.
    """
    return validated(Config, data, path).read_from(path)


def hdri_paths(config: Config) -> dict[str, Path]:
    """Name and path of every HDRI that `assets.hdris` matches, in the order of the patterns, then by name.

    Raises
    ------
    ConfigError
        If a pattern matches no file, or two files would have the same name.
    """
    found: dict[str, Path] = {}
    for pattern in config.assets.hdris:
        folder = Path(Path(pattern).anchor) if Path(pattern).is_absolute() else config.folder
        relative = str(Path(pattern).relative_to(folder)) if Path(pattern).is_absolute() else pattern
        try:
            matches = sorted(p for p in folder.glob(relative) if p.is_file())
        except (ValueError, NotImplementedError, OSError) as error:
            raise ConfigError(f"assets.hdris: {pattern!r} isn't a file pattern ({error})", path=config.path) from None
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
                    f"assets.hdris: {found[match.stem]} and {match} have the same name",
                    path=config.path,
                    remedy="rename one of them",
                )
    return found
