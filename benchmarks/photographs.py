"""`make photographs`: what renders of the demo's tanks are worth beside photographs of tanks.

Writes demo assets, a config of renders that follow the photographs, and a study's config into a folder. The
photographs aren't part of the project.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from hulldown.base.files import replacing
from hulldown.demo.catalog import CAMOUFLAGE, CATEGORY, PAINT, SCENERY_FILES, TANK
from hulldown.demo.make_assets import FILES, build_demo_assets
from hulldown.planning.config.template import config_text

LABEL = "tank"  # their class in the photographs
RENDERS = 72
NEEDS = """\
make photographs needs labeled photographs of tanks, in COCO folders `train` and `dev`; {lacking} is missing.
Name their folder with PHOTOGRAPHS=DIR. The photographs behind the figures in docs/study.md are from Open Images, with
boxes of the class Tank: 120 to train on, 200 to test on, 60 of which show other vehicles alone."""
STUDY = """\
# Written by `make photographs`. What renders are worth beside photographs of tanks; see docs/study.md.
real = {train}
synthetic = "renders"
test = {test}
arms = ["real", "mixed", "synthetic"]
fractions = [1.0, 0.25, 0.1, 0.05]
seeds = [0, 1, 2]

[train]
model = "small"
budget = 800
resolution = 192
{weights}"""


def renders_text(photographs: Path) -> str:
    """The config of renders that follow the boxes of photographs, taken by a person who stands."""
    vehicles = [
        {
            "path": f"vehicles/{name}.blend",
            "category": LABEL,
            "paint": [{"materials": [CAMOUFLAGE.get(name, "Camouflage")], **PAINT}],
        }
        for name, category in CATEGORY.items()
        if category == TANK
    ]
    others = [f"distractors/{name}.blend" for name in ("civilian_car", "panel_van", "container")]
    return config_text(
        vehicles=vehicles,
        distractors=[{"path": path} for path in (*others, "vehicles/truck_cargo.blend")],
        sceneries=[{"path": path} for path in SCENERY_FILES],
        hdris=["hdris/sky_*.exr", "hdris/sunrise.exr"],
        values={
            "budget.images_per_class": RENDERS,
            "budget.images_per_position": 1,
            "placement.vehicles_per_image": [1, 3],
            "placement.distractors_per_image": [0, 2],
            "camera.like": str(photographs),
            "camera.like_share": 1.0,
            "camera.elevation_deg": [0.5, 6.0],
            "camera.fov_x_deg": [30.0, 60.0],
            "camera.truncated_fraction": [0.0, 0.5],
            "camera.visible_fraction": [0.5, 1.0],
            "render.profile": "train",
            "render.width": 320,
            "render.height": 240,
            "render.samples": 4,
        },
    )


def main() -> None:
    """Write what the study needs; files that are there stay."""
    parser = argparse.ArgumentParser(prog="python -m hulldown.benchmarks.photographs", description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("photographs", type=Path, help="folder of the COCO folders train and dev")
    parser.add_argument("--weights", type=Path, help="of the backbone; default: torchvision's download")
    arguments = parser.parse_args()
    folder, (train, test) = arguments.folder, (arguments.photographs.resolve() / name for name in ("train", "dev"))
    for needed in (train, test, *([arguments.weights] if arguments.weights else [])):
        if not needed.exists():
            parser.exit(2, NEEDS.format(lacking=needed) + "\n")
    if not all((folder / file).exists() for file in FILES):
        build_demo_assets(folder)
    weights = f"weights = {json.dumps(str(arguments.weights.resolve()))}\n" if arguments.weights else ""
    study = STUDY.format(train=json.dumps(str(train)), test=json.dumps(str(test)), weights=weights)
    for name, text in (("renders.toml", renders_text(train)), ("study.toml", study)):
        if not (folder / name).exists():
            with replacing(folder / name) as file:
                file.write(text.encode())
    print(f"wrote {folder / 'renders.toml'} and {folder / 'study.toml'}")


if __name__ == "__main__":
    main()
