"""A folder to start from: the demo assets and a commented config that uses them."""

from __future__ import annotations

import shutil
import warnings
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Annotated

from cyclopts import Parameter

from hulldown.base.arguments import AnyPath
from hulldown.base.errors import AssetError, ConfigError, HulldownError
from hulldown.base.files import atomic_writer
from hulldown.base.outputs import require_replaceable_file
from hulldown.base.terminal import progress_bar
from hulldown.dataset.store.document import is_hulldown_dataset
from hulldown.demo.catalog import (
    CAMOUFLAGE_MATERIALS,
    DISTRACTORS,
    LAUNCHER_CLASS,
    PLAIN_COLORS,
    SCENERY_FILES,
    TANK_CLASS,
    TRUCK_CLASS,
    VEHICLE_CLASSES,
)
from hulldown.demo.make_assets import build_demo_assets
from hulldown.plan.config.asset_sections import CACHE_NAME
from hulldown.plan.config.config_keys import config_text, example_config_text
from hulldown.planning.inputs.camera_file import read_calibration_as_config
from hulldown.planning.inputs.found_assets import (
    found_config_text,
    missing_asset_kinds,
    read_found_files,
    relative_asset_files,
    store_stated_doubts,
)
from hulldown.reading.confinement.watch import DEFAULT_LIMITS, ReadLimits

CONFIG_NAME = "hulldown.toml"
NO_KEYS: Mapping[str, object] = MappingProxyType({})  # beyond the defaults; else see `config_text`
# A look at everything in minutes on two cores: few images, small, rather near and from a standing eye's height to a
# treetop's, as photographs are taken, under the skies that suit open country in daylight.
SMALL_PLAN_KEYS = {
    "placement.distractors_per_image": [0, 2],
    "placement.distractor_distance": [0.0, 25.0],
    "budget.images_per_class": {TANK_CLASS: 4, TRUCK_CLASS: 3, LAUNCHER_CLASS: 3},
    "budget.background_share": 0.16,
    "budget.background_distractors": 0.5,
    "budget.images_per_position": 1,
    "camera.target_fraction": [0.15, 0.4],
    "camera.distance_factor": [0.6, 1.6],
    "camera.elevation_deg": [1.5, 8.0],
    "camera.framing": 0.5,
    "camera.visible_fraction": [0.6, 1.0],
    "light.hdris": ["sky_*"],
    "light.strength": [0.9, 1.2],
    "light.overcast": ["sky_overcast"],
    # So that of the few images one has fog, one rain, one snow and one dust.
    "weather.fog": 0.3,
    "weather.rain": 0.04,
    "weather.snow": 0.06,
    "weather.dust": 0.08,
    "weather.visibility_m": [150.0, 300.0],
    "weather.rain_mm_h": [15.0, 30.0],
    "weather.snow_visibility_m": [200.0, 400.0],
    "weather.dust_visibility_m": [150.0, 300.0],
    "weather.min_contrast": 0.3,
    "render.profile": "fast",
    "render.width": 480,
    "render.height": 270,
}
# From the air: a drone's camera, oblique to straight down, at any heading.
AERIAL_KEYS = {
    "camera.elevation_deg": [45.0, 90.0],
    "camera.elevation_sampling": "sphere",
    "camera.roll_deg": [-180.0, 180.0],
    # A twentieth of the image's height at 90 m or so, times this: uniform from 30 to 300 m.
    "camera.target_fraction": [0.045, 0.055],
    "camera.distance_factor": [0.3, 3.6],
    "camera.distance_m": [30.0, 300.0],
    "camera.framing": 1.0,
    "placement.vehicles_per_image": [1, 5],
    "placement.companion_distance": [8.0, 60.0],
    "placement.distractor_distance": [8.0, 60.0],
}


def write_config_text(folder: Path, text: str) -> Path:
    """Write a config into `folder`, and return its path."""
    config = folder / CONFIG_NAME
    refuse_existing_config(config)
    with atomic_writer(config) as file:
        file.write(text.encode())
    return config


def refuse_existing_config(config: Path) -> None:
    """Raise ConfigError if there is a config, which is the user's, or a dataset."""
    if is_hulldown_dataset(config.parent):
        raise ConfigError("is a dataset", path=config.parent, remedy="name another folder")
    if config.exists():
        raise ConfigError("is there already", path=config, remedy="delete it or name another folder")


def create_project(
    folder: AnyPath,
    *,
    seed: int = 0,
    small: bool = False,
    bare: bool = False,
    source: Annotated[AnyPath | None, Parameter(name="--from")] = None,
    aerial: bool = False,
    camera: AnyPath | None = None,
    limits: ReadLimits = DEFAULT_LIMITS,
) -> Path:
    """Start a project.

    Writes hulldown.toml, commented, and demo vehicles, sceneries, and HDRIs; or a config of your own files.

    Parameters
    ----------
    folder
        The folder to write into; existing files are kept.
    seed
        Seed of the demo assets.
    small
        A config for 12 small images instead of a whole dataset.
    bare
        Only the config, for your own files; no demo assets.
    source
        Only the config, with the vehicles, sceneries, and HDRIs in this folder.
    aerial
        Cameras of a drone: 45 degrees down to straight down, at 30 to 300 m.
    camera
        A camera's calibration by OpenCV or ROS (.yaml, .yml, .json) for the config.
    limits
        Time and memory for reading an asset.

    Returns
    -------
    The config's path.
    """
    folder = Path(folder)
    if bare + small + (source is not None) > 1:
        raise HulldownError("--bare, --small, and --from exclude each other", remedy="give one of them")
    values = {**(AERIAL_KEYS if aerial else {}), **(read_calibration_as_config(Path(camera)) if camera else {})}
    if source is not None:
        return _create_project_from_files(Path(source), folder, values, limits)
    refuse_existing_config(folder / CONFIG_NAME)
    require_replaceable_file(folder / CONFIG_NAME, "a config")
    if bare:
        return write_config_text(folder, example_config_text(values))
    with progress_bar("building demo assets") as advance:
        build_demo_assets(folder, seed=seed, progress=advance)
    return write_config_text(folder, demo_config_text(small=small, values=values))


def _create_project_from_files(source: Path, folder: Path, values: Mapping[str, object], limits: ReadLimits) -> Path:
    refuse_existing_config(folder / CONFIG_NAME)
    files = relative_asset_files(source)
    cache, new = folder / CACHE_NAME, not folder.exists()
    try:
        found = read_found_files(source, files, cache, limits=limits)
    except AssetError:
        if new and cache.is_dir():
            shutil.rmtree(cache)
            folder.rmdir()
        raise
    require_replaceable_file(folder / CONFIG_NAME, "a config")
    config = write_config_text(folder, found_config_text(source, found, folder, values))
    store_stated_doubts(found, source, config, cache)
    for word in missing_asset_kinds(found):
        warnings.warn(f"no {word} was found in {source}; name one in {config}", stacklevel=2)
    if unused := len(files) - len({file.path for file in found if file.kind}):
        warnings.warn(f"{unused} of {len(files)} files aren't used, see the reasons in {config}", stacklevel=2)
    return config


def demo_config_text(*, small: bool = False, values: Mapping[str, object] = NO_KEYS) -> str:
    """Return the config that `create_project` writes."""
    return config_text(
        vehicles=[
            {
                "path": f"vehicles/{name}.blend",
                "category": category,
                "paint": [{"materials": [CAMOUFLAGE_MATERIALS.get(name, "Camouflage")], "colors": PLAIN_COLORS}],
            }
            for name, category in VEHICLE_CLASSES.items()
        ],
        distractors=[{"path": f"distractors/{name}.blend", **keys} for name, keys in DISTRACTORS.items()],
        sceneries=[{"path": path} for path in SCENERY_FILES],
        hdris=["hdris/sky_*.exr", "hdris/sunrise.exr"],  # the others show a street, a wood, a quay
        values={**(SMALL_PLAN_KEYS if small else {}), **values},
    )
