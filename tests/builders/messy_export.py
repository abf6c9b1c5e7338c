"""The messy files, built, exported, and rendered once for all tests; see messy_blends.py."""

import gzip
import json
import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image

from hulldown.assets.bundle import load_scenery, load_vehicle
from hulldown.assets.scenery import Scenery
from hulldown.assets.vehicle import VehicleShape
from hulldown.base.errors import AssetError
from hulldown.geometry.meshes import Mesh
from hulldown.reading.pieces.options import Options
from hulldown.reading.reader_process import Exported, Job, finished_export, reader_job, run_reader_jobs
from hulldown.scene.instances import InstancedScene
from hulldown.scene.ray_caster import RayCaster
from hulldown.scene.rays import RayList
from hulldown.tests.builders.blender_plans import run_script
from hulldown.tests.builders.shapes import vertices_at

SIZE, FOV = 160, math.radians(40)  # of pictures
VEHICLES = [
    *("modifiers", "clutter", "instances", "keyframes", "keyframes_turned", "collections", "no_origins", "surfaces"),
    *("centimeters", "y_up", "faces_minus_y", "armature", "linked", "textured", "lost_library", "malicious"),
    "nodes",
]
SCENERIES = ["scattered", "unnamed"]


def newer(sound: bytes) -> bytes:
    """A file of Blender 9.1."""
    return sound[:13] + b"0901" + sound[17:]


def without_utf8(odd: bytes) -> bytes:
    """A file whose names aren't UTF-8."""
    for name in (b"Nxmd", b"Dxta", b"Mxterial", b"Cxllection", b"Pxrticles", b"Scxne", b"Lxyer"):
        assert name in odd
        odd = odd.replace(name, name.replace(b"x", b"\xfc"))
    return odd


# By name of the damaged file: that of the sound one, and what is done to its bytes.
DAMAGED: dict[str, tuple[str, Callable[[bytes], bytes]]] = {
    "truncated": ("malicious", lambda sound: sound[: len(sound) // 2]),
    "scrambled": ("malicious", lambda sound: sound[:200] + np.random.default_rng(7).bytes(len(sound) - 200)),
    "newer": ("malicious", newer),
    "newer_compressed": ("malicious", lambda sound: gzip.compress(newer(sound))),
    "names": ("names", without_utf8),
    "no_known_tree": ("no_known_tree", lambda sound: sound.replace(b"ShaderNodeTree", b"ShaderNodeTrex")),
}


@dataclass
class Messy:
    """The built files, their exports, and Cycles' pictures of them."""

    folder: Path
    cases: dict
    exported: dict[str, Exported]
    errors: dict[str, AssetError]

    def asset(self, name: str) -> VehicleShape | Scenery:
        exported = self.exported[name]
        return (load_vehicle if exported.report.kind == "vehicle" else load_scenery)(exported.bundle)

    def cameras(self, name: str) -> list[np.ndarray]:
        """Poses of its cameras in the frame of the asset."""
        asset = self.asset(name)
        into = asset.vehicle_from_file if isinstance(asset, VehicleShape) else asset.scenery_from_file
        return [into @ np.array(camera) for camera in self.cases[name]["cameras"]]

    def silhouettes(self, name: str, articulation: dict | None = None) -> list[np.ndarray]:
        """Silhouettes of the exported geometry from its cameras."""
        asset = self.asset(name)
        return [silhouette(asset, camera, articulation) for camera in self.cameras(name)]

    def shown(self, name: str) -> list[np.ndarray]:
        """Cycles' silhouettes from these cameras; that of the tidy twin with ".tidy" after the name."""
        return [alpha(self.folder / f"{name}.{i}.png") for i in range(2)]

    def uses(self, name: str) -> dict[str, set[str]]:
        uses: dict[str, set[str]] = {}
        for row in self.exported[name].report.rows:
            uses.setdefault(row.name, set()).add(row.use)
        return uses


def alpha(path: Path) -> np.ndarray:
    with Image.open(path) as image:
        return np.asarray(image)[..., 3] > 127


def build(folder: Path) -> None:
    """Build the messy files, export them, and render their tidy twins, in three Blender processes."""
    run_script("messy_blends.py", folder, "build")
    for name, (sound, damage) in DAMAGED.items():
        (folder / f"{name}.blend").write_bytes(damage((folder / f"{sound}.blend").read_bytes()))
    jobs = _jobs(folder)
    for name in jobs:
        (folder / f"out_{name}").mkdir()
    # One process for all files, which starts Blender once; users get one process each.
    run_reader_jobs(list(jobs.values()))
    made = load(folder)
    twins = {
        name: {
            "kind": made.exported[name].report.kind,
            "path": str(made.exported[name].tidy),
            "hide": made.cases[name]["hide"],
            "cameras": [camera.tolist() for camera in made.cameras(name)],
        }
        for name in [*VEHICLES, *SCENERIES, "hairy", "furry", "map_in_mesh", "map_in_object"]
    }
    (folder / "tidy.json").write_text(json.dumps(twins))
    run_script("messy_blends.py", folder, "tidy")


def load(folder: Path) -> Messy:
    """Load the results of `build`."""
    exported, errors = {}, {}
    for name, job in _jobs(folder).items():
        try:
            exported[name] = finished_export(job)
        except AssetError as error:
            errors[name] = error
    return Messy(folder, _cases(folder), exported, errors)


def _jobs(folder: Path) -> dict[str, Job]:
    """The export job of each messy file."""
    about = {name: (f"{name}.blend", case["kind"], case["options"]) for name, case in _cases(folder).items()}
    about.pop("instances_without_end")  # which would end the process
    for suffix in ("glb", "fbx", "obj"):
        # The first two are exports of a model that has y up in Blender; OBJ files always have y up.
        about[suffix] = (f"imported.{suffix}", "vehicle", {"up": None if suffix == "obj" else "y"})
    about |= {name: (f"{name}.blend", "vehicle", {}) for name in DAMAGED}
    return {
        name: reader_job(folder / file, folder / f"out_{name}", kind=kind, options=Options(**options))
        for name, (file, kind, options) in about.items()
    }


def _cases(folder: Path) -> dict:
    return json.loads((folder / "cases.json").read_text())


def silhouette(asset: VehicleShape | Scenery, camera: np.ndarray, articulation: dict | None = None) -> np.ndarray:
    """The exported geometry's silhouette from a camera in the asset's frame, by one ray through each pixel's center."""
    focal = SIZE / 2 / math.tan(FOV / 2)
    across = (np.arange(SIZE) + 0.5 - SIZE / 2) / focal
    x, y = np.meshgrid(across, -across)
    directions = np.stack([x, y, -np.ones_like(x)], axis=-1).reshape(-1, 3) @ camera[:3, :3].T
    origins = np.repeat(camera[None, :3, 3], len(directions), axis=0)
    if isinstance(asset, VehicleShape):
        posed = Mesh(vertices_at(asset, articulation or {}), asset.mesh.faces)
        return RayCaster(posed).cast(origins, directions).hit.reshape(SIZE, SIZE)
    seen = InstancedScene(asset.obstacle_meshes, asset.instance_mesh, asset.world_from_instance)
    hit = seen.first_hits(RayList(origins, directions)).hit
    if asset.ground is not None:
        hit |= RayCaster(asset.ground).cast(origins, directions).hit
    return hit.reshape(SIZE, SIZE)


def iou(a: np.ndarray, b: np.ndarray) -> float:
    assert min(a.sum(), b.sum()) > 500, "the silhouette is too small"
    return float((a & b).sum() / (a | b).sum())
