"""`python -m hulldown.demo FOLDER [--seed N] [--only NAME ...]`: build demo assets in this process."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import numpy as np

from hulldown.demo import hills, skies, steppe, vehicles
from hulldown.demo.catalog import CIVILIAN_NAMES, DISTRACTORS, SCENERY_NAMES, SKY_NAMES, STUDIO_HDRIS, VEHICLE_CLASSES
from hulldown.demo.make_assets import BUILT_LINE_PREFIX

SCENERY_BUILDERS = {"temperate_hills": hills.write_temperate_hills, "dry_steppe": steppe.write_dry_steppe}


def _named_asset_builders(folder: Path, seed: int) -> Iterator[tuple[str, Callable[[], Path]]]:
    """Yield each asset's name and maker; each has random numbers of its own, so that none depends on its neighbors."""
    for k, name in enumerate(VEHICLE_CLASSES):
        yield (name, partial(vehicles.build_vehicle_file, name, folder / "vehicles", rng=np.random.default_rng([seed, 1, k])))
    for name in dict.fromkeys((*DISTRACTORS, *CIVILIAN_NAMES)):
        yield name, partial(vehicles.build_distractor_file, name, folder / "distractors")
    for k, name in enumerate(SCENERY_NAMES):
        path = folder / "sceneries" / f"{name}.blend"
        yield name, partial(SCENERY_BUILDERS[name], path, rng=np.random.default_rng([seed, 2, k]))
    for name in STUDIO_HDRIS:
        yield name, partial(skies.copy_studio_hdri, name, folder / "hdris")
    for name in SKY_NAMES:
        yield name, partial(skies.render_sky_hdri, name, folder / "hdris")


def main() -> None:
    """Build what the command line asks for."""
    parser = argparse.ArgumentParser(prog="python -m hulldown.demo", description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", nargs="*", metavar="NAME", help="of vehicles, distractors, sceneries, HDRIs; default: all")
    arguments = parser.parse_args()
    for name, build in _named_asset_builders(arguments.folder, arguments.seed):
        if not arguments.only or name in arguments.only:
            print(f"{BUILT_LINE_PREFIX}{build()}", flush=True)


if __name__ == "__main__":
    main()
