"""Two battle tanks with cast turrets: one domed and low, one a classic of the 1950s."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from hulldown.demo import chassis
from hulldown.demo.chassis import Paints, Running, add_antenna, make_hatch, smoke_launchers
from hulldown.demo.model import BlendModel
from hulldown.demo.shapes import (
    Outline,
    extrude_about_middle,
    extrude_along_y,
    join_shapes,
    make_bent_bar,
    make_corner_box,
    make_cylinder,
    make_ellipsoid,
    make_standing_box,
    revolve_about_x,
    stack_outlines,
)
from hulldown.demo.tank_parts import (
    add_engine_deck,
    add_machine_gun,
    add_skirts,
    add_tow_gear_and_tools,
    make_barrel,
    outline_with_mirror_image,
)


def build_dome_tank(m: BlendModel, p: Paints, folder: Path) -> None:
    """Build a low tank with a round cast turret, reactive bricks, fuel drums at the rear, six road wheels."""
    gear = Running(6, -2.3, 0.86, 0.38, 1.42, 0.56, sprocket=(-3.05, 0.66, 0.3), idler=(2.85, 0.66, 0.27))
    chassis.add_running_gear(m, p, gear)
    m.add("Hull_Lower", extrude_about_middle([(-3.35, 1.0), (-3.2, 0.45), (2.7, 0.45), (3.3, 0.9), (3.0, 1.1)], 1.1), p.body)
    hull_upper = extrude_about_middle([(-3.4, 1.0), (-3.35, 1.4), (-1.3, 1.46), (1.5, 1.46), (3.35, 0.94), (3.2, 0.84)], 1.16)
    m.add("Hull_Upper", hull_upper, p.body, bevel=0.02)
    fenders = extrude_along_y([(-3.35, 1.1), (-3.35, 1.14), (2.9, 1.14), (3.3, 0.95), (3.28, 0.92), (2.9, 1.1)], 1.1, 1.74)
    m.add("Fenders", fenders, p.body, mirror=True, bevel=0.006)
    boxes = join_shapes(make_corner_box((x, 1.2, 1.14), (x + 1.05, 1.7, 1.4)) for x in (-2.9, -1.75, -0.6, 0.55))
    m.add("Fender_Boxes", boxes, p.body, mirror=True, bevel=0.025)
    add_skirts(m, p, -3.0, 2.8, 1.74, 0.72, 1.12, 5)
    bricks = join_shapes(
        make_standing_box((0.32, 0.3, 0.09), (x, y, 0)).turned("y", 15.7, (1.5, 0, 0)).moved(0, 0, 1.46)
        for x in (1.75, 2.1, 2.45)
        for y in np.arange(-0.9, 1.0, 0.36)
    )
    m.add("Glacis_Bricks", bricks, p.body, bevel=0.015)
    m.add(
        "Splash_Board", make_standing_box((0.03, 1.5, 0.16), (1.65, 0, 1.42)).turned("y", -20, (1.65, 0, 1.42)), p.body, bevel=0
    )
    drums = join_shapes(make_cylinder((-3.62, y, 1.38), (-3.62, y + 0.98, 1.38), 0.28, sides=18) for y in (-1.04, 0.06))
    bands = join_shapes(
        make_cylinder((-3.62, y, 1.38), (-3.62, y + 0.05, 1.38), 0.3, sides=18) for y in (-0.85, -0.3, 0.25, 0.8)
    )
    m.add("Fuel_Drums", drums, p.body, bevel=0.02)
    m.add("Drum_Bands", bands, p.dark, bevel=0)
    m.add("Log", make_cylinder((-3.55, -1.3, 0.93), (-3.55, 1.3, 0.93), 0.11), p.wood, bevel=0)
    add_engine_deck(m, p, -3.2, -1.5, 1.45, 1.05)
    m.add("Driver_Hatch", make_hatch(1.55, 0, 1.42, 0.25), p.body, bevel=0.01)
    add_tow_gear_and_tools(m, p, front=3.25, rear=-3.4, half=1.05, z=1.47)
    chassis.add_lamps(m, p, x=3.0, y=0.85, z=1.18, radius=0.09)

    shell = make_ellipsoid((1.42, 1.36, 0.72), (0, 0, 1.52), floor=-0.02, sides=24, rings=9).moved(0.15)
    m.add_part_on_mesh("turret", (0.15, 0, 1.5), shell, p.body, bevel=0, name="Turret")
    ring = make_cylinder((0.15, 0, 1.4), (0.15, 0, 1.53), 1.15, sides=24)
    m.add("Ring", ring, p.body, part="turret", bevel=0)
    cheeks = join_shapes(
        make_standing_box((0.2, 0.36, 0.34), (1.3, 0, 1.58)).turned("y", 24, (1.3, 0, 1.6)).turned("z", a).moved(0.15)
        for a in (22, 40, 58, 76)
    )
    m.add("Bricks", cheeks.with_mirror_image(), p.body, part="turret", bevel=0.015)
    cupola = make_cylinder((-0.15, 0.5, 2.02), (-0.15, 0.5, 2.26), 0.36, 0.33, sides=18) + make_hatch(-0.15, 0.5, 2.24, 0.27)
    m.add("Cupola", cupola, p.body, part="turret", bevel=0.01)
    m.add("Loader_Hatch", make_hatch(-0.1, -0.5, 2.12, 0.27), p.body, part="turret", bevel=0.01)
    m.add("Snorkel", make_cylinder((-1.5, 0.95, 1.75), (-1.5, -0.95, 1.75), 0.13), p.body, part="turret", bevel=0.01)
    m.add("Stowage", make_standing_box((0.5, 1.2, 0.34), (-1.36, 0, 1.86)), p.canvas, part="turret", bevel=0.05)
    m.add("Smoke_Launchers", smoke_launchers(0.95, 0.98, 1.98).with_mirror_image(), p.dark, part="turret", bevel=0)
    add_machine_gun(m, p, (0.2, 0.5, 2.32))
    add_antenna(m, p, (-0.9, -0.7, 1.95), part="turret", lean=0.4)
    m.pivot("gun", (1.2, 0, 1.82), on="turret", name="Gun")
    m.add("Mantlet", make_ellipsoid((0.5, 0.42, 0.3), (1.45, 0, 1.82), sides=14, rings=8), p.canvas, part="gun", bevel=0)
    m.add("Barrel", make_barrel(1.7, 5.95, 1.82, 0.08, evacuator=0.62), p.body, part="gun", bevel=0)
    searchlight = revolve_about_x([(1.45, 0.16), (1.8, 0.21), (1.82, 0.19)]).moved(y=-0.55, z=2.0)
    m.add("Searchlight", searchlight, p.dark, part="gun", bevel=0)
    searchlight_glass = revolve_about_x([(1.81, 0.18), (1.835, 0.12)]).moved(y=-0.55, z=2.0)
    m.add("Searchlight_Glass", searchlight_glass, p.glass, part="gun", bevel=0)
    root_scale = 0.01  # as an importer of centimeter files leaves it
    m.parent_all_to_scaled_root(root_scale)


def build_classic_tank(m: BlendModel, p: Paints, folder: Path) -> None:
    """Build a tank of the 1950s: rounded long turret, open running gear with rollers, broad fenders full of boxes."""
    gear = Running(6, -2.2, 0.84, 0.36, 1.32, 0.58, sprocket=(-3.1, 0.82, 0.32), idler=(2.95, 0.78, 0.3), rollers=4)
    chassis.add_running_gear(m, p, gear)
    hull_lower = stack_outlines(
        [
            (0.45, outline_with_mirror_image([(2.5, 0.7), (2.3, 1.0), (-3.0, 1.0)])),
            (1.0, outline_with_mirror_image([(3.3, 0.62), (2.7, 1.02), (-3.35, 1.02)])),
            (1.5, outline_with_mirror_image([(1.9, 0.7), (1.4, 1.02), (-3.4, 1.02)])),
        ]
    )
    m.add("Hull_Lower", hull_lower, p.body, bevel=0.04, smooth=60)
    fenders = extrude_along_y(
        [(-3.4, 1.28), (-3.55, 1.15), (-3.55, 1.12), (-3.35, 1.24), (2.95, 1.24), (3.4, 1.05), (3.42, 1.08), (3.0, 1.28)],
        0.98,
        1.7,
    )
    m.add("Fenders", fenders, p.body, mirror=True, bevel=0.006)
    boxes = join_shapes(
        make_corner_box((x, 1.12, 1.28), (x + w, 1.66, 1.56)) for x, w in ((-2.9, 0.8), (-2.0, 1.1), (-0.8, 0.7), (0.5, 1.2))
    )
    m.add("Fender_Boxes", boxes, p.body, mirror=True, bevel=0.025)
    m.add("Mufflers", make_cylinder((-2.6, 1.2, 1.66), (-1.5, 1.2, 1.66), 0.13), p.steel, mirror=True, bevel=0.02)
    add_engine_deck(m, p, -3.3, -1.4, 1.5, 0.98)
    m.add("Driver_Hatch", make_hatch(1.5, 0.35, 1.42, 0.26), p.body, bevel=0.01)
    add_tow_gear_and_tools(m, p, front=3.25, rear=-3.42, half=1.0, z=1.52)
    chassis.add_lamps(m, p, x=2.75, y=0.95, z=1.42, radius=0.11, tail_x=-3.42, tail_z=1.3)
    m.add_crate("Stowage_Crate", (0.7, 0.5, 0.4), (-3.0, -1.35, 1.28), p.wood, turn_deg=4)
    m.add_crate("Jerrycans", (0.5, 0.34, 0.46), (-3.1, 1.35, 1.56), p.steel, turn_deg=-3)

    m.pivot("turret", (0.2, 0, 1.5), name="turret_pivot")
    rings: list[tuple[float, Outline]] = []
    for z, grow in ((1.52, 0.86), (1.78, 1.0), (2.08, 0.97), (2.3, 0.82), (2.4, 0.55)):
        angles = np.linspace(0, 2 * np.pi, 25)[:-1]
        x = np.where(np.cos(angles) > 0, 1.45, 1.85) * np.cos(angles)
        rings.append((z, [(0.1 + grow * float(a), grow * float(b)) for a, b in zip(x, 1.22 * np.sin(angles), strict=True)]))
    m.add("Casting", stack_outlines(rings), p.body, part="turret", bevel=0, smooth=70)
    m.add("Collar", make_cylinder((0.2, 0, 1.44), (0.2, 0, 1.56), 1.02, sides=24), p.body, part="turret", bevel=0)
    cupola = make_cylinder((-0.3, -0.5, 2.3), (-0.3, -0.5, 2.62), 0.42, 0.36, sides=18) + make_hatch(-0.3, -0.5, 2.6, 0.28)
    m.add("Cupola", cupola, p.body, part="turret", bevel=0.015)
    m.add("Loader_Hatch", make_hatch(-0.2, 0.5, 2.36, 0.3), p.body, part="turret", bevel=0.01)
    rail = join_shapes(
        make_bent_bar([(-1.3, -0.8, z), (-2.15, -0.7, z), (-2.15, 0.7, z), (-1.3, 0.8, z)], 0.025) for z in (1.85, 2.15)
    )
    m.add("Bustle_Rails", rail, p.dark, part="turret", bevel=0)
    bustle_rolls = join_shapes(make_cylinder((-1.9, -0.6, z), (-1.9, 0.6, z), 0.17) for z in (1.98,))
    m.add("Bustle_Rolls", bustle_rolls, p.canvas, part="turret", bevel=0.03)
    rangefinder_ears = make_ellipsoid((0.22, 0.14, 0.2), (0.25, 1.12, 2.16), sides=12, rings=6).with_mirror_image()
    m.add("Rangefinder_Ears", rangefinder_ears, p.body, part="turret", bevel=0)
    add_machine_gun(m, p, (-0.1, -0.5, 2.7))
    add_antenna(m, p, (-1.2, 0.5, 2.25), part="turret", height=1.2, lean=0.5)
    m.pivot("gun", (1.2, 0, 1.95), on="turret", name="Gun_Elevation")
    mantlet = stack_outlines(
        [
            (1.68, outline_with_mirror_image([(1.6, 0.4), (1.15, 0.62)])),
            (1.95, outline_with_mirror_image([(1.85, 0.4), (1.1, 0.7)])),
            (2.24, outline_with_mirror_image([(1.55, 0.38), (1.05, 0.62)])),
        ]
    )
    m.add("Mantlet", mantlet, p.body, part="gun", bevel=0.04)
    m.add("Barrel", make_barrel(1.75, 5.7, 1.95, 0.085, evacuator=0.72, brake=True), p.body, part="gun", bevel=0)
    light = revolve_about_x([(1.5, 0.2), (1.95, 0.34), (1.98, 0.32)]).moved(y=0.0, z=2.55)
    light += make_standing_box((0.2, 0.16, 0.36), (1.62, 0.0, 2.1))
    m.add("Searchlight", light, p.body, part="gun", bevel=0)
    m.add("Searchlight_Glass", revolve_about_x([(1.97, 0.3), (2.0, 0.2)]).moved(z=2.55), p.glass, part="gun", bevel=0)
