"""How far the wheels and tracks of real vehicles hang above the ground: plates against undersides.

`python -m benchmarks.settling_feet CONFIG`, with the config of a project such as `hulldown init` makes, prints the
table of docs/settling.md: its vehicles on its sceneries and on waves. The reference is the rest pose of the whole
underside in space: the plane that carries all cells of its raster, each where the pose itself puts it. A foot is a
wheel, or each 0.8 m of a track.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from scipy.ndimage import label

from benchmarks.settling import angle_deg, waves
from geometry.transforms import apply, facing, rigid, rotation_z
from placement.candidates import candidates
from placement.footprint import Underside, underside
from placement.settle import settle
from placement.support import support_plane
from placement.terrain import Terrain
from planning.config import load_config
from planning.loading import load_assets

PLACES = 40  # a vehicle and ground
HIGH = 1.0  # metres: no ground reaches an underside above this
FOOT_HEIGHT, FOOT_LENGTH = 0.05, 0.8
ROUNDS = 4  # of the reference, from pose to pose: by then nearly all stand still


def main() -> None:
    """Print the table."""
    config = load_config(Path(sys.argv[1]))
    assets = load_assets(config)
    shapes = {name: underside(shape.mesh) for name, shape in assets.vehicles.items()}
    kinds = {name: "tracks" if len(_feet(shape)) >= 10 else "wheels" for name, shape in shapes.items()}
    print(
        "| ground | on | settled as | angle (deg) | third foot (m) | worst foot (m) | sunk (m) |\n" + "|---" * 7 + "|"
    )
    grounds = {
        "20 m waves of 0.2 m": Terrain(waves(60.0, 0.25, 20.0, 0.2)[0]),
        "20 m waves of 0.8 m": Terrain(waves(60.0, 0.25, 20.0, 0.8)[0]),
        "6 m waves of 0.25 m": Terrain(waves(60.0, 0.25, 6.0, 0.25)[0]),
    } | {name: Terrain(scenery.ground) for name, scenery in assets.sceneries.items() if scenery.ground is not None}
    for ground, terrain in grounds.items():
        for kind in ("tracks", "wheels"):
            measured = [_measure(terrain, shape) for name, shape in shapes.items() if kinds[name] == kind]
            for way in measured[0]:
                columns = np.concatenate([of[way] for of in measured], axis=1)
                cells = (f"{np.median(c):.2f} / {np.percentile(c, 95):.2f}" for c in columns)
                print(f"| {ground} | {kind} | {way} | {' | '.join(cells)} |", flush=True)


def _measure(terrain: Terrain, shape: Underside) -> dict[str, np.ndarray]:
    """(4, k) angle to the reference, third and worst foot, and the deepest point of the underside, for each way."""
    xy, yaw = candidates(terrain.bounds[:, :2], PLACES, rng=np.random.default_rng(1))
    size = np.append(np.ptp(shape.box, axis=0), 1.0)
    ways = {
        "plate": settle(terrain, size, xy, yaw, footprint=shape.box, contact_n=0),
        "underside": settle(terrain, size, xy, yaw, footprint=shape, contact_n=0),
    }
    ok = np.all([settled.ok for settled in ways.values()], axis=0)
    poses = {way: settled.world_from_vehicle[ok] for way, settled in ways.items()}
    body, feet = _points(shape, shape.heights < HIGH), _feet(shape)
    poses["reference"] = np.array(
        [_rest(terrain, body, shape.box.mean(axis=0), *row) for row in zip(poses["underside"], yaw[ok], strict=True)]
    )
    figures = {}
    for way, pose in poses.items():
        air = np.sort([_above(terrain, pose, foot).min(axis=1) for foot in feet], axis=0)
        sunk = -_above(terrain, pose, body).min(axis=1)
        angle = angle_deg(pose[:, :3, 2], poses["reference"][:, :3, 2])
        figures[way] = np.stack([angle, air[2], air[-1], sunk])
    return figures


def _rest(terrain: Terrain, body: np.ndarray, centre: np.ndarray, pose: np.ndarray, yaw: float) -> np.ndarray:
    """From a pose to that in which the body rests, each of its points where the pose before put it."""
    turn, spot = rotation_z(yaw)[:2, :2], pose[:2, 3]
    for _ in range(ROUNDS):
        moved = body @ pose[:3, :3].T
        ground = terrain.top_hits(spot + moved[:, :2]).z
        # Straight up from the plane, a point is its height over the cosine of the tilt.
        level = (ground - body[:, 2] / pose[2, 2])[None]
        plane = support_plane(moved[:, :2] @ turn - centre, level, np.isfinite(level))
        gradient = turn @ plane.gradient[0]
        up = np.append(-gradient, 1.0)
        z = plane.height - plane.gradient @ centre
        pose = rigid(facing(yaw, up / np.linalg.norm(up)), np.append(spot, z))
    return pose


def _above(terrain: Terrain, poses: np.ndarray, points: np.ndarray) -> np.ndarray:
    at = apply(poses, points)
    ground = terrain.top_hits(at[..., :2].reshape(-1, 2)).z.reshape(at.shape[:2])
    return np.nan_to_num(at[..., 2] - ground, nan=np.inf)


def _points(shape: Underside, where: np.ndarray) -> np.ndarray:
    """(n, 3) middles of the cells of an underside."""
    i = np.argwhere(where)
    xy = shape.box[0] + (i + 0.5) / shape.heights.shape * np.ptp(shape.box, axis=0)
    return np.column_stack([xy, shape.heights[where]])


def _feet(shape: Underside) -> list[np.ndarray]:
    return list(_pieces(shape))


def _pieces(shape: Underside) -> Iterator[np.ndarray]:
    patch, n = label(shape.heights < FOOT_HEIGHT)
    for k in range(1, n + 1):
        points = _points(shape, patch == k)
        length = np.ptp(points[:, 0])
        if len(points) >= 4:
            pieces = max(1, round(length / FOOT_LENGTH)) if length > 1.5 * FOOT_LENGTH else 1
            at = np.minimum(((points[:, 0] - points[:, 0].min()) / (length + 1e-9) * pieces).astype(int), pieces - 1)
            yield from (points[at == piece] for piece in range(pieces))


if __name__ == "__main__":
    main()
