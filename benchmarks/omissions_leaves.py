"""What a picture shows of a target through leaf cards, beside plans with and without the holes of their texture."""

from __future__ import annotations

import itertools
import math
import subprocess
import sys
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from assets.bundle import load_scenery
from benchmarks.camera import vehicles
from camera.intrinsics import Intrinsics
from camera.shell import camera_pose
from camera.target import VehicleTarget
from camera.visibility import visible_fraction
from camera.world import World
from geometry.alpha import AlphaMap, Cutouts
from geometry.instances import InstancedScene
from geometry.meshes import Mesh
from geometry.transforms import rigid, rotation_z
from reading.export import export

TEXELS = 16  # across a card
OPAQUE = (0.35, 0.6)  # shares of a card that leaves cover
DENSITY = (1.0, 2.0, 4.0)  # trees to 100 square metres
KINDS = {"crown of 30 cards": 30, "two crossed cards": 2}
RING = (7.0, 30.0)  # metres from the target: where the trees stand
DISTANCE = 45.0  # of the cameras
RAYS = 4096  # so many that what is measured is the leaves and not the sampling
BAND = 0.3  # a least visible share that a config may ask for


@dataclass(frozen=True, slots=True)
class Wood:
    """One kind of tree: the share of a card that leaves cover, trees to 100 square metres, how far they stand (m).

    From an atlas, the texture is a quarter of a larger one, found by a Mapping node, and read from the .blend file.
    """

    kind: str
    opaque: float
    density: float
    farthest: float = RING[1]
    atlas: bool = False


def woods(quick: bool) -> list[Wood]:
    """All that are measured."""
    few = [Wood(*case) for case in itertools.product(KINDS, OPAQUE, DENSITY)]
    many = Wood("two crossed cards", OPAQUE[0], DENSITY[1], farthest=130.0 if quick else 400.0)
    return [*few, Wood("crown of 30 cards", OPAQUE[0], DENSITY[1], atlas=True), many]


def measure(quick: bool) -> dict[str, Any]:
    """Visible shares of every view, planned and rendered: on cards, on leaves and on whole quads; seeded."""
    views = 8 if quick else 24
    lens = Intrinsics(*((160, 90) if quick else (320, 180)), math.radians(14))
    shape = vehicles()["tank"]
    azimuth = np.arange(views) * (2 * math.pi / views)
    elevation = np.random.default_rng(1).uniform(math.radians(2), math.radians(10), views)
    cameras = camera_pose([0.0, 0.0, shape.size_xyz[2] / 2], DISTANCE, azimuth, elevation)
    given: dict[str, Any] = {
        "size": [lens.width, lens.height], "fov_x": lens.fov_x, "world_from_camera": cameras,
        "vehicle_vertices": shape.mesh.vertices, "vehicle_faces": shape.mesh.faces,
    }  # fmt: skip
    found, grown = [], []
    for number, wood in enumerate(woods(quick)):
        texture = leaf_texture(wood.opaque, rng=np.random.default_rng(2))
        cards, leaves = tree(wood.kind, texture, rng=np.random.default_rng(3))
        poses = places(wood.density, wood.farthest)
        grown.append(({"cards": cards, "leaves": leaves, "quads": replace(cards, cutouts=None)}, poses))
        found.append({
            "kind": wood.kind + (", atlas" if wood.atlas else ""), "opaque": float(texture.mean()),
            "density": wood.density, "trees": len(poses),
            "triangles": {"cards": len(cards.faces), "leaves": len(leaves.faces)},
        })  # fmt: skip
        given |= {f"poses_{number}": poses, f"texture_{number}": texture, f"uv_{number}": _uv(cards)}
        given |= {f"atlas_{number}": wood.atlas}
        for made_of, mesh in (("cards", cards), ("leaves", leaves)):
            given |= {f"{made_of}_vertices_{number}": mesh.vertices, f"{made_of}_faces_{number}": mesh.faces}
    with tempfile.TemporaryDirectory() as folder:
        shown = _rendered(given | {"sceneries": len(found)}, Path(folder))
        for number, (trees, _) in enumerate(grown):
            if given[f"atlas_{number}"]:
                trees["cards"] = _read(Path(folder) / f"tree_{number}.blend")
    alone = shown["alone"].sum(axis=(1, 2))
    for number, (wood_found, (trees, poses)) in enumerate(zip(found, grown, strict=True)):
        for made_of, mesh in trees.items():
            wood_found[f"planned_{made_of}"] = _planned(shape, cameras, lens, mesh, poses).tolist()
            if made_of != "quads":
                wood_found[f"shown_{made_of}"] = (shown[f"{made_of}_{number}"].sum(axis=(1, 2)) / alone).tolist()
    return {"views": views, "pixels": float(alone.mean()), "rays": RAYS, "woods": found}


def _read(path: Path) -> Mesh:
    """The tree as reading its file gives it."""
    scenery = load_scenery(export(path, path.parent, kind="scenery").bundle)
    return scenery.obstacle_meshes[0]


def leaf_texture(share: float, *, rng: np.random.Generator) -> np.ndarray:
    """(TEXELS, TEXELS) bool: elliptic leaves thrown on a card until they cover the share."""
    u, v = np.meshgrid(*[(np.arange(TEXELS) + 0.5) / TEXELS] * 2)
    opaque = np.zeros((TEXELS, TEXELS), dtype=bool)
    while opaque.mean() < share:
        (x, y), turn = rng.random(2), rng.uniform(0, math.pi)
        along = (u - x) * math.cos(turn) + (v - y) * math.sin(turn)
        across = (v - y) * math.cos(turn) - (u - x) * math.sin(turn)
        opaque |= (along / 0.12) ** 2 + (across / 0.06) ** 2 < 1
    return opaque


def tree(kind: str, texture: np.ndarray, *, rng: np.random.Generator) -> tuple[Mesh, Mesh]:
    """A low crown of cards, and the same crown with the opaque texels cut out as triangles."""
    if kind == "two crossed cards":
        right = np.array([[3.2, 0.0, 0.0], [0.0, 3.2, 0.0]])
        up = np.array([[0.0, 0.0, 3.4]] * 2)
        corner = [0.0, 0.0, 0.1] - right / 2
    else:
        centre = rng.normal(size=(KINDS[kind], 3))
        centre *= rng.random((len(centre), 1)) ** (1 / 3) / np.linalg.norm(centre, axis=1, keepdims=True)
        frames = np.linalg.qr(rng.normal(size=(len(centre), 3, 3)))[0]
        right, up = frames[:, 0], frames[:, 1]
        corner = centre * [1.5, 1.5, 1.6] + [0.0, 0.0, 1.9] - (right + up) / 2
    edges = np.diff(np.pad(texture, ((0, 0), (1, 1))).astype(int), axis=1)
    row, start = np.nonzero(edges == 1)
    _, end = np.nonzero(edges == -1)
    runs = np.stack([start, row, end, row + 1], axis=1) / TEXELS
    cards = _quads(corner, right, up, np.array([[0.0, 0.0, 1.0, 1.0]]))
    alpha = AlphaMap(texture.astype(np.uint8) * 255, smooth=False)
    holes = Cutouts(np.arange(len(cards.faces)), _uv(cards)[cards.faces], np.zeros(len(cards.faces), int), (alpha,))
    return replace(cards, cutouts=holes), _quads(corner, right, up, runs)


def _quads(corner: np.ndarray, right: np.ndarray, up: np.ndarray, inside: np.ndarray) -> Mesh:
    """Rectangles (u0, v0, u1, v1) of every card."""
    u, v = inside[:, [0, 2, 2, 0], None], inside[:, [1, 1, 3, 3], None]
    corners = corner[:, None, None] + u * right[:, None, None] + v * up[:, None, None]
    first = 4 * np.arange(len(corner) * len(inside))[:, None, None]
    halves = np.array([[0, 1, 2], [0, 2, 3]])
    return Mesh(corners.reshape(-1, 3), (first + halves).reshape(-1, 3), "tree")


def _uv(cards: Mesh) -> np.ndarray:
    corners = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]], dtype=np.float32)
    return np.tile(corners, (len(cards.vertices) // 4, 1))


def places(density: float, farthest: float = RING[1]) -> np.ndarray:
    """(k, 4, 4) poses of trees around the target."""
    rng = np.random.default_rng(4)
    n = round(density * math.pi * (farthest**2 - RING[0] ** 2) / 100)
    away, around = np.sqrt(rng.uniform(RING[0] ** 2, farthest**2, n)), rng.uniform(0, 2 * math.pi, n)
    poses = rigid(rotation_z(rng.uniform(0, 6, n)), np.c_[away * np.cos(around), away * np.sin(around), np.zeros(n)])
    poses[:, :3, :3] *= rng.uniform(0.7, 1.3, n)[:, None, None]
    return poses


def _planned(shape: Any, cameras: np.ndarray, lens: Intrinsics, mesh: Mesh, poses: np.ndarray) -> np.ndarray:
    wood = InstancedScene([mesh], np.zeros(len(poses), dtype=int), poses)
    return visible_fraction(
        VehicleTarget(shape), np.eye(4)[None], cameras, intrinsics=lens, world=World(obstacles=wood), rays=RAYS
    ).fraction  # fmt: skip


def _rendered(given: dict[str, Any], folder: Path) -> dict[str, np.ndarray]:
    asked, answered = folder / "asked.npz", folder / "answered.npz"
    np.savez(asked, **given)
    script = Path(__file__).with_name("omissions_leaves_blender.py")
    subprocess.run([sys.executable, "-P", str(script), str(asked), str(answered)], check=True, capture_output=True)
    with np.load(answered) as masks:
        return dict(masks)


def summary(wood: dict[str, Any]) -> dict[str, Any]:
    """Mean, median and worst of what the picture shows beyond the plan, on cards and on leaves, and lost views."""
    shares = {key: np.array(wood[key]) for key in wood if key.startswith(("planned_", "shown_"))}
    out: dict[str, Any] = {name: float(values.mean()) for name, values in shares.items()}
    for made_of, seen in (("cards", "cards"), ("leaves", "leaves"), ("quads", "cards")):
        more = shares[f"shown_{seen}"] - shares[f"planned_{made_of}"]
        out[f"more_{made_of}"] = [float(more.mean()), float(np.median(more)), float(more[np.abs(more).argmax()])]
        lost = (shares[f"planned_{made_of}"] < BAND) & (shares[f"shown_{seen}"] >= BAND)
        out[f"lost_{made_of}"] = float(lost.mean())
    return out
