"""Parts that vehicles share: wheels, tracks, axles, lamps, antennas, hatches."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from hulldown.demo.model import BlendModel
from hulldown.demo.shapes import (
    Shape,
    join_shapes,
    make_bent_bar,
    make_corner_box,
    make_cylinder,
    make_standing_box,
    make_track,
    revolve_about_x,
    revolve_about_y,
)

Circle = tuple[float, float, float]  # x, z, radius of a wheel


@dataclass(frozen=True)
class Paints:
    """The materials of one vehicle."""

    body: Any
    rubber: Any
    steel: Any
    dark: Any
    glass: Any
    canvas: Any
    wood: Any
    lamp: Any
    red: Any


@dataclass(frozen=True)
class Running:
    """Running gear of a tracked vehicle; wheels at `first`, `first + step`, ... of one radius."""

    wheels: int
    first: float
    step: float
    radius: float
    y: float
    width: float
    sprocket: Circle
    idler: Circle
    rollers: int = 0


TRACK_LINK_THICKNESS_M = 0.075


def add_running_gear(m: BlendModel, p: Paints, gear: Running) -> None:
    """Add road wheels, sprocket, idler, return rollers, and two tracks; the links touch z = 0."""
    r, w = gear.radius, gear.width
    z = r + TRACK_LINK_THICKNESS_M
    tire = revolve_about_y(
        [(r * 0.78, -w * 0.40), (r, -w * 0.36), (r, -w * 0.07), (r * 0.78, -w * 0.05)], sides=22, hollow=True
    )
    tires = tire + tire.scaled(1, -1, 1)
    disc = revolve_about_y(
        [
            (r * 0.02, w * 0.42),
            (r * 0.27, w * 0.40),
            (r * 0.42, w * 0.26),
            (r * 0.72, w * 0.32),
            (r * 0.79, w * 0.38),
            (r * 0.79, -w * 0.38),
        ],
        sides=22,
    )
    bolts = bolt_circle(np.arange(8) * np.pi / 4, r * 0.52, (w * 0.26, w * 0.34), 0.03)
    copies = (gear.wheels, gear.step)
    m.add("Road_Tires", tires.moved(gear.first, gear.y, z), p.rubber, bevel=0, mirror=True, copies=copies)
    m.add("Road_Wheels", (disc + bolts).moved(gear.first, gear.y, z), p.body, bevel=0, mirror=True, copies=copies)
    ends = []
    for x, height, radius in (gear.sprocket, gear.idler):
        drum = revolve_about_y(
            [
                (radius * 0.3, -w * 0.42),
                (radius * 0.9, -w * 0.4),
                (radius * 0.9, w * 0.34),
                (radius * 0.6, w * 0.3),
                (radius * 0.3, w * 0.42),
            ]
        )
        ends.append(drum.moved(x, gear.y, height))
    x, height, radius = gear.sprocket
    teeth = join_shapes(
        make_standing_box((0.09, w * 0.12, 0.12), (0, side * w * 0.3, radius * 0.88)).turned("y", a).moved(x, gear.y, height)
        for a in np.arange(12) * 30.0
        for side in (-1, 1)
    )
    m.add("Sprocket_Idler", join_shapes(ends), p.body, bevel=0.008, mirror=True)
    m.add("Sprocket_Teeth", teeth, p.steel, bevel=0, mirror=True)
    top = min(gear.sprocket[1] + gear.sprocket[2], gear.idler[1] + gear.idler[2])
    if gear.rollers:
        spread = np.linspace(gear.first + 0.6 * gear.step, gear.first + (gear.wheels - 1.6) * gear.step, gear.rollers)
        rollers = join_shapes(
            revolve_about_y([(0.13, -w * 0.35), (0.13, w * 0.35)], sides=12).moved(x, gear.y, top - 0.14) for x in spread
        )
        m.add("Return_Rollers", rollers, p.steel, bevel=0.01, mirror=True)
    circles = [(gear.first + i * gear.step, z, r + TRACK_LINK_THICKNESS_M) for i in range(gear.wheels)]
    circles += [(x, z, r + TRACK_LINK_THICKNESS_M) for x, z, r in (gear.sprocket, gear.idler)]
    belt = make_track(circles, gear.y, w, pitch=0.16, sag=0.05)
    low = belt.vertices[:, 2].min()  # chords of the links cut the circles a little
    m.add("Tracks", belt.moved(z=-low), p.dark, bevel=0, mirror=True, smooth=20)


def bolt_circle(angles: np.ndarray, reach: float, y: tuple[float, float], radius: float) -> Shape:
    """Return bolts along the y axis, from y[0] to y[1], at these angles and `reach` around it."""
    corners = [(reach * np.cos(a), reach * np.sin(a)) for a in angles]
    return join_shapes(make_cylinder((x, y[0], z), (x, y[1], z), radius, sides=6) for x, z in corners)


def truck_tire_and_rim(radius: float, width: float) -> tuple[Shape, Shape]:
    """Return a truck's wheel about the y axis, its outer side at +y: a tire with tread blocks, and a rim with hub."""
    r, w, sides = radius, width / 2, 24
    tire = revolve_about_y(
        [
            (r * 0.56, -w * 0.9),
            (r * 0.85, -w),
            (r * 0.97, -w * 0.75),
            (r * 0.97, w * 0.75),
            (r * 0.85, w),
            (r * 0.58, w * 0.92),
        ],
        sides=sides,
        hollow=True,
    )
    blocks = join_shapes(
        make_standing_box((r * 0.15, w * 0.8, r * 0.05), (0, side * w * 0.42, r * 0.95)).turned(
            "y", k * 360 / sides + (7.5 if side > 0 else 0)
        )
        for k in range(sides)
        for side in (-1, 1)
    )
    rim = revolve_about_y(
        [
            (r * 0.58, -w * 0.8),
            (r * 0.59, w * 0.95),
            (r * 0.52, w * 0.9),
            (r * 0.46, w * 0.45),
            (r * 0.26, w * 0.4),
            (r * 0.24, w * 0.75),
            (r * 0.12, w * 0.8),
        ],
        sides=sides,
    )
    nuts = bolt_circle(np.arange(10) * np.pi / 5, r * 0.36, (w * 0.4, w * 0.55), 0.025)
    return tire + blocks, rim + nuts


def add_wheels_and_axles(m: BlendModel, p: Paints, at: Sequence[float], *, y: float, radius: float, width: float = 0.4) -> None:
    """Add wheels on axles at the given x, the tires standing on z = 0, with axles and springs between them."""
    tire, rim = truck_tire_and_rim(radius, width)
    for k, x in enumerate(at):
        # A single wheel's tread is turned so that a block is lowest: it stands on z = 0.
        low = tire.vertices[:, 2].min()
        m.add(f"Tire_{k + 1}", tire.moved(x, y, -low), p.rubber, bevel=0, mirror=True)
        m.add(f"Rim_{k + 1}", rim.moved(x, y, -low), p.body, bevel=0, mirror=True)
    axles = join_shapes(
        make_cylinder((x, -y, radius), (x, y, radius), 0.09)
        + revolve_about_y([(0.1, -0.25), (0.2, -0.12), (0.2, 0.12), (0.1, 0.25)], sides=12).moved(x, 0, radius)
        for x in at
    )
    springs = join_shapes(
        make_corner_box((x - 0.55, 0.42, radius + 0.1), (x + 0.55, 0.52, radius + 0.18)).with_mirror_image() for x in at
    )
    m.add("Axles", axles + springs, p.dark, bevel=0)


def add_ladder_frame(m: BlendModel, p: Paints, x0: float, x1: float, z: float, *, y: float = 0.42) -> None:
    """Add two rails with cross members, their upper side at z."""
    rails = make_corner_box((x0, y - 0.06, z - 0.26), (x1, y + 0.06, z)).with_mirror_image()
    cross = join_shapes(
        make_corner_box((x - 0.06, -y, z - 0.2), (x + 0.06, y, z - 0.06)) for x in np.linspace(x0 + 0.2, x1 - 0.2, 6)
    )
    m.add("Frame", rails + cross, p.dark, bevel=0.01)


def add_mudguards(m: BlendModel, p: Paints, at: Sequence[float], *, y: float, radius: float, width: float = 0.5) -> None:
    """Add bent sheets over the wheels."""
    angles = np.radians(np.linspace(15, 165, 9))
    sheets = []
    for x in at:
        outer = [(x + (radius + 0.20) * np.cos(a), radius + (radius + 0.14) * np.sin(a)) for a in angles]
        for (xa, za), (xb, zb) in pairwise(outer):
            lean = -np.degrees(np.arctan2(zb - za, xb - xa))
            sheets.append(
                make_standing_box((np.hypot(xb - xa, zb - za) * 1.05, width, 0.03), (0, 0, 0))
                .turned("y", lean)
                .moved((xa + xb) / 2, y, (za + zb) / 2)
            )
    m.add("Mudguards", join_shapes(sheets), p.body, bevel=0, mirror=True, smooth=60)


def add_lamps(
    m: BlendModel,
    p: Paints,
    *,
    x: float,
    y: float,
    z: float,
    radius: float = 0.1,
    tail_x: float | None = None,
    tail_z: float = 0.9,
) -> None:
    """Add head lamps in housings that look along +x, and tail lamps."""
    housing = revolve_about_x([(x - 0.16, radius * 0.6), (x - 0.02, radius * 1.15)]).moved(y=y, z=z)
    post = make_standing_box((0.07, 0.06, 0.3), (x - 0.12, y, z - 0.3))
    m.add("Lamp_Housings", housing + post, p.body, bevel=0, mirror=True)
    head_lamps = revolve_about_x([(x - 0.03, radius), (x, radius * 0.9), (x + 0.02, radius * 0.4)]).moved(y=y, z=z)
    m.add("Head_Lamps", head_lamps, p.lamp, bevel=0, mirror=True)
    if tail_x is not None:
        m.add("Tail_Lamps", make_standing_box((0.06, 0.22, 0.1), (tail_x, y, tail_z)), p.red, bevel=0.01, mirror=True)


def add_antenna(
    m: BlendModel, p: Paints, at: tuple[float, float, float], *, height: float = 0.9, lean: float = 0.35, part: str = "hull"
) -> None:
    """Add a whip aerial on its base, bent by its weight."""
    x, y, z = at
    bend = [(x - lean * t * t, y, z + 0.16 + height * t) for t in np.linspace(0, 1, 5)]
    m.add("Antenna", make_cylinder(at, (x, y, z + 0.2), 0.05) + make_bent_bar(bend, 0.012, sides=5), p.dark, bevel=0, part=part)


def make_hatch(x: float, y: float, z: float, radius: float = 0.3) -> Shape:
    """Return a round hatch with its lid, hinge and handle."""
    ring = make_cylinder((x, y, z - 0.05), (x, y, z + 0.07), radius + 0.07, sides=16)
    lid = make_cylinder((x, y, z + 0.07), (x, y, z + 0.12), radius, radius * 0.9, sides=16)
    return (
        ring
        + lid
        + make_standing_box((0.12, 0.2, 0.08), (x - radius - 0.04, y, z + 0.05))
        + make_standing_box((0.22, 0.04, 0.04), (x, y, z + 0.13))
    )


def smoke_launchers(x: float, y: float, z: float, *, tubes: int = 4) -> Shape:
    """Return a row of grenade tubes pointing forward, outward and up; for the left side (mirror it)."""
    shapes, spread = [], 0.16
    for k in range(tubes):
        cup = revolve_about_x([(0, 0.055), (0.34, 0.055), (0.345, 0.045)], sides=10).turned("y", -30).turned("z", 15 + 12 * k)
        shapes.append(cup.moved(x - k * spread, y + 0.03 * k, z + 0.05 * (k % 2)))
    return join_shapes(shapes) + make_standing_box((tubes * spread, 0.06, 0.1), (x - (tubes - 1) * spread / 2, y, z - 0.1))
