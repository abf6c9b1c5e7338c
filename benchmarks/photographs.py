"""`make photographs SET=tanks`: the worth of renders of the demo's vehicles beside photographs.

Writes demo assets, a config of renders that follow the photographs, and a study's config into a folder. The
photographs aren't part of the project.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hulldown.base.files import atomic_writer
from hulldown.demo.catalog import (
    CAMOUFLAGE_MATERIALS,
    CAR_COLORS,
    CIVILIAN_FILES,
    CIVILIAN_NAMES,
    PLAIN_COLORS,
    SCENERY_FILES,
    TANK_CLASS,
    VEHICLE_CLASSES,
)
from hulldown.demo.make_assets import ASSET_FILES, build_demo_assets
from hulldown.plan.config.config_keys import config_text

TOWNS = ("sceneries/town_1.blend", "sceneries/town_2.blend")
CAR_PAINT = [{"materials": ["Paint"], "colors": ["own", *CAR_COLORS, "#e6e6e4", "#f2f2f0", "#1a1b1e", "#a7abb0", "#9b1c1a"]}]
NEEDS = """\
make photographs needs labeled photographs in COCO folders `train` and `dev`; {lacking} is missing.
Name their folder with PHOTOGRAPHS=DIR. Those behind the figures in docs/study.md are 320 photographs from Open Images
with boxes of the class Tank, and 178 tiles of aerial photographs of streets (KIT AIS and Minsk) with boxes of vehicles.
"""
STUDY = """\
# Written by `make photographs`. What renders are worth beside photographs of {name}; see docs/study.md.
real = {train}
synthetic = "renders"
test = {test}
fractions = {fractions}
seeds = [0, 1, 2]

[train]
model = "small"
budget = 800
resolution = {resolution}
{train_keys}"""


@dataclass(frozen=True, slots=True)
class Photographed:
    """A set of photographs: the assets and config keys of renders that follow it, and its study.

    Parameters
    ----------
    vehicles, distractors
        Entries of a config.
    sceneries, hdris
        Files, and patterns of files.
    values
        Keys of the config.
    fractions, resolution, train_keys
        Of the study: shares of the photographs, pixels, and further lines.
    """

    vehicles: list[dict[str, Any]]
    distractors: list[dict[str, Any]]
    sceneries: tuple[str, ...]
    hdris: list[str]
    values: Mapping[str, Any]
    fractions: list[float]
    resolution: int
    train_keys: str = ""


def _car(name: str, **keys: object) -> dict[str, Any]:
    """Return one of the demo's civilian vehicles in the colors of cars."""
    return {"path": f"distractors/{name}.blend", "paint": CAR_PAINT, **keys}


SETS = {
    "tanks": Photographed(  # taken by persons who stand
        vehicles=[
            {
                "path": f"vehicles/{name}.blend",
                "category": "tank",
                "paint": [{"materials": [CAMOUFLAGE_MATERIALS.get(name, "Camouflage")], "colors": PLAIN_COLORS}],
            }
            for name, category in VEHICLE_CLASSES.items()
            if category == TANK_CLASS
        ],
        distractors=[
            *map(_car, ("civilian_car", "panel_van", *CIVILIAN_NAMES)),
            {"path": "distractors/container.blend"},
            {"path": "vehicles/truck_cargo.blend"},
        ],
        sceneries=SCENERY_FILES,
        hdris=["hdris/sky_*.exr", "hdris/sunrise.exr"],
        values={
            "budget.images_per_class": 72,
            "budget.background_share": 0.4,
            "budget.background_distractors": 1.0,
            "placement.vehicles_per_image": [1, 3],
            "placement.distractors_per_image": [0, 2],
            "camera.elevation_deg": [0.5, 6.0],
            "render.width": 320,
            "render.height": 240,
        },
        fractions=[1.0, 0.25, 0.1, 0.05],
        resolution=320,
    ),
    "cars": Photographed(  # from above
        vehicles=[_car("civilian_car", category="vehicle", weight=3.0), _car("panel_van", category="vehicle")],
        distractors=[],
        sceneries=TOWNS,
        hdris=["hdris/sky_*.exr"],
        values={
            "budget.images_per_class": 96,
            "budget.background_share": 0.2,
            "placement.vehicles_per_image": [3, 9],
            "placement.companion_distance": [3.0, 30.0],
            "placement.vehicle_clearance": 0.6,
            "placement.distractors_per_image": [0, 0],
            "camera.elevation_deg": [40.0, 89.0],
            "render.width": 480,
            "render.height": 270,
        },
        fractions=[1.0, 0.25, 0.0625],
        resolution=320,
        train_keys='augmentation = "aerial"\n',
    ),
}
SHARED = {
    "budget.images_per_position": 1,
    "camera.like_share": 1.0,
    "camera.fov_x_deg": [30.0, 60.0],
    "camera.truncated_fraction": [0.0, 0.5],
    "camera.visible_fraction": [0.5, 1.0],
    "render.profile": "train",
    "render.samples": 4,
}


def renders_text(shown: Photographed, photographs: Path) -> str:
    """Return the config of renders that follow the boxes of photographs."""
    return config_text(
        vehicles=shown.vehicles,
        distractors=shown.distractors,
        sceneries=[{"path": path} for path in shown.sceneries],
        hdris=shown.hdris,
        values={**SHARED, **shown.values, "camera.like": str(photographs)},
    )


def main() -> None:
    """Write the files of the study that are missing."""
    parser = argparse.ArgumentParser(prog="python -m hulldown.benchmarks.photographs", description=__doc__)
    parser.add_argument("set", choices=sorted(SETS))
    parser.add_argument("folder", type=Path)
    parser.add_argument("photographs", type=Path, help="folder of the COCO folders train and dev")
    parser.add_argument("--weights", type=Path, help="a folder to start from; default: from the Hugging Face hub")
    arguments = parser.parse_args()
    folder, shown = arguments.folder, SETS[arguments.set]
    train, test = (arguments.photographs.resolve() / name for name in ("train", "dev"))
    for needed in (train, test, *([arguments.weights] if arguments.weights else [])):
        if not needed.exists():
            parser.exit(2, NEEDS.format(lacking=needed))
    build_demo_assets(folder, files=(*ASSET_FILES, *CIVILIAN_FILES))
    for seed, file in enumerate(TOWNS):
        if file in shown.sceneries and not (folder / file).exists():
            town = [sys.executable, "-P", "-m", "hulldown.benchmarks.town", str(folder / file), str(seed)]
            subprocess.run(town, check=True, stdout=subprocess.DEVNULL)
    weights = f"weights = {json.dumps(str(arguments.weights.resolve()))}\n" if arguments.weights else ""
    study = STUDY.format(
        name=arguments.set,
        train=json.dumps(str(train)),
        test=json.dumps(str(test)),
        fractions=shown.fractions,
        resolution=shown.resolution,
        train_keys=shown.train_keys + weights,
    )
    for name, text in (("renders.toml", renders_text(shown, train)), ("study.toml", study)):
        if not (folder / name).exists():
            with atomic_writer(folder / name) as file:
                file.write(text.encode())
    print(f"wrote {folder / 'renders.toml'} and {folder / 'study.toml'}")


if __name__ == "__main__":
    main()
