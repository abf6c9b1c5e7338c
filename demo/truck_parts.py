"""Parts that military trucks share: a flat-nosed cab, mirrors, a cargo bed, a tarpaulin."""

from __future__ import annotations

import numpy as np

from hulldown.demo import chassis
from hulldown.demo.chassis import Paints
from hulldown.demo.model import BlendModel
from hulldown.demo.shapes import (
    extrude_about_middle,
    extrude_along_y,
    join_shapes,
    make_bent_bar,
    make_corner_box,
    make_cylinder,
    make_standing_box,
    tarpaulin_hoop_points,
    thicken_surface,
)


def add_flat_cab(m: BlendModel, p: Paints, *, x0: float, x1: float, z0: float, z1: float, half: float) -> None:
    """Add a flat-nosed cab with windscreen, side windows, doors, grille, mirrors, steps and bumper."""
    waist = z0 + 0.52 * (z1 - z0)
    outline = [(x0, z0), (x1, z0), (x1 + 0.04, waist), (x1 - 0.26, z1 - 0.06), (x1 - 0.4, z1), (x0 + 0.1, z1), (x0, z1 - 0.1)]
    m.add("Cab", extrude_about_middle(outline, half), p.body, bevel=0.05)
    lean = np.degrees(np.arctan2(0.3, z1 - 0.06 - waist))
    pane_height = (z1 - 0.06 - waist) * 0.74
    pane = make_standing_box((0.02, half * 0.84, pane_height), (0, half * 0.48, 0)).with_mirror_image().turned("y", -lean)
    m.add("Windscreen", pane.moved(x1 + 0.03, 0, waist + 0.09), p.glass, bevel=0.004)
    front, rear = x1 - 0.3, x0 + 0.35
    window = extrude_along_y(
        [(rear, waist + 0.06), (front + 0.14, waist + 0.06), (front - 0.06, z1 - 0.22), (rear, z1 - 0.22)],
        half - 0.005,
        half + 0.012,
    )
    m.add("Side_Windows", window, p.glass, mirror=True, bevel=0.003)
    door = extrude_along_y(
        [(rear - 0.06, z0 + 0.12), (front + 0.18, z0 + 0.12), (front + 0.22, waist), (rear - 0.06, waist)], half, half + 0.02
    )
    m.add("Doors", door, p.body, mirror=True, bevel=0.015)
    door_handles = make_standing_box((0.16, 0.04, 0.04), (rear + 0.1, half + 0.03, waist - 0.12))
    m.add("Door_Handles", door_handles, p.dark, mirror=True, bevel=0)
    bars = join_shapes(
        make_corner_box((x1, -half * 0.55, z), (x1 + 0.06, half * 0.55, z + 0.05))
        for z in np.arange(z0 + 0.22, waist - 0.12, 0.11)
    )
    m.add("Grille", bars, p.dark, bevel=0)
    m.add("Bumper", make_standing_box((0.24, 2 * half + 0.04, 0.3), (x1 + 0.1, 0, z0 - 0.2)), p.body, bevel=0.03)
    steps = make_standing_box((0.5, 0.2, 0.06), (x0 + 0.7, half - 0.08, z0 - 0.3)) + make_standing_box(
        (0.5, 0.03, 0.3), (x0 + 0.7, half - 0.15, z0 - 0.3)
    )
    m.add("Steps", steps, p.dark, mirror=True, bevel=0)
    add_rearview_mirrors(m, p, x1 - 0.02, half, waist + 0.1)
    roof_hatch = make_cylinder((x0 + 0.8, -0.35, z1 - 0.02), (x0 + 0.8, -0.35, z1 + 0.08), 0.36, sides=18)
    m.add("Roof_Hatch", roof_hatch, p.body, bevel=0.02)
    chassis.add_lamps(m, p, x=x1 + 0.27, y=half - 0.25, z=z0 - 0.03, radius=0.11)
    wipers = join_shapes(
        make_bent_bar([(x1 + 0.07, y, waist + 0.06), (x1 - 0.08, y + 0.25, waist + 0.4)], 0.012) for y in (-0.75, 0.3)
    )
    m.add("Wipers", wipers, p.dark, bevel=0)


def add_rearview_mirrors(m: BlendModel, p: Paints, x: float, half: float, z: float) -> None:
    """Add rear-view mirrors on arms at both sides of the windscreen."""
    arm = make_bent_bar(
        [
            (x, half - 0.02, z + 0.5),
            (x + 0.1, half + 0.28, z + 0.48),
            (x + 0.1, half + 0.28, z - 0.02),
            (x, half - 0.02, z - 0.05),
        ],
        0.018,
    )
    m.add(
        "Mirrors",
        arm + make_standing_box((0.06, 0.2, 0.36), (x + 0.08, half + 0.28, z + 0.05)),
        p.dark,
        mirror=True,
        bevel=0.01,
    )


def add_drop_side_bed(m: BlendModel, p: Paints, *, x0: float, x1: float, z: float, half: float, side: float) -> None:
    """Add a cargo bed with boarded sides, stakes and a tailgate."""
    m.add("Bed_Planks", make_corner_box((x0, -half, z), (x1, half, z + 0.12)), p.wood, bevel=0.01)
    boards = [
        make_corner_box((x0, half - 0.05, z + 0.14 + k * side / 3), (x1, half, z + 0.1 + (k + 1) * side / 3)) for k in range(3)
    ]
    ends = [
        make_corner_box((x, -half + 0.06, z + 0.14 + k * side / 3), (x + 0.05, half - 0.06, z + 0.1 + (k + 1) * side / 3))
        for k in range(3)
        for x in (x0, x1 - 0.05)
    ]
    m.add("Bed_Sides", join_shapes(boards), p.body, mirror=True, bevel=0.008)
    m.add("Bed_Ends", join_shapes(ends), p.body, bevel=0.008)
    stakes = join_shapes(
        make_corner_box((x - 0.05, half, z - 0.1), (x + 0.05, half + 0.04, z + 0.14 + side))
        for x in np.linspace(x0 + 0.1, x1 - 0.1, 5)
    )
    m.add("Bed_Stakes", stakes, p.body, mirror=True, bevel=0.006)
    bed_bearers = join_shapes(
        make_corner_box((x - 0.06, -half, z - 0.14), (x + 0.06, half, z)) for x in np.linspace(x0 + 0.3, x1 - 0.3, 6)
    )
    m.add("Bed_Bearers", bed_bearers, p.dark, bevel=0)


def add_canopy(m: BlendModel, p: Paints, *, x0: float, x1: float, z0: float, z1: float, half: float) -> None:
    """Add a tarpaulin sagging between hoops, open at the rear, with straps."""
    rings, hoops = [], 5
    stations = np.linspace(x0, x1, 4 * (hoops - 1) + 1)
    for k, x in enumerate(stations):
        sag = 0.05 * np.sin(np.pi * (k % 4) / 4)
        rings.append(tarpaulin_hoop_points(float(x), half - sag, z0, z1 - sag))
    m.add("Canvas", thicken_surface(rings, thickness=0.03), p.canvas, bevel=0, smooth=50)
    inner = [tarpaulin_hoop_points(float(x), half - 0.05, z0, z1 - 0.05) for x in np.linspace(x0 + 0.03, x1 - 0.03, hoops)]
    m.add("Hoops", join_shapes(make_bent_bar(ring, 0.025, sides=6) for ring in inner), p.steel, bevel=0)
    front = tarpaulin_hoop_points(x1 - 0.01, half - 0.02, z0, z1 - 0.02)
    canvas_front = extrude_along_y([(y, z) for _, y, z in front], -0.02, 0.0).turned("z", 90).moved(x1 - 0.03)
    m.add("Canvas_Front", canvas_front, p.canvas, bevel=0)
    rear = tarpaulin_hoop_points(x0, half - 0.02, z0, z1 - 0.02)
    dark = extrude_along_y([(y, z) for _, y, z in rear], -0.02, 0.0).turned("z", 90).moved(x0 + 0.25)
    m.add("Canvas_Rear", dark, p.canvas, bevel=0)
    straps = join_shapes(
        make_bent_bar([(x, half + 0.01, z0 + 0.5), (x + 0.06, half + 0.05, z0 - 0.35)], 0.012, sides=5)
        for x in np.linspace(x0 + 0.2, x1 - 0.2, 7)
    )
    m.add("Straps", straps, p.wood, mirror=True, bevel=0)
