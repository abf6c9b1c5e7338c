"""Plans with other processors' arithmetic: `python -m hulldown.tests.builders.kernels --images 20000` counts changes.

NumPy and its OpenBLAS choose their kernels when they are loaded, so each choice needs a separate process.
"""

from __future__ import annotations

import argparse
import os
import pickle
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

from hulldown.assets.plan_assets import Assets, GeometrySource, asset_fingerprint
from hulldown.plan.config.schema import Config
from hulldown.planning.write import write_plan
from hulldown.tests.builders.planning_assets import bare, hills, small_assets, small_config

ROOT = Path(__file__).parents[2]
AVX512 = "AVX512F AVX512CD AVX512_SKX AVX512_CLX AVX512_CNL AVX512_ICL"
NO_AVX512 = {"NPY_DISABLE_CPU_FEATURES": AVX512}
# The C library also chooses: its sine with fused multiplication and addition differs.
NO_FMA = {
    "NPY_DISABLE_CPU_FEATURES": f"AVX2 FMA3 F16C AVX {AVX512}",
    "GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX2,-FMA,-FMA4,-AVX512F",
}
CORES = ("Haswell", "SkylakeX", "Zen", "Sandybridge")


def core(name: str) -> dict[str, str]:
    """The environment that selects this processor's kernels in OpenBLAS."""
    return {"OPENBLAS_CORETYPE": name}


# All switches in a few processes; and one at a time.
QUICK = {
    "Haswell, no AVX-512": core("Haswell") | NO_AVX512,
    "SkylakeX": core("SkylakeX"),
    "Zen": core("Zen"),
    "Sandybridge, no AVX, no FMA": core("Sandybridge") | NO_FMA,
}
THOROUGH = {name: core(name) for name in CORES} | {"no AVX-512": NO_AVX512, "no AVX, no FMA": NO_FMA}


def worlds(images: int) -> list[tuple[Config, Assets]]:
    """Configs that use every rule of resting, every measure of size, companions, and cut targets; `images` in all."""
    assets = small_assets()
    rough = hills("hills", height=6.0, cells=80, trees=200)
    assets = Assets(assets.vehicles, assets.categories, {"hills": rough, "bare": bare("bare")}, assets.hdris)
    company = {"vehicles_per_image": [1, 3]}
    wanted: list[tuple[dict, dict]] = [
        ({}, {}),
        (company, {"size_measure": "diagonal", "truncated_fraction": [0.0, 0.4], "elevation_sampling": "sphere"}),
        ({"rule": "averaged"}, {"size_measure": "area"}),
        ({}, {"size_measure": "height", "elevation_deg": [3.0, 89.0]}),
    ]
    budget = {"images_per_class": images // (2 * len(wanted)), "images_per_position": 4}
    return [
        (small_config(budget=budget, placement=placement, camera={"visibility_rays": 64, **camera}), assets)
        for placement, camera in wanted
    ]


def of_files(assets: Assets) -> Assets:
    """Assets with fingerprints, as if they had been read from files."""
    files = {
        kind: {name: GeometrySource(path=name, sha256=name, geometry=asset_fingerprint(one)) for name, one in of_kind.items()}
        for kind, of_kind in (("vehicles", assets.vehicles), ("sceneries", assets.sceneries))
    }
    return replace(assets, files=files)


def planned_under(environment: dict[str, str], made: Path) -> list[bytes]:
    """Lines of plans of the pickled worlds, made in a process with these variables."""
    clean = {name: value for name, value in os.environ.items() if name not in NO_FMA and name not in core("")}
    command = [sys.executable, "-W", "ignore", "-m", "hulldown.tests.builders.kernels", "--child", str(made)]
    done = subprocess.run(command, env=clean | environment, cwd=ROOT, capture_output=True, check=True)
    return done.stdout.splitlines()


def main() -> int:
    """Compare the rows of all kernels with those of this process."""
    parser = argparse.ArgumentParser(prog="python -m hulldown.tests.builders.kernels", description=__doc__)
    parser.add_argument("--images", type=int, default=20_000, help="rows to plan under each (default: 20000)")
    parser.add_argument("--child", type=Path, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.child:
        for config, assets in pickle.loads(arguments.child.read_bytes()):
            with TemporaryDirectory(dir=arguments.child.parent) as folder:
                write_plan(config, of_files(assets), path := Path(folder) / "plan.jsonl")
                sys.stdout.buffer.write(path.read_bytes())
        return 0
    with TemporaryDirectory() as folder:
        made = Path(folder) / "worlds"
        made.write_bytes(pickle.dumps(worlds(arguments.images)))
        expected, differing = planned_under({}, made), 0
        for name, environment in THOROUGH.items():
            rows = planned_under(environment, made)
            differ = sum(a != b for a, b in zip(expected, rows, strict=True))
            print(f"{name}: {differ} of {len(rows)} rows differ", flush=True)
            differing += differ
    return 1 if differing else 0


if __name__ == "__main__":
    raise SystemExit(main())
