"""Leaves cut out by textures: rays a second beside whole quads and geometry, and the error of keeping fewer texels."""

from __future__ import annotations

import math
import time
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.ndimage import gaussian_filter

from benchmarks.camera import vehicles
from benchmarks.omissions_leaves import DENSITY, DISTANCE, KINDS, OPAQUE, places, tree
from benchmarks.omissions_leaves import leaf_texture as coarse_texture
from camera.intrinsics import Intrinsics
from camera.shell import camera_pose
from camera.target import VehicleTarget
from camera.visibility import visible_fraction
from camera.world import World
from geometry.alpha import AlphaMap, Cutouts, fewer_texels
from geometry.instances import InstancedScene
from geometry.meshes import Mesh

MADE_OF = ("quads", "cards", "leaves")
LARGEST = 1024  # texels across a card
LENS = Intrinsics(320, 180, math.radians(14))


def speed(quick: bool) -> list[dict[str, Any]]:
    """A row for each kind of tree and number of trees."""
    rows = []
    views, times = (40, 1) if quick else (400, 5)
    texture = coarse_texture(OPAQUE[0], rng=np.random.default_rng(2))
    for kind in KINDS:
        for farthest in (30.0, 130.0 if quick else 400.0):
            cards, leaves = tree(kind, texture, rng=np.random.default_rng(3))
            meshes = dict(zip(MADE_OF, (replace(cards, cutouts=None), cards, leaves), strict=True))
            poses = places(DENSITY[1], farthest)
            which = np.zeros(len(poses), int)
            scenes = {made_of: InstancedScene([mesh], which, poses) for made_of, mesh in meshes.items()}
            best = dict.fromkeys(MADE_OF, math.inf)
            for _ in range(times):
                for made_of, scene in scenes.items():
                    begin = time.process_time()
                    _fractions(scene, views, rays=256)
                    best[made_of] = min(best[made_of], time.process_time() - begin)
            rows.append({
                "kind": kind, "clear": 1.0 - float(texture.mean()), "trees": len(poses),
                "rays_a_second": {made_of: views * 256 / seconds for made_of, seconds in best.items()},
            })  # fmt: skip
    return rows


def texels_kept(quick: bool) -> list[dict[str, Any]]:
    """A row for each size of the texture; the first is the whole of it."""
    texture = _leaves()
    cards, _ = tree("crown of 30 cards", texture[::64, ::64] > 127, rng=np.random.default_rng(3))
    poses, at = places(DENSITY[1]), np.random.default_rng(5).random((200_000, 2))
    views, rows, truth = (8, [], None) if quick else (48, [], None)
    for texels in (LARGEST, 512, 256, 128, 64, 32, 16, 8):
        kept, _ = fewer_texels(texture, (), texels)
        alpha = AlphaMap(kept)
        scene = InstancedScene([_textured(cards, alpha)], np.zeros(len(poses), int), poses)
        found = _fractions(scene, views, rays=4096), alpha.opacity(at) >= 0.5
        truth = truth or found
        off = np.abs(found[0] - truth[0])
        rows.append({
            "texels": texels, "bytes": kept.nbytes, "mean": float(off.mean()), "worst": float(off.max()),
            "mask": float((found[1] != truth[1]).mean()),
        })  # fmt: skip
    return rows


def _leaves() -> np.ndarray:
    """A texture of many small leaves with soft edges."""
    rng = np.random.default_rng(6)
    noise = gaussian_filter(rng.normal(size=(LARGEST, LARGEST)), 12, mode="wrap")
    edge = np.quantile(noise, 1 - OPAQUE[0])
    return np.rint(255 * np.clip((noise - edge) / noise.std() * 4 + 0.5, 0, 1)).astype(np.uint8)


def _textured(cards: Mesh, alpha: AlphaMap) -> Mesh:
    assert cards.cutouts is not None
    holes = cards.cutouts
    return replace(cards, cutouts=Cutouts(holes.face, holes.uv, holes.face_map, (alpha,)))


def _fractions(scene: InstancedScene, views: int, *, rays: int) -> np.ndarray:
    shape, rng = vehicles()["tank"], np.random.default_rng(1)
    azimuth, elevation = rng.uniform(0, 6, views), rng.uniform(0.03, 0.17, views)
    cameras = camera_pose([0.0, 0.0, shape.size_xyz[2] / 2], DISTANCE, azimuth, elevation)
    seen = visible_fraction(
        VehicleTarget(shape), np.eye(4)[None], cameras, intrinsics=LENS, world=World(obstacles=scene), rays=rays
    )
    return seen.fraction
