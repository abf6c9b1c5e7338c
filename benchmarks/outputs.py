"""`python -m hulldown.benchmarks.outputs`: digests of everything that the commands write, to compare two versions.

A change that shouldn't change results is checked by running this at both versions, on the same assets, and comparing:

    python -m hulldown.benchmarks.outputs ASSETS --work before --photographs photographs
    python -m hulldown.benchmarks.outputs ASSETS --work after --photographs photographs --against before/digests.json

ASSETS is a folder that `hulldown init` filled. Plans are compared row by row, pictures by their pixels, records without
what names a version, a time, or a path.
"""

from __future__ import annotations

import argparse
import csv
import hashlib
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

VEHICLES = {"mbt_wedge": "tank", "mbt_classic": "tank", "truck_canvas": "truck", "sam_turret": "launcher"}
SMALL = {"width": 160, "height": 90, "samples": 2, "bounces": 2, "denoise": False}
# Sections of each config besides its assets; positions and pictures are few.
CONFIGS: dict[str, dict[str, dict[str, Any]]] = {
    "plain": {"budget": {"images_per_class": 24, "images_per_position": 3}},
    "weather": {
        "budget": {"images_per_class": 8, "images_per_position": 2, "background_share": 0.25},
        "placement": {"vehicles_per_image": [1, 3], "companion_distance": [6.0, 20.0], "distractors_per_image": [0, 4]},
        "camera": {"roll_deg": [-6.0, 6.0], "truncated_fraction": [0.0, 0.5], "visible_fraction": [0.2, 1.0]},
        "weather": {"fog": 0.25, "rain": 0.25, "snow": 0.2, "dust": 0.2},
        "annotate": {"below": "ignored", "keypoints": ["roof"]},
    },
    "distorted": {
        "budget": {"images_per_class": 8, "images_per_position": 2},
        "camera": {
            "intrinsics": {"fx": 118.0, "fy": 117.5, "cx": 80.4, "cy": 44.6},
            "distortion": {"k1": -0.21, "k2": 0.07, "p1": 0.0003, "p2": -0.0001, "k3": 0.0},
            "truncated_fraction": [0.0, 0.4],
        },
        "placement": {"vehicles_per_image": [1, 2]},
    },
    "heights": {
        "budget": {"images_per_class": 12, "images_per_position": 2},
        "camera": {
            "size_measure": "height",
            "target_fraction": [0.2, 0.6],
            "fov_x_deg": [20.0, 90.0],
            "elevation_deg": [-5.0, 80.0],
        },
        "placement": {"articulate": True, "rule": "averaged"},
    },
    "photographs": {
        "budget": {"images_per_class": 16, "images_per_position": 2, "background_share": 0.2},
        "camera": {"like": "", "like_share": 0.8, "fov_x_deg": [30.0, 70.0], "truncated_fraction": [0.0, 0.6]},
        "placement": {"vehicles_per_image": [1, 2]},
    },
    "poses": {"budget": {"images_per_class": 4}},
}
POSES = """\
scenery,vehicle,x,y,yaw_deg,camera_x,camera_y,camera_z,look_at_x,look_at_y,look_at_z,sequence
temperate_hills,mbt_wedge,,,,,,,,,,
temperate_hills,truck_canvas,,,90,,,,,,,
dry_steppe,sam_turret,,,,,,,,,,
"""
LAYOUTS = ("coco", "yolo", "rfdetr-yolo", "yolo-obb", "yolo-pose", "voc", "kitti", "huggingface")
# Keys of records that name a version, a time, a path, or a digest of such.
VOLATILE = {
    "date_created", "date_captured", "created", "version", "hulldown", "blender", "cycles", "provenance", "seal",
    "info", "contributor", "description", "url", "plan", "path", "root", "rendered", "made", "sensor", "started",
    "seconds",
}  # fmt: skip
PICTURES = {".png", ".jpg"}
IMAGES_RENDERED = 4


def main() -> int:
    """Write every output, and compare it with another version's if asked."""
    parser = argparse.ArgumentParser(prog="python -m hulldown.benchmarks.outputs", description=__doc__)
    parser.add_argument("assets", type=Path, help="folder that `hulldown init` filled")
    parser.add_argument("--work", type=Path, required=True, help="new folder for the outputs and digests.json")
    parser.add_argument("--photographs", type=Path, nargs="*", default=[], help="COCO folders; the first one for `like`")
    parser.add_argument("--against", type=Path, help="digests.json of the other version")
    parser.add_argument("--no-render", action="store_true", help="leave out what needs Blender's renderer")
    arguments = parser.parse_args()
    work = arguments.work.absolute()
    work.mkdir(parents=True)
    digests: dict[str, str] = {}
    for name, sections in CONFIGS.items():
        if name == "photographs" and not arguments.photographs:
            continue
        write_planned(name, sections, arguments.assets.absolute(), work, arguments.photographs, digests)
        if not arguments.no_render and name != "heights":
            write_rendered(name, work, digests)
    if not arguments.no_render:
        write_exported(work / "weather-dataset", "weather", work, digests)
    for folder in arguments.photographs:
        name = "-".join(folder.absolute().parts[-2:])
        write_exported(folder.absolute(), name, work, digests)
        write_evaluated(folder.absolute(), name, work, digests)
    (work / "digests.json").write_text(json.dumps(digests, indent=1, sort_keys=True) + "\n")
    print(f"{len(digests)} digests in {work / 'digests.json'}")
    return compare_digests(digests, json.loads(arguments.against.read_text())) if arguments.against else 0


def compare_digests(digests: dict[str, str], others: dict[str, str]) -> int:
    """Print what differs; 1 if anything does."""
    different = sorted(name for name in digests.keys() & others.keys() if digests[name] != others[name])
    for title, names in (
        ("differs", different),
        ("only here", sorted(digests.keys() - others.keys())),
        ("only there", sorted(others.keys() - digests.keys())),
    ):
        for name in names:
            print(f"{title}: {name}")
    print(f"{len(digests.keys() & others.keys()) - len(different)} equal, {len(different)} different")
    return int(digests.keys() != others.keys() or bool(different))


def run_command(*arguments: object, allowed: tuple[int, ...] = (0,)) -> str:
    """Run one of hulldown's commands in its own process; return what it printed."""
    command = [sys.executable, "-P", "-m", "hulldown", *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode not in allowed:
        raise SystemExit(f"{' '.join(command)}: {done.returncode}\n{done.stdout}\n{done.stderr}")
    return done.stdout


def write_planned(
    name: str, sections: dict[str, dict[str, Any]], assets: Path, work: Path, photographs: list[Path], digests: dict[str, str]
) -> None:
    """Plan, check, preview, and write the passes of a config."""
    config, plan = work / f"{name}.toml", work / f"{name}.jsonl"
    if "like" in sections.get("camera", {}):
        sections = {**sections, "camera": {**sections["camera"], "like": str(photographs[0].absolute())}}
    config.write_text(config_text(sections, assets, work / "cache"))
    poses = work / "poses.csv"
    poses.write_text(POSES)
    run_command("plan", config, "-o", plan, *(["--poses", poses] if name == "poses" else []))
    for number, line in enumerate(plan.read_text().splitlines()[1:]):
        digests[f"{name}/row {number:03d}"] = digest(json.dumps(stable(json.loads(line)), sort_keys=True).encode())
    run_command("check", plan, "--cache", work / "cache")
    run_command("preview", plan, "-o", work / f"{name}-preview.png", "--cache", work / "cache")
    run_command("passes", plan, "-o", work / f"{name}-passes", "--count", 4, "--cache", work / "cache")
    add_files(work / f"{name}-preview.png", work, digests)
    add_files(work / f"{name}-passes", work, digests)


def write_rendered(name: str, work: Path, digests: dict[str, str]) -> None:
    """Render the first images of a plan."""
    dataset = work / f"{name}-dataset"
    run_command("render", work / f"{name}.jsonl", "-o", dataset, "--limit", IMAGES_RENDERED, "--cache", work / "cache")
    add_files(dataset / "annotations.json", work, digests)
    add_files(dataset / "images", work, digests)


def write_exported(dataset: Path, name: str, work: Path, digests: dict[str, str]) -> None:
    """Export a dataset in every layout, with and without clipping, and take subsets."""
    for layout in LAYOUTS:
        for clip in (False, True):
            out = work / f"{name}-{layout}{'-clip' * clip}"
            options = ["--clip"] if clip else []
            # A layout may refuse a dataset, for example one without masks; then the message is compared.
            done = run_command("export", dataset, "-o", out, "--format", layout, *options, allowed=(0, 2))
            if out.exists():
                add_files(out, work, digests)
            else:
                digests[f"{name}-{layout} refused"] = digest(done.encode())


def write_evaluated(dataset: Path, name: str, work: Path, digests: dict[str, str]) -> None:
    """Evaluate made-up detections: each label, shifted, with a random confidence, and some false ones."""
    coco = json.loads((dataset / "annotations.json").read_text())
    random = np.random.default_rng(7)
    found = []
    for label in coco["annotations"]:
        shift = random.normal(0, 0.12, 4) * np.tile(label["bbox"][2:], 2)
        if random.random() < 0.8:
            box = [round(float(v), 2) for v in np.array(label["bbox"]) + shift]
            found.append({**{k: label[k] for k in ("image_id", "category_id")}, "bbox": box, "score": random.random()})
    file = work / f"{name}-found.json"
    file.write_text(json.dumps(found))
    run_command("evaluate", dataset, file, "-o", work / f"{name}-evaluation", "--threshold", 0.4)
    with (work / f"{name}-evaluation" / "metrics.csv").open(newline="") as lines:
        for row in csv.DictReader(lines):
            key = " ".join(v for v in list(row.values())[:4] if v)
            digests[f"{name}/evaluation {key}"] = json.dumps(row, sort_keys=True)


def config_text(sections: dict[str, dict[str, Any]], assets: Path, cache: Path) -> str:
    """Return a config of some of the demo's assets with these sections."""
    lines = ["seed = 5", "[assets]", f'cache = "{cache}"', f'hdris = ["{assets}/hdris/sky_*.exr"]']
    for name, category in VEHICLES.items():
        lines += ["[[assets.vehicles]]", f'path = "{assets}/vehicles/{name}.blend"', f'category = "{category}"']
        if name == "mbt_wedge":
            lines += ['paint = [{ materials = ["Camouflage"], colors = ["#5b6146", "#94835e"] }]']
            lines += ["keypoints = { roof = [0.0, 0.0, 2.5] }"]
    for name in ("civilian_car", "container"):
        lines += ["[[assets.distractors]]", f'path = "{assets}/distractors/{name}.blend"']
    for name in ("temperate_hills", "dry_steppe"):
        lines += ["[[assets.sceneries]]", f'path = "{assets}/sceneries/{name}.blend"']
    for section, keys in {**sections, "render": SMALL}.items():
        lines += [f"[{section}]", *(f"{key} = {toml_value(value)}" for key, value in keys.items())]
    return "\n".join(lines) + "\n"


def toml_value(value: Any) -> str:
    """Return a value as TOML."""
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{key} = {toml_value(v)}" for key, v in value.items()) + " }"
    return json.dumps(value)


def stable(record: Any) -> Any:
    """Return JSON data without what names a version, a time, or a path."""
    if isinstance(record, dict):
        return {key: stable(value) for key, value in record.items() if key not in VOLATILE}
    return [stable(value) for value in record] if isinstance(record, list) else record


def add_files(place: Path, work: Path, digests: dict[str, str]) -> None:
    """Add the digest of a file, or of all files in a folder: pictures by pixels, JSON without volatile keys."""
    for file in [place] if place.is_file() else sorted(p for p in place.rglob("*") if p.is_file()):
        if file.suffix in PICTURES:
            with Image.open(file) as picture:
                data = str((picture.mode, picture.size)).encode() + np.asarray(picture).tobytes()
        elif file.suffix == ".json":
            data = json.dumps(stable(json.loads(file.read_text())), sort_keys=True).encode()
        elif file.suffix == ".yaml":
            data = file.read_bytes().replace(str(work).encode(), b"")
        else:
            data = file.read_bytes()
        digests[str(file.relative_to(work))] = digest(data)


def digest(data: bytes) -> str:
    """Return the first half of a SHA-256, in hexadecimal."""
    return hashlib.sha256(data).hexdigest()[:32]


if __name__ == "__main__":
    sys.exit(main())
