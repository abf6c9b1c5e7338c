"""A shipping container, and the burnt-out hull of an armored vehicle."""

from __future__ import annotations

import numpy as np

from hulldown.demo.chassis import Paints
from hulldown.demo.model import BlendModel
from hulldown.demo.shapes import (
    Shape,
    join_shapes,
    make_block,
    make_box,
    make_prism,
    make_slab,
    make_track,
    make_tube,
    path_tube,
    stack_outlines,
    turn_profile,
)


def corrugated_outline(length: float, *, depth: float = 0.036) -> list[tuple[float, float]]:
    """Return the outline (along, out) of a sheet in trapezoidal folds, from 0 to `length`."""
    pitch, thickness = 0.28, 0.02
    outer: list[tuple[float, float]] = []
    for k in range(round(length / pitch)):
        at = k * pitch
        outer += [(at, 0.0), (at + pitch * 0.3, 0.0), (at + pitch * 0.5, -depth), (at + pitch * 0.8, -depth)]
    outer.append((length, 0.0))
    return [*outer, *((x, y - thickness) for x, y in reversed(outer))]


def add_container(m: BlendModel, p: Paints) -> None:
    """Build a twenty-foot container with corrugated sides and double doors at its rear."""
    half, width, height = 3.03, 1.22, 2.59
    side = stack_outlines(
        [(z, [(x - half + 0.1, y + width - 0.02) for x, y in corrugated_outline(2 * half - 0.2)]) for z in (0.16, 2.5)]
    )
    m.add("Side_Panels", side + side.turned("z", 180), p.body, bevel=0, smooth=20)
    end = stack_outlines(
        [(z, [(x - width + 0.1, y) for x, y in corrugated_outline(2 * width - 0.2)]) for z in (0.16, 2.5)]
    )
    m.add("Front_Panel", end.turned("z", -90).moved(half - 0.02), p.body, bevel=0, smooth=20)
    roof = [(x - half + 0.05, y + height - 0.03) for x, y in corrugated_outline(2 * half - 0.1, depth=0.02)]
    m.add("Roof_Panel", make_prism(roof, -width + 0.06, width - 0.06), p.body, bevel=0, smooth=20)
    posts = join_shapes(
        make_box((0.12, 0.12, height - 0.24), (x, y, 0.12))
        for x in (-half + 0.06, half - 0.06)
        for y in (-width + 0.06, width - 0.06)
    )
    rails = join_shapes(
        make_block((-half, y, z), (half, y + 0.07, z + 0.12)) for y in (-width, width - 0.07) for z in (0.06, 2.46)
    )
    sills = join_shapes(
        make_block((x, -width, z), (x + 0.08, width, z + 0.12)) for x in (-half, half - 0.08) for z in (0.06, 2.46)
    )
    m.add("Frame", posts + rails + sills, p.body, bevel=0.008)
    castings = join_shapes(
        make_box((0.18, 0.16, 0.12), (x, y, z))
        for x in (-half + 0.09, half - 0.09)
        for y in (-width + 0.08, width - 0.08)
        for z in (0.0, height - 0.12)
    )
    m.add("Corner_Castings", castings, p.dark, bevel=0.012)
    holes = join_shapes(
        make_tube((x, y * 1.003, z + 0.06), (x, y * 0.9, z + 0.06), 0.04, sides=12)
        for x in (-half + 0.09, half - 0.09)
        for y in (-width, width)
        for z in (0.0, height - 0.12)
    )
    m.add("Casting_Holes", holes, p.rubber, bevel=0)
    floor_beams = join_shapes(
        make_block((x - 0.03, -width + 0.05, 0.05), (x + 0.03, width - 0.05, 0.17))
        for x in np.linspace(-half + 0.3, half - 0.3, 16)
    )
    m.add("Floor_Beams", floor_beams, p.dark, bevel=0)
    fork_pockets = join_shapes(
        make_block((x - 0.18, -width - 0.002, 0.07), (x + 0.18, -width + 0.02, 0.16)).pair() for x in (-1.05, 1.05)
    )
    m.add("Fork_Pockets", fork_pockets, p.rubber, bevel=0)
    leaf = make_block((-half - 0.02, 0.02, 0.2), (-half + 0.03, width - 0.11, 2.44))
    folds = join_shapes(
        make_block((-half - 0.035, 0.1, z), (-half, width - 0.18, z + 0.26)) for z in (0.3, 0.74, 1.18, 1.62, 2.06)
    )
    m.add("Doors", leaf + folds, p.body, mirror=True, bevel=0.01)
    bars = join_shapes(make_tube((-half - 0.07, y, 0.14), (-half - 0.07, y, 2.5), 0.02, sides=8) for y in (0.24, 0.86))
    keeps = join_shapes(
        make_box((0.07, 0.09, 0.07), (-half - 0.05, y, z)) for y in (0.24, 0.86) for z in (0.2, 0.8, 1.5, 2.36)
    )
    m.add("Lock_Bars", bars + keeps, p.steel, mirror=True, bevel=0)
    handles = join_shapes(
        path_tube([(-half - 0.09, y, 1.02), (-half - 0.1, y + 0.34, 1.06)], 0.016) for y in (0.24, 0.5)
    )
    m.add("Handles", handles, p.steel, mirror=True, bevel=0)
    hinges = join_shapes(make_box((0.05, 0.1, 0.14), (-half - 0.01, width - 0.06, z)) for z in (0.4, 1.0, 1.6, 2.2))
    m.add("Hinges", hinges, p.dark, mirror=True, bevel=0.01)
    m.add("Seals", make_block((-half - 0.028, -0.015, 0.2), (-half + 0.02, 0.015, 2.44)), p.rubber, bevel=0)
    marks = join_shapes(
        make_block((x, width - 0.018, 2.08), (x + 0.11, width - 0.012, 2.26))
        for x in (1.1, 1.28, 1.46, 1.64, 2.0, 2.18)
    )
    m.add("Markings", marks + make_block((-half - 0.04, 0.3, 1.86), (-half - 0.036, 0.82, 1.98)), p.canvas, bevel=0)


def _make_plate(outline: list[tuple[float, float]], z: float, thick: float) -> Shape:
    return stack_outlines([(z, outline), (z + thick, outline)])


def burnt_hull(m: BlendModel, p: Paints) -> None:
    """Build the burnt-out hull of a tank without its top: hatches open, tires gone, a track thrown, plates torn."""
    lower = [(-3.1, 0.62), (-2.6, 0.42), (2.6, 0.42), (3.15, 0.86), (3.0, 1.05), (-3.15, 1.1)]
    m.add("Hull", make_slab(lower, 1.02), p.body, bevel=0.03)
    upper = [(-3.2, 1.06), (3.05, 1.0), (3.2, 1.08), (1.75, 1.5), (-3.15, 1.52)]
    ring = [(0.15 + 0.98 * np.cos(a), 0.98 * np.sin(a)) for a in np.arange(28) * 2 * np.pi / 28]
    m.add("Upper_Hull", make_slab(upper, 1.62), p.body, bevel=0.02)
    well = turn_profile([(0.98, 1.53), (1.14, 1.53), (1.14, 1.60), (1.06, 1.63), (0.98, 1.60)], sides=28, hollow=True)
    m.add("Race_Ring", well.turned("x", 90).moved(0.15, 0, 0), p.steel, bevel=0)
    m.add("Well", _make_plate(ring, 1.505, 0.03), p.rubber, bevel=0)
    teeth = join_shapes(
        make_box((0.06, 0.04, 0.06), (1.0, 0, 1.53)).turned("z", a).moved(0.15) for a in range(0, 360, 12)
    )
    m.add("Ring_Teeth", teeth, p.steel, bevel=0)
    rubble = join_shapes(
        make_box((s, s * 0.7, s * 0.4), (0.15 + r * np.cos(a), r * np.sin(a), 1.53)).turned("z", t, about=(0.15, 0, 0))
        for s, r, a, t in ((0.3, 0.4, 0.4, 20), (0.22, 0.6, 2.0, 50), (0.4, 0.2, 4.0, 75), (0.18, 0.7, 5.2, 10))
    )
    m.add("Debris", rubble, p.dark, bevel=0.02)
    glacis_blocks = join_shapes(
        make_box((0.5, 0.4, 0.1), (0, y, 0)).turned("y", 16.2).moved(2.3 - 0.55 * k, 0, 1.33 + 0.16 * k)
        for k in range(2)
        for y in (-1.1, -0.66, 0.66 + 0.06 * k)
    )
    m.add("Glacis_Blocks", glacis_blocks, p.body, bevel=0.015)
    hatch = make_tube((0, 0, 0), (0, 0, 0.06), 0.3, sides=18).moved(0.3, 0, 0).turned("y", -98).moved(1.32, 0.0, 1.58)
    hole = make_tube((1.66, 0, 1.47), (1.66, 0, 1.54), 0.27, sides=18)
    m.add("Driver_Lid", hatch, p.body, bevel=0.01)
    m.add("Driver_Opening", hole, p.rubber, bevel=0)
    slats = join_shapes(make_block((x, -1.0, 1.52), (x + 0.05, -0.1, 1.57)) for x in np.arange(-2.9, -1.4, 0.11))
    m.add("Engine_Grilles", slats, p.dark, bevel=0)
    m.add("Engine_Opening", make_block((-2.9, 0.1, 1.51), (-1.4, 1.0, 1.535)), p.rubber, bevel=0)
    engine = join_shapes(make_box((0.2, 0.5, 0.12), (x, 0.55, 1.5)) for x in (-2.7, -2.4, -2.1, -1.8))
    m.add("Engine_Heads", engine + make_tube((-2.85, 0.3, 1.58), (-1.5, 0.3, 1.58), 0.05), p.steel, bevel=0.02)
    torn = make_prism([(0, 0), (1.4, 0.1), (1.5, 0.13), (0, 0.03)], 0, 0.9).turned("x", 62).moved(-2.9, 1.05, 1.55)
    m.add("Torn_Deck_Plate", torn, p.body, bevel=0.008)
    guard = [(-3.2, 1.3), (3.1, 1.24), (3.3, 1.0), (3.36, 1.02), (3.12, 1.3), (-3.2, 1.34)]
    m.add("Track_Guard_Left", make_prism(guard, 1.0, 1.72), p.body, bevel=0.008)
    bent = make_prism(
        [(-3.2, 1.3), (-0.5, 1.3), (0.2, 1.5), (0.9, 1.34), (0.9, 1.3), (0.2, 1.46), (-0.5, 1.26), (-3.2, 1.26)],
        -1.72,
        -1.0,
    )
    m.add("Track_Guard_Right", bent, p.body, bevel=0.006)
    m.add("Skirt", make_prism([(-1.6, 0.72), (0.9, 0.66), (0.9, 1.28), (-1.6, 1.3)], 1.72, 1.75), p.body, bevel=0.004)
    hanging_skirt = make_prism([(1.0, 0.5), (2.2, 0.2), (2.36, 0.82), (1.1, 1.2)], 1.74, 1.77).turned(
        "x", -9, about=(0, 1.7, 1.2)
    )
    m.add("Hanging_Skirt", hanging_skirt, p.body, bevel=0.004)
    disc = turn_profile([(0.05, 0.16), (0.12, 0.15), (0.2, 0.09), (0.3, 0.12), (0.33, 0.15), (0.33, -0.16)], sides=22)
    rim = turn_profile([(0.33, -0.16), (0.345, -0.16), (0.345, 0.15), (0.33, 0.15)], sides=22, hollow=True)
    radius, first, step = 0.345, -2.35, 0.86
    wheels = join_shapes((disc + rim).moved(first + k * step, 1.32, radius) for k in range(6))
    m.add("Road_Wheels", wheels, p.steel, bevel=0, mirror=True)
    arms = join_shapes(
        make_tube((first + k * step, 1.14, radius), (first + k * step + 0.35, 1.05, 0.62), 0.06) for k in range(6)
    )
    m.add("Swing_Arms", arms, p.dark, bevel=0, mirror=True)
    ends = join_shapes(
        turn_profile([(0.08, -0.2), (0.27, -0.2), (0.27, 0.15), (0.2, 0.1), (0.08, 0.2)], sides=18).moved(x, 1.32, z)
        for x, z in ((2.85, 0.72), (-2.95, 0.76))
    )
    m.add("Sprocket_Idler", ends, p.dark, bevel=0, mirror=True)
    circles = [(first + k * step, radius + 0.075, radius + 0.075) for k in range(6)]
    circles += [(2.85, 0.78, 0.35), (-2.95, 0.82, 0.35)]
    belt = make_track(circles, 1.32, 0.52, pitch=0.16, sag=0.14)
    m.add("Track_Left", belt.moved(z=-belt.vertices[:, 2].min()), p.dark, bevel=0, smooth=20)
    link = make_prism([(-0.07, 0), (0.07, 0), (0.055, 0.07), (-0.055, 0.07)], -0.26, 0.26)
    thrown = join_shapes(
        link.turned("z", -0.3 * k).moved(-2.2 + 0.155 * k, -1.42 - 0.0004 * k * k * (k > 12), 0.0) for k in range(36)
    )
    m.add("Track_Thrown", thrown, p.dark, bevel=0, smooth=20)
    tow_cable = path_tube([(-2.6, -1.3, 1.36), (-1.4, -1.36, 1.38), (-0.4, -1.2, 1.38), (0.3, -1.46, 1.56)], 0.03)
    m.add("Tow_Cable", tow_cable, p.steel, bevel=0)
    tail = make_block((-3.28, -1.2, 0.95), (-3.2, -0.7, 1.35)) + make_block(
        (-3.3, 0.75, 0.9), (-3.22, 1.3, 1.3)
    ).turned("y", -12, about=(-3.2, 0, 1.3))
    m.add("Tail_Plates", tail, p.body, bevel=0.01)
