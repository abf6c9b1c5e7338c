"""Civilian cars, trucks, and a bus by one table of proportions: what a detector of tanks must not take for one."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hulldown.demo.cars import add_car_wheels, door_seams, number_plates, profile_with_wheel_arches, window_pillar
from hulldown.demo.chassis import Paints
from hulldown.demo.model import BlendModel
from hulldown.demo.shapes import (
    extrude_about_middle,
    join_shapes,
    make_corner_box,
    make_ellipsoid,
    make_standing_box,
    stack_outlines,
)


class CivilianProportions(NamedTuple):
    """Sizes of a vehicle in meters, x from its middle, z from the ground.

    `glass` and `roof` are the ends of the windows at the waist and at the roof, `narrowing` times as wide there.
    `tail` is the body's height behind them, and `load` a box there: its ends in x, its underside, and its top. Cars of
    old have `fenders` over their wheels, and chrome.
    """

    size: tuple[float, float, float]
    waist: float
    glass: tuple[float, float]
    roof: tuple[float, float]
    axles: tuple[float, float]
    hood: float
    tail: float
    radius: float
    narrowing: float = 0.8
    pillars: int = 4
    load: tuple[float, float, float, float] | None = None
    fenders: bool = False


_C = CivilianProportions
CIVILIAN_PROPORTIONS = {
    "hatchback": _C((3.9, 1.7, 1.5), 0.94, (1.0, -1.85), (0.2, -1.5), (1.2, -1.25), 0.86, 0.94, 0.3),
    "sedan": _C((4.7, 1.8, 1.44), 0.92, (0.95, -1.75), (0.1, -1.05), (1.42, -1.36), 0.84, 0.96, 0.32, 0.8, 3),
    "suv": _C((4.6, 1.86, 1.72), 1.08, (0.95, -2.15), (0.3, -1.95), (1.38, -1.36), 1.0, 1.08, 0.37),
    "offroader": _C((4.3, 1.8, 1.9), 1.15, (0.55, -2.08), (0.42, -2.04), (1.3, -1.3), 1.12, 1.15, 0.4, 0.92),
    "minivan": _C((4.8, 1.86, 1.8), 1.02, (1.7, -2.3), (0.6, -2.1), (1.55, -1.45), 0.92, 1.02, 0.33, 0.84),
    "classic": _C((4.6, 1.7, 1.55), 1.0, (0.75, -1.5), (0.25, -0.95), (1.4, -1.3), 0.98, 0.95, 0.35, 0.78, 3, None, True),
    "roadster": _C((4.0, 1.66, 1.25), 0.85, (0.5, -1.1), (0.05, -0.7), (1.25, -1.15), 0.84, 0.85, 0.32, 0.76, 2, None, True),
    "pickup": _C((5.3, 1.88, 1.8), 1.12, (1.05, -0.85), (0.4, -0.7), (1.7, -1.55), 1.06, 1.06, 0.39, 0.8, 3),
    "box_truck": _C(
        (7.2, 2.3, 2.4), 1.35, (3.5, 1.9), (3.15, 1.95), (2.5, -1.9), 1.3, 0.85, 0.42, 0.92, 2, (1.7, -3.55, 0.95, 3.3)
    ),
    "tipper": _C((7.6, 2.5, 2.9), 1.7, (3.7, 2.1), (3.5, 2.15), (2.6, -2.2), 1.6, 1.05, 0.5, 0.95, 2, (1.9, -3.8, 1.15, 2.1)),
    "bus": _C((11.6, 2.5, 3.1), 1.3, (5.76, -5.7), (5.5, -5.6), (3.1, -2.9), 1.25, 1.3, 0.48, 0.97, 9),
}


def build_civilian_vehicle(m: BlendModel, p: Paints, name: str) -> None:
    """Build a vehicle of these proportions."""
    s = CIVILIAN_PROPORTIONS[name]
    front, half, height = (np.array(s.size) * (0.5, 0.5, 1.0)).tolist()
    rear, sill, roof = -front, s.radius * 0.85, height - 0.07
    outline = [(rear + 0.08, sill), (front - 0.1, sill), (front, sill + 0.12), (front - 0.02, s.hood - 0.2)]
    outline += [(max(front - 0.16, s.glass[0]), s.hood - 0.06), (s.glass[0], s.waist), (s.glass[1] + 0.02, s.waist)]
    outline += [(min(s.glass[1], rear + 0.1), s.tail), (rear, s.tail - 0.2), (rear - 0.03, sill + 0.2)]
    if s.load:
        outline[7:8] = [(s.glass[1], s.tail), (rear + 0.1, s.tail)]
        x0, x1, z0, z1 = s.load
        m.add("Load", make_corner_box((x1, -half, z0), (x0, half, z1)), p.canvas if z1 > height else p.body, bevel=0.03)
        ribs = join_shapes(
            make_standing_box((0.06, 2 * half + 0.06, z1 - z0), (x, 0, z0)) for x in np.linspace(x1, x0, 7)[1:-1]
        )
        m.add("Load_Ribs", ribs, p.steel, bevel=0)
    profile = profile_with_wheel_arches(outline, s.axles, center=s.radius, radius=s.radius * 1.2, sill=sill)
    m.add("Body", extrude_about_middle(profile, half), p.body, bevel=0.08, smooth=50)
    if s.fenders:
        around = join_shapes(
            make_ellipsoid(
                (s.radius * 1.9, 0.3, s.radius * 0.75), (x, half - 0.1, s.radius * 1.55), floor=0.0, sides=24, rings=10
            )
            for x in s.axles
        )
        m.add("Fenders", around, p.body, mirror=True, bevel=0, smooth=60)
        m.add(
            "Chrome_Strips",
            make_corner_box((rear, half - 0.02, s.waist - 0.2), (front - 0.3, half + 0.02, s.waist - 0.16)),
            p.steel,
            mirror=True,
        )
    waist, crown = half - 0.08, (half - 0.08) * s.narrowing
    low, high = ([(b, -w), (a, -w), (a, w), (b, w)] for (a, b), w in ((s.glass, waist), (s.roof, crown)))
    m.add("Windows", stack_outlines([(s.waist - 0.02, low), (roof, high)]), p.glass, bevel=0.02)
    shrunk = [(x * 0.96, y * 0.85) for x, y in high]
    top = stack_outlines([(roof - 0.1, [(x, y * 1.03) for x, y in high]), (roof, high), (height, shrunk)])
    m.add("Roof", top, p.body, bevel=0.02, smooth=60)
    feet, heads = (np.linspace(*ends, s.pillars) for ends in (s.glass, s.roof))
    feet[-1], heads[-1] = feet[-1] + 0.1, heads[-1] + 0.1  # the last is the widest, and ends with the glass
    widths = [0.1] * (s.pillars - 1) + [0.22]
    pillars = join_shapes(
        window_pillar((a, waist, s.waist - 0.02), (b, crown, roof - 0.04), w)
        for a, b, w in zip(feet, heads, widths, strict=True)
    )
    m.add("Pillars", pillars, p.body, mirror=True, bevel=0.008)
    door_feet = feet[:-1] if s.pillars < 9 else feet[[0, 1, 4, 5]]
    seams = door_seams([[(x, sill + 0.1), (x, s.waist)] for x in door_feet], half + 0.002)
    m.add("Door_Seams", seams, p.dark, mirror=True, bevel=0)
    handles = [make_standing_box((0.2, 0.03, 0.03), (x + 0.2, half, s.waist - 0.14)) for x in door_feet[1:]]
    mirror = make_standing_box((0.13, 0.22, 0.16), (feet[0] - 0.25, half + 0.08, s.waist))
    m.add("Handles", join_shapes([*handles, mirror]), p.dark, mirror=True)
    bumper = make_corner_box((front - 0.2, -half * 0.97, sill + 0.02), (front + 0.06, half * 0.97, sill + 0.22))
    trim = p.steel if s.fenders else p.dark
    m.add("Front_Bumper", bumper, trim, bevel=0.05)
    m.add("Rear_Bumper", bumper.scaled(-1, 1, 1).moved(-0.03), trim, bevel=0.05)
    grille = make_corner_box((front - 0.2, -half * 0.5, sill + 0.26), (front + 0.01, half * 0.5, s.hood - 0.22))
    m.add("Grille", grille, trim, bevel=0.02)
    lamp = make_corner_box((front - 0.25, half * 0.6, s.hood - 0.34), (front + 0.01, half * 0.94, s.hood - 0.18))
    m.add("Head_Lamps", lamp, p.lamp, mirror=True, bevel=0.03)
    tail = make_corner_box((rear - 0.03, half * 0.76, s.tail - 0.36), (rear + 0.2, half * 0.98, s.tail - 0.12))
    m.add("Tail_Lamps", tail, p.red, mirror=True, bevel=0.02)
    m.add("Number_Plates", number_plates(front + 0.06, rear - 0.09, (sill + 0.06, sill + 0.08)), p.canvas, bevel=0)
    m.add("Floor_Pan", make_corner_box((rear + 0.2, 0.2 - half, sill - 0.08), (front - 0.2, half - 0.2, sill + 0.1)), p.dark)
    add_car_wheels(m, p, s.axles, y=half - 0.12, radius=s.radius, width=0.22 if s.radius < 0.42 else 0.3)
