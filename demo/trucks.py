"""Three military trucks of generic type: bonneted with a canvas, cab-over with an open bed, and a tanker."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from hulldown.demo import chassis
from hulldown.demo.chassis import Paints, add_antenna
from hulldown.demo.model import BlendModel
from hulldown.demo.shapes import (
    Outline,
    extrude_about_middle,
    extrude_along_y,
    join_shapes,
    make_bent_bar,
    make_corner_box,
    make_cylinder,
    make_standing_box,
    revolve_about_y,
)
from hulldown.demo.truck_parts import add_canopy, add_drop_side_bed, add_flat_cab, add_rearview_mirrors


def build_canvas_truck(m: BlendModel, p: Paints, folder: Path) -> None:
    """Build a bonneted 6x6 with a canvas over its bed."""
    axles = (2.55, -1.35, -2.75)
    chassis.add_wheels_and_axles(m, p, axles, y=1.0, radius=0.58, width=0.4)
    chassis.add_ladder_frame(m, p, -3.7, 3.5, 1.05)
    bonnet: Outline = [(1.35, 1.0), (3.55, 0.95), (3.62, 1.05), (3.58, 1.62), (3.4, 1.72), (1.35, 1.92)]
    m.add("Bonnet", extrude_about_middle(bonnet, 0.68), p.body, bevel=0.06)
    fender = [
        (1.65, 1.05),
        (1.85, 1.42),
        (2.15, 1.5),
        (2.95, 1.5),
        (3.3, 1.36),
        (3.6, 1.08),
        (3.6, 1.0),
        (3.5, 1.0),
        (3.25, 1.25),
        (2.9, 1.38),
        (2.2, 1.38),
        (1.95, 1.3),
        (1.8, 1.02),
    ]
    m.add("Wings", extrude_along_y(fender, 0.66, 1.22), p.body, mirror=True, bevel=0.02)
    bars = join_shapes(make_corner_box((3.59, y, 1.12), (3.65, y + 0.06, 1.56)) for y in np.arange(-0.5, 0.5, 0.12))
    m.add("Grille", bars, p.dark, bevel=0)
    bonnet_louvres = join_shapes(make_corner_box((x, 0.67, 1.35), (x + 0.07, 0.7, 1.65)) for x in np.arange(1.7, 3.2, 0.18))
    m.add("Bonnet_Louvres", bonnet_louvres, p.dark, mirror=True, bevel=0)
    cab: Outline = [(0.2, 0.95), (1.45, 0.95), (1.5, 1.9), (1.28, 2.55), (1.15, 2.62), (0.25, 2.62), (0.2, 2.55)]
    m.add("Cab", extrude_about_middle(cab, 1.08), p.body, bevel=0.05)
    pane = make_standing_box((0.02, 0.92, 0.52), (0, 0.5, 0)).with_mirror_image().turned("y", -18.7)
    m.add("Windscreen", pane.moved(1.49, 0, 1.96), p.glass, bevel=0.004)
    window = extrude_along_y([(0.42, 1.92), (1.34, 1.92), (1.18, 2.42), (0.42, 2.42)], 1.075, 1.092)
    m.add("Side_Windows", window, p.glass, mirror=True, bevel=0.003)
    doors = extrude_along_y([(0.36, 1.1), (1.36, 1.1), (1.4, 1.86), (0.36, 1.86)], 1.08, 1.1)
    m.add("Doors", doors, p.body, mirror=True, bevel=0.012)
    add_rearview_mirrors(m, p, 1.5, 1.08, 1.95)
    m.add("Bumper", make_standing_box((0.2, 2.35, 0.28), (3.78, 0, 0.72)), p.body, bevel=0.03)
    m.add("Tow_Hooks", make_standing_box((0.2, 0.08, 0.1), (3.92, 0.6, 0.8)).with_mirror_image(), p.dark, bevel=0)
    chassis.add_lamps(m, p, x=3.68, y=0.95, z=1.28, radius=0.11, tail_x=-3.78, tail_z=1.02)
    fuel_tank = make_cylinder((-0.55, 0.95, 0.82), (0.6, 0.95, 0.82), 0.27, sides=18) + make_standing_box(
        (0.5, 0.4, 0.5), (0.0, -0.95, 0.58)
    )
    m.add("Fuel_Tank", fuel_tank, p.body, bevel=0.03)
    spare_wheel = revolve_about_y([(0.3, -0.18), (0.56, -0.16), (0.56, 0.16), (0.3, 0.18)]).turned("z", 90).moved(0.0, 0, 1.85)
    m.add("Spare_Wheel", spare_wheel, p.rubber, bevel=0.02)
    snorkel = make_bent_bar([(1.3, -1.12, 1.3), (1.3, -1.12, 2.7), (1.45, -1.12, 2.75)], 0.07, sides=10)
    m.add("Snorkel", snorkel, p.dark, bevel=0)
    add_drop_side_bed(m, p, x0=-3.75, x1=-0.25, z=1.18, half=1.22, side=0.6)
    add_canopy(m, p, x0=-3.72, x1=-0.28, z0=1.85, z1=2.95, half=1.21)
    chassis.add_mudguards(m, p, axles[1:], y=1.0, radius=0.58)
    add_antenna(m, p, (0.4, 0.95, 2.6), height=0.7)


def build_cargo_truck(m: BlendModel, p: Paints, folder: Path) -> None:
    """Build a cab-over 4x4 with an open drop-side bed full of crates."""
    axles = (2.2, -1.9)
    chassis.add_wheels_and_axles(m, p, axles, y=1.05, radius=0.62, width=0.42)
    chassis.add_ladder_frame(m, p, -3.4, 3.1, 1.15)
    add_flat_cab(m, p, x0=1.35, x1=3.3, z0=1.1, z1=2.75, half=1.2)
    chassis.add_mudguards(m, p, axles, y=1.05, radius=0.62)
    add_drop_side_bed(m, p, x0=-3.55, x1=1.0, z=1.4, half=1.22, side=0.7)
    headboard = join_shapes(
        [
            make_corner_box((1.02, -1.2, 1.4), (1.08, 1.2, 2.5)),
            *(make_corner_box((1.08, y, 1.4), (1.14, y + 0.06, 2.6)) for y in (-1.1, -0.4, 0.4, 1.04)),
        ]
    )
    m.add("Headboard", headboard, p.body, bevel=0.01)
    for k, (size, x, y, turn) in enumerate(
        [
            ((1.1, 1.0, 0.8), 0.3, 0.5, 3),
            ((1.2, 0.9, 0.7), 0.2, -0.6, -4),
            ((0.9, 1.0, 0.9), -1.1, -0.5, 8),
            ((1.2, 0.8, 0.6), -2.6, -0.45, 2),
        ]
    ):
        m.add_crate(f"Crate_{k + 1}", size, (x, y, 1.52), p.wood, turn_deg=turn)
    m.add_crate("Crate_Top", (0.9, 0.6, 0.45), (0.15, -0.5, 2.23), p.canvas, turn_deg=12)
    rolls = join_shapes(
        make_cylinder((x, 0.15, z), (x, 1.05, z), 0.3, sides=16) for x, z in ((-1.05, 1.83), (-1.66, 1.83), (-1.36, 2.34))
    )
    m.add("Cargo_Rolls", rolls, p.canvas, bevel=0.06)
    cargo_drums = join_shapes(
        make_cylinder(
            (-2.5 - 0.62 * (k % 2), 0.3 + 0.62 * (k // 2), 1.52),
            (-2.5 - 0.62 * (k % 2), 0.3 + 0.62 * (k // 2), 2.4),
            0.29,
            sides=18,
        )
        for k in range(4)
    )
    m.add("Cargo_Drums", cargo_drums, p.steel, bevel=0.02)
    m.add("Fuel_Tank", make_standing_box((1.1, 0.5, 0.55), (0.2, 0.95, 0.72)), p.body, bevel=0.06)
    m.add("Tool_Box", make_standing_box((0.9, 0.45, 0.5), (0.2, -0.95, 0.75)), p.body, bevel=0.03)
    m.add("Exhaust", make_bent_bar([(1.2, -1.0, 1.0), (1.2, -1.12, 1.4), (1.2, -1.12, 2.9)], 0.07, sides=10), p.steel, bevel=0)
    m.add("Rear_Bumper", make_standing_box((0.14, 2.3, 0.2), (-3.5, 0, 0.75)), p.dark, bevel=0.02)
    m.add("Tail_Lamps", make_standing_box((0.06, 0.24, 0.1), (-3.58, 0.95, 0.8)), p.red, mirror=True, bevel=0.01)
    add_antenna(m, p, (1.6, -1.0, 2.74), height=0.8)


def build_tanker_truck(m: BlendModel, p: Paints, folder: Path) -> None:
    """Build a cab-over 8x8 with an oval fuel tank, catwalk and ladder, modeled in centimeters."""
    axles = (3.05, 1.65, -1.6, -3.0)
    chassis.add_wheels_and_axles(m, p, axles, y=1.05, radius=0.6, width=0.42)
    chassis.add_ladder_frame(m, p, -4.2, 3.9, 1.12)
    add_flat_cab(m, p, x0=2.3, x1=4.2, z0=1.15, z1=2.8, half=1.22)
    chassis.add_mudguards(m, p, axles, y=1.05, radius=0.6)
    body = revolve_about_y([(0.55, -3.0), (0.9, -2.92), (1.0, -2.8), (1.0, 2.8), (0.9, 2.92), (0.55, 3.0)], sides=32)
    m.add("Tank_Body", body.turned("z", -90).scaled(1, 1.18, 0.82).moved(-1.05, 0, 2.25), p.body, bevel=0, smooth=40)
    bands = join_shapes(revolve_about_y([(1.015, x - 0.04), (1.015, x + 0.04)], sides=32) for x in (-1.8, -0.6, 0.6, 1.8))
    m.add("Tank_Bands", bands.turned("z", -90).scaled(1, 1.18, 0.82).moved(-1.05, 0, 2.25), p.steel, bevel=0, smooth=40)
    cradle = join_shapes(
        extrude_about_middle([(x - 0.12, 1.12), (x + 0.12, 1.12), (x + 0.12, 1.75), (x - 0.12, 1.75)], 0.95)
        for x in (-3.4, -1.9, -0.2, 1.3)
    )
    m.add("Cradles", cradle, p.dark, bevel=0.02)
    walk = make_corner_box((-3.6, -0.35, 3.06), (1.6, 0.35, 3.1))
    rail = join_shapes(
        make_bent_bar([(-3.5, y, 3.1), (-3.5, y, 3.4), (1.5, y, 3.4), (1.5, y, 3.1)], 0.022) for y in (-0.34, 0.34)
    )
    m.add("Catwalk", walk + rail, p.steel, bevel=0)
    domes = join_shapes(make_cylinder((x, 0, 3.02), (x, 0, 3.24), 0.27, sides=18) for x in (-2.6, -1.05, 0.5))
    m.add("Filler_Domes", domes, p.body, bevel=0.03)
    ladder = join_shapes(
        [make_bent_bar([(-4.12, y, 1.0), (-4.12, y, 3.1), (-3.8, y, 3.3)], 0.025) for y in (-0.7, -0.35)]
        + [make_cylinder((-4.12, -0.7, z), (-4.12, -0.35, z), 0.018, sides=6) for z in np.arange(1.1, 3.1, 0.28)]
    )
    m.add("Ladder", ladder, p.steel, bevel=0)
    m.add("Pump_Cabinet", make_standing_box((0.5, 2.0, 0.85), (-4.05, 0, 1.0)), p.body, bevel=0.03)
    m.add("Lockers", make_standing_box((1.5, 0.42, 0.55), (0.05, 1.0, 0.6)), p.body, mirror=True, bevel=0.03)
    hose = join_shapes(make_cylinder((-3.4, y, 1.42), (1.3, y, 1.42), 0.09, sides=10) for y in (-1.16, 1.16))
    m.add("Hose_Tubes", hose, p.dark, bevel=0)
    m.add("Rear_Bumper", make_standing_box((0.14, 2.3, 0.2), (-4.3, 0, 0.7)), p.dark, bevel=0.02)
    m.add("Tail_Lamps", make_standing_box((0.06, 0.24, 0.1), (-4.38, 0.95, 0.75)), p.red, mirror=True, bevel=0.01)
