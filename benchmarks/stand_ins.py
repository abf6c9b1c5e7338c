"""`python -m hulldown.benchmarks.stand_ins FOLDER`: make the datasets that `make study` compares.

They're synthetic images, and stand-ins for photographs. The stand-ins are renders too, of other vehicles, sceneries,
and skies, from a standing person's eye height, then exposed wrongly, blurred, noisy, and compressed. How this gap
compares with that to real photographs isn't known.
"""

from __future__ import annotations

import argparse
import io
import os
import shutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import orjson
from jaxtyping import UInt8
from PIL import Image, ImageFilter

from hulldown.annotate.record_fields import PICTURE_HASH_KEY
from hulldown.base.files import atomic_writer
from hulldown.dataset.exports.export import export_dataset
from hulldown.dataset.exports.split import SPLIT_NAMES
from hulldown.dataset.store.document import COCO_NAME, read_coco
from hulldown.demo.catalog import VEHICLE_CLASSES
from hulldown.demo.make_assets import build_demo_assets
from hulldown.plan.config.config_keys import config_text
from hulldown.plan.config.schema import Config
from hulldown.plan.library import load_library
from hulldown.planning.write import write_plan
from hulldown.render.supervisor import RenderProgress, render_remaining_images

SAMPLES_PER_PIXEL = 6  # rays a pixel, denoised
SHARES = (0.5, 0.15, 0.35)  # of the stand-ins: to train on, to choose a threshold on, to test on


@dataclass(frozen=True, slots=True)
class Side:
    """One half of the demo's assets, and what is rendered of it.

    Parameters
    ----------
    name
        Of its config, plan and dataset.
    vehicles, scenery, hdris
        Names of the catalog.
    images_per_class
        How many to render.
    seed
        Of its plan.
    values
        Further keys of its config.
    """

    name: str
    vehicles: Sequence[str]
    scenery: str
    hdris: Sequence[str]
    images_per_class: int
    seed: int
    values: Mapping[str, Any] = field(default_factory=dict)


# Both: large clear targets, so that a small detector learns from few pictures in minutes.
SHARED = {
    "camera.size_measure": "height",
    "camera.target_fraction": [0.25, 0.6],
    "camera.framing": 0.6,
    "camera.visible_fraction": [0.7, 1.0],
    "budget.images_per_position": 2,
    "budget.background_share": 0.0,
    "render.profile": "fast",
    "render.width": 256,
    "render.height": 144,
}
STAND_INS = Side(
    "stand-ins",
    ("mbt_wedge", "mbt_dome", "truck_cargo", "sam_canister"),
    "temperate_hills",
    ("forest", "sunset", "sky_morning", "sky_overcast"),
    72,
    1,
    {"camera.elevation_deg": [1.5, 10.0], "camera.fov_x_deg": [35.0, 50.0]},
)
SYNTHETIC = Side(
    "synthetic",
    ("mbt_slab", "mbt_classic", "truck_canvas", "truck_tanker", "sam_rails", "sam_turret"),
    "dry_steppe",
    ("city", "sunrise", "sky_noon", "sky_evening"),
    24,
    0,
    {"camera.elevation_deg": [3.0, 20.0], "camera.fov_x_deg": [40.0, 60.0]},
)


def write_side(side: Side, folder: Path) -> Path:
    """Write the config of one half into the folder of the demo's assets."""
    text = config_text(
        vehicles=[{"path": f"vehicles/{name}.blend", "category": VEHICLE_CLASSES[name]} for name in side.vehicles],
        sceneries=[{"path": f"sceneries/{side.scenery}.blend"}],
        hdris=[f"hdris/{name}.exr" for name in side.hdris],
        values={
            **SHARED,
            "seed": side.seed,
            "render.samples": SAMPLES_PER_PIXEL,
            "budget.images_per_class": side.images_per_class,
            **side.values,
        },
    )
    path = folder / f"{side.name}.toml"
    with atomic_writer(path) as file:
        file.write(text.encode())
    return path


def make_side(side: Side, folder: Path) -> Path:
    """Plan and render one half as far as it isn't there; return its dataset."""
    plan, dataset = folder / f"{side.name}.jsonl", folder / side.name
    if not plan.exists():
        config = Config.read(write_side(side, folder))
        workers = os.cpu_count() or 1
        write_plan(config, load_library(config).assets, plan, workers=workers, progress=_say(side.name))
    if not render_remaining_images(plan, dataset, progress=_rendered(side)).complete:
        raise SystemExit(f"{dataset}: not all images could be rendered; see failures.jsonl there")
    return dataset


def photographed(picture: UInt8[np.ndarray, "h w 3"], *, rng: np.random.Generator) -> bytes:
    """Return a JPEG of a render as by a poor camera: exposure, white balance, focus, noise, compression."""
    light = (picture / 255.0) ** 2.2 * 2.0 ** rng.normal(0.0, 0.6) * np.exp(rng.normal(0.0, 0.06, 3))
    electrons = rng.uniform(150.0, 1500.0)  # of a full pixel: few in poor light
    light = rng.poisson(np.clip(light, 0.0, 1.0) * electrons) / electrons + rng.normal(0.0, 0.004, light.shape)
    values = (np.clip(light, 0.0, 1.0) ** (1 / 2.2) * 255.0).round().astype(np.uint8)
    file = io.BytesIO()
    blurred = Image.fromarray(values).filter(ImageFilter.GaussianBlur(rng.uniform(0.2, 0.8)))
    blurred.save(file, "JPEG", quality=int(rng.integers(40, 85)))
    return file.getvalue()


def write_stand_ins(dataset: Path, out: Path, shares: tuple[float, float, float] = SHARES) -> None:
    """Train, valid and test folders of a dataset's images as stand-ins for photographs; no position is in two."""
    unfinished = out.with_name(f"{out.name}.unfinished")
    shutil.rmtree(unfinished, ignore_errors=True)
    export_dataset(dataset, unfinished, layout="coco", fractions=shares)
    for split in SPLIT_NAMES:
        coco = read_coco(unfinished / split)
        images = []
        for image in coco["images"]:
            path = unfinished / split / image["file_name"]
            with Image.open(path) as picture:
                taken = photographed(np.asarray(picture.convert("RGB")), rng=np.random.default_rng([7, image["id"]]))
            path.unlink()  # it is a link to the render
            path.with_suffix(".jpg").write_bytes(taken)
            bare = {key: value for key, value in image.items() if key != PICTURE_HASH_KEY}
            images.append({**bare, "file_name": path.with_suffix(".jpg").name})
        (unfinished / split / COCO_NAME).write_bytes(orjson.dumps({**coco, "images": images}))
    unfinished.rename(out)


DATA = """\
real = "stand-in-photographs/train"
synthetic = "synthetic"
test = "stand-in-photographs/test"
valid = "stand-in-photographs/valid"
stratified = true
"""
STUDIES = {
    "study.toml": f"""\
# A small study on the CPU: see docs/study.md. Its "photographs" are stand-ins: renders of other assets, made worse.
{DATA}arms = ["real", "mixed", "synthetic"]
fractions = [1.0, 0.25, 0.1]
seeds = [0]

[train]
model = "small"
budget = 2400
resolution = 160
"""
}


def main() -> None:
    """Make the parts of the study that are missing."""
    parser = argparse.ArgumentParser(prog="python -m hulldown.benchmarks.stand_ins", description=__doc__)
    parser.add_argument("folder", type=Path)
    folder = parser.parse_args().folder
    build_demo_assets(folder, progress=_say("asset"))
    for side in (STAND_INS, SYNTHETIC):
        make_side(side, folder)
    photographs = folder / "stand-in-photographs"
    if not photographs.exists():
        write_stand_ins(folder / STAND_INS.name, photographs)
    for name, text in STUDIES.items():
        if not (folder / name).exists():
            (folder / name).write_text(text)
    print(f"wrote {folder / 'study.toml'}")


def _say(what: str) -> Callable[[int, int], None]:
    def say(done: int, total: int) -> None:
        print(f"\r{what} {done} of {total}", end="" if done < total else "\n", flush=True)

    return say


def _rendered(side: Side) -> Callable[[RenderProgress], None]:
    say = _say(f"{side.name}: image")

    def rendered(progress: RenderProgress) -> None:
        say(progress.finished, progress.images)

    return rendered


if __name__ == "__main__":
    main()
