"""A stack of round bales, and a tractor with a tipping trailer."""

from __future__ import annotations

import numpy as np

from hulldown.demo import chassis
from hulldown.demo.chassis import Paints
from hulldown.demo.model import BlendModel
from hulldown.demo.shapes import (
    Shape,
    join_shapes,
    make_block,
    make_box,
    make_prism,
    make_slab,
    make_tube,
    path_tube,
    stack_outlines,
    turn_profile,
)


def make_bale(radius: float, length: float, *, rng: np.random.Generator) -> Shape:
    """Return a round bale about the y axis, out of round and soft-edged, its lowest line at z = 0."""
    stations = [
        (0.4, -0.5),
        (0.86, -0.49),
        (0.97, -0.44),
        (1.0, -0.2),
        (0.99, 0.1),
        (0.97, 0.44),
        (0.85, 0.49),
        (0.4, 0.5),
    ]
    body = turn_profile([(radius * r, length * y) for r, y in stations], sides=40)
    swell = 1 + 0.012 * rng.standard_normal((len(body.vertices), 1)) * [1, 0, 1]
    points = body.vertices * swell
    sag = np.minimum(points[:, 2], -0.97 * radius + 0.0 * points[:, 2])
    points[:, 2] = np.where(points[:, 2] < -0.93 * radius, sag, points[:, 2])
    return Shape(points - [0, 0, points[:, 2].min()], body.faces)


def make_tufts(radius: float, length: float, *, rng: np.random.Generator) -> Shape:
    """Loose stalks that stand out of a bale about the y axis whose lowest line is at z = 0."""
    stalks = []
    for _ in range(90):
        a, y = rng.uniform(0, 2 * np.pi), rng.uniform(-0.5, 0.5) * length
        foot = np.array([radius * 0.96 * np.cos(a), y, radius * (1 + 0.96 * np.sin(a))])
        along = np.array([np.cos(a), 0.0, np.sin(a)]) * 0.4 + rng.standard_normal(3)
        tip = foot + rng.uniform(0.06, 0.2) * along / np.linalg.norm(along)
        stalks.append(make_tube(foot.tolist(), tip.tolist(), 0.006, 0.003, sides=3))
    return join_shapes(stalks)


def bale_stack(m: BlendModel, p: Paints) -> None:
    """Six round bales, three, two and one high, and one that has rolled away."""
    rng = np.random.default_rng(5)
    radius, length = 0.72, 1.3
    step = 2 * radius * 0.985
    places = [(-step, 0.0, 0.0), (0.0, 0.0, 0.0), (step, 0.0, 0.0)]
    places += [(-step / 2, 0.0, step * 0.85), (step / 2, 0.0, step * 0.85), (0.0, 0.0, 2 * step * 0.85)]
    for k, (x, y, z) in enumerate(places):
        shift = 0.12 * rng.standard_normal()
        turn = float(rng.uniform(0, 360))
        shape = make_bale(radius, length, rng=rng)
        if z:  # only those on the ground are flat below
            shape = shape.turned("y", turn, about=(0, 0, radius))
        m.add(f"Bale_{k + 1}", shape.moved(x, y + shift, z), p.canvas, bevel=0, smooth=70)
        m.add(f"Stalks_{k + 1}", make_tufts(radius, length, rng=rng).moved(x, y + shift, z), p.canvas, bevel=0)
        bands = join_shapes(
            turn_profile([(radius * 1.004, b - 0.01), (radius * 1.004, b + 0.01)], sides=40) for b in (-0.35, 0, 0.35)
        )
        m.add(f"Twine_{k + 1}", bands.moved(x, y + shift, z + radius * 0.985), p.dark, bevel=0)
    lone = make_bale(radius, length, rng=rng) + make_tufts(radius, length, rng=rng)
    m.add("Bale_7", lone.turned("z", 68).moved(0.4, 1.95, 0), p.canvas, bevel=0, smooth=70)


def _add_wheel(m: BlendModel, p: Paints, name: str, at: tuple[float, float], radius: float, width: float) -> None:
    x, y = at
    w = width / 2
    tire = turn_profile(
        [
            (radius * 0.6, -w * 0.9),
            (radius * 0.88, -w),
            (radius * 0.95, -w * 0.8),
            (radius * 0.95, w * 0.8),
            (radius * 0.88, w),
            (radius * 0.6, w * 0.9),
        ],
        sides=32,
        hollow=True,
    )
    lug = make_box((0.07, w * 1.05, radius * 0.07), (0, 0, 0)).turned("z", 38).moved(0, w * 0.45, radius * 0.93)
    lugs = join_shapes(
        (lug if side > 0 else lug.scaled(1, -1, 1)).turned("y", (k + (0.5 if side > 0 else 0.0)) * 360 / 20)
        for k in range(20)
        for side in (-1, 1)
    )
    rim = turn_profile(
        [
            (radius * 0.6, -w * 0.7),
            (radius * 0.62, w * 0.9),
            (radius * 0.55, w * 0.86),
            (radius * 0.5, w * 0.2),
            (radius * 0.24, w * 0.3),
            (radius * 0.2, w * 0.75),
            (radius * 0.1, w * 0.78),
        ],
        sides=28,
    )
    shape = tire + lugs
    low = shape.vertices[:, 2].min()
    m.add(f"{name}_Tire", shape.moved(x, y, -low), p.rubber, bevel=0, mirror=True)
    m.add(f"{name}_Rim", rim.moved(x, y, -low), p.red, bevel=0, mirror=True)


def tractor_trailer(m: BlendModel, p: Paints) -> None:
    """Build a farm tractor pulling a two-axled tipper with a load of straw."""
    _add_wheel(m, p, "Rear", (2.3, 0.86), 0.86, 0.5)
    _add_wheel(m, p, "Front", (4.55, 0.8), 0.58, 0.36)
    m.add("Engine", make_slab([(2.2, 0.7), (4.9, 0.62), (4.95, 0.9), (2.2, 1.1)], 0.3), p.dark, bevel=0.03)
    axles = make_tube((2.3, -0.8, 0.84), (2.3, 0.8, 0.84), 0.14) + make_tube(
        (4.55, -0.75, 0.57), (4.55, 0.75, 0.57), 0.09
    )
    m.add("Axles", axles, p.dark, bevel=0)
    bonnet = [(3.05, 1.02), (5.0, 0.92), (5.1, 1.05), (5.06, 1.36), (4.85, 1.5), (3.05, 1.66)]
    m.add("Bonnet", make_slab(bonnet, 0.36), p.body, bevel=0.07, smooth=50)
    grille = join_shapes(make_block((5.05, -0.28, z), (5.1, 0.28, z + 0.025)) for z in np.arange(1.0, 1.3, 0.06))
    louvres = join_shapes(make_block((x, 0.35, 1.12), (x + 0.05, 0.372, 1.4)) for x in np.arange(3.6, 4.6, 0.1)).pair()
    m.add("Grilles", grille + louvres, p.dark, bevel=0)
    m.add("Head_Lamps", make_box((0.06, 0.2, 0.1), (5.06, 0.2, 1.33)), p.lamp, mirror=True, bevel=0.02)
    weights = join_shapes(make_box((0.2, 0.09, 0.34), (5.2, y, 0.68)) for y in np.linspace(-0.34, 0.34, 7))
    m.add("Front_Weights", weights, p.dark, bevel=0.02)
    exhaust = path_tube([(3.5, 0.42, 1.3), (3.5, 0.44, 2.5), (3.4, 0.44, 2.6)], 0.045, sides=12) + make_tube(
        (3.5, 0.44, 1.6), (3.5, 0.44, 2.15), 0.08, sides=16
    )
    m.add("Exhaust", exhaust, p.steel, bevel=0)
    low = [(1.55, -0.72), (3.1, -0.62), (3.1, 0.62), (1.55, 0.72)]
    high = [(1.62, -0.62), (2.85, -0.56), (2.85, 0.56), (1.62, 0.62)]
    m.add("Cab_Glass", stack_outlines([(1.5, low), (2.62, high)]), p.glass, bevel=0.01)
    m.add("Cab_Base", stack_outlines([(1.05, low), (1.54, low)]), p.dark, bevel=0.03)
    roof = [(1.5, -0.7), (2.98, -0.64), (2.98, 0.64), (1.5, 0.7)]
    crown = [(1.6, -0.58), (2.86, -0.52), (2.86, 0.52), (1.6, 0.58)]
    m.add("Cab_Roof", stack_outlines([(2.6, roof), (2.68, roof), (2.78, crown)]), p.canvas, bevel=0.03, smooth=60)
    posts = [
        ((1.57, 0.72, 1.5), (1.63, 0.62, 2.64)),
        ((2.25, 0.69, 1.5), (2.2, 0.6, 2.64)),
        ((3.09, 0.63, 1.5), (2.84, 0.56, 2.64)),
    ]
    m.add("Cab_Posts", join_shapes(make_tube(a, b, 0.04, sides=6) for a, b in posts), p.dark, mirror=True, bevel=0)
    angles = np.radians(np.linspace(20, 150, 10))
    arc = [(2.3 + 0.98 * np.cos(a), 0.86 + 0.98 * np.sin(a)) for a in angles]
    inner = [(2.3 + 0.94 * np.cos(a), 0.86 + 0.94 * np.sin(a)) for a in angles]
    m.add("Fenders", make_prism([*arc, *reversed(inner)], 0.6, 1.12), p.body, mirror=True, bevel=0.012, smooth=60)
    front = [(4.55 + 0.68 * np.cos(a), 0.58 + 0.68 * np.sin(a)) for a in np.radians(np.linspace(40, 150, 8))]
    lower = [(4.55 + 0.65 * np.cos(a), 0.58 + 0.65 * np.sin(a)) for a in np.radians(np.linspace(150, 40, 8))]
    m.add("Front_Fenders", make_prism([*front, *lower], 0.64, 0.98), p.dark, mirror=True, bevel=0.01, smooth=60)
    steps = join_shapes(make_box((0.34, 0.26, 0.04), (3.2, 0.66, z)) for z in (0.5, 0.78, 1.04))
    m.add("Steps", steps, p.dark, mirror=True, bevel=0.01)
    mirrors = path_tube([(3.0, 0.6, 2.1), (3.12, 0.98, 2.12)], 0.016) + make_box((0.04, 0.2, 0.3), (3.12, 1.0, 1.98))
    m.add("Mirrors", mirrors, p.dark, mirror=True, bevel=0)
    m.add("Beacon", make_tube((1.8, 0.4, 2.74), (1.8, 0.4, 2.92), 0.06), p.red, bevel=0.01)
    hitch = make_block((0.4, -0.06, 0.5), (1.6, 0.06, 0.62)) + path_tube([(1.5, 0, 0.56), (2.0, 0, 0.7)], 0.06)
    m.add("Hitch", hitch, p.dark, bevel=0.01)
    drawbar = join_shapes(make_tube((0.6, 0, 0.56), (-0.6, y, 0.72), 0.06, sides=8) for y in (-0.5, 0.5))
    m.add("Drawbar", drawbar, p.dark, bevel=0)
    chassis.ladder_frame(m, p, -4.4, -0.2, 0.98, y=0.5)
    for k, x in enumerate((-1.3, -3.5)):
        _add_wheel(m, p, f"Trailer_{k + 1}", (x, 0.92), 0.5, 0.3)
    trailer_axles = join_shapes(make_tube((x, -0.85, 0.5), (x, 0.85, 0.5), 0.07) for x in (-1.3, -3.5))
    m.add("Trailer_Axles", trailer_axles, p.dark, bevel=0)
    m.add("Trailer_Bed", make_block((-4.6, -1.16, 0.98), (0.0, 1.16, 1.1)), p.dark, bevel=0.01)
    sides = make_prism([(-4.6, 1.1), (0.0, 1.1), (0.0, 1.95), (-4.6, 1.95)], 1.1, 1.16)
    m.add("Trailer_Sides", sides, p.red, mirror=True, bevel=0.012)
    trailer_ends = join_shapes(make_block((x, -1.12, 1.1), (x + 0.06, 1.12, 1.95)) for x in (-4.6, -0.06))
    m.add("Trailer_Ends", trailer_ends, p.red, bevel=0.012)
    ribs = join_shapes(make_block((x - 0.05, 1.15, 1.02), (x + 0.05, 1.21, 1.98)) for x in np.linspace(-4.5, -0.1, 7))
    m.add("Trailer_Ribs", ribs, p.red, mirror=True, bevel=0.012)
    trailer_rims = join_shapes(make_block((-4.62, y, 1.93), (0.02, y + 0.1, 2.0)) for y in (-1.2, 1.1))
    m.add("Trailer_Rims", trailer_rims, p.red, bevel=0.015)
    m.add("Trailer_Lamps", make_box((0.05, 0.3, 0.12), (-4.63, 0.85, 0.86)), p.red, mirror=True, bevel=0.01)
    rng = np.random.default_rng(8)
    along, across = np.meshgrid(np.linspace(-4.5, -0.1, 24), np.linspace(-1.08, 1.08, 12), indexing="ij")
    heap = 1.85 + 0.5 * np.cos(along * 0.55 + 1.3) ** 2 * (1 - (across / 1.3) ** 2)
    heap += 0.05 * rng.standard_normal(heap.shape)
    top = np.stack([along, across, heap], axis=-1).reshape(-1, 3)
    quads = [(i * 12 + j, (i + 1) * 12 + j, (i + 1) * 12 + j + 1, i * 12 + j + 1) for i in range(23) for j in range(11)]
    m.add("Straw_Load", Shape(top, tuple(quads)), p.wood, bevel=0, smooth=70)
    stalks = []
    for foot in top[rng.integers(0, len(top), 260)]:
        lean = rng.standard_normal(3) * [1, 1, 0.5] + [0, 0, 0.5]
        tip = foot + 0.22 * lean / np.linalg.norm(lean)
        stalks.append(make_tube(foot.tolist(), tip.tolist(), 0.008, 0.004, sides=3))
    m.add("Straw_Stalks", join_shapes(stalks), p.wood, bevel=0)
