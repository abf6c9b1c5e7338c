"""A folder to start from: the demo assets and a commented config that uses them."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

from geometry.errors import ConfigError
from planning.template import config_text
from render.demo.build import build_demo_assets
from render.demo.catalogue import CATEGORY, SCENERY_FILES

CONFIG = "hulldown.toml"


def create_project(
    folder: Path | str, *, seed: int = 0, progress: Callable[[int, int], None] | None = None, images_per_class: int = 4
) -> Path:
    """Path of the config written into `folder`, beside the demo assets.

    Parameters
    ----------
    folder
        Where to; made if it is not there.
    seed
        Of the demo assets.
    progress
        Called with the files done and their total.
    images_per_class
        The budget that the config asks for.

    Raises
    ------
    ConfigError
        If the folder has a config already; it is the user's and stays as it is.
    """
    folder = Path(folder)
    config = folder / CONFIG
    if config.exists():
        raise ConfigError("is there already", path=config, remedy="delete it or name another folder")
    build_demo_assets(folder, seed=seed, progress=progress)
    text = config_text(
        vehicles=[{"path": f"vehicles/{name}.blend", "category": category} for name, category in CATEGORY.items()],
        sceneries=[{"path": path} for path in SCENERY_FILES],
        hdris=["hdris/*.exr"],
        images_per_class=images_per_class,
    )
    partial = config.with_name(f".{CONFIG}.partial")
    partial.write_text(text, encoding="utf-8")
    os.replace(partial, config)
    return config
