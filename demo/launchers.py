"""Three surface-to-air missile systems of generic type: big canisters, missiles on rails, a turret with radars."""

from __future__ import annotations

from pathlib import Path

import bpy
import numpy as np

from hulldown.demo import chassis, materials
from hulldown.demo.chassis import Paints, Running, add_antenna, make_hatch, smoke_launchers
from hulldown.demo.model import BlendModel
from hulldown.demo.shapes import (
    Shape,
    extrude_about_middle,
    extrude_along_y,
    join_shapes,
    make_corner_box,
    make_cylinder,
    make_standing_box,
    revolve_about_x,
    revolve_about_y,
    stack_outlines,
)
from hulldown.demo.truck_parts import add_flat_cab


def make_missile(length: float, radius: float) -> Shape:
    """Return a missile along +x from x = 0: ogive nose, four wings at mid-body, four fins at the tail."""
    nose = [(length * (0.80 + 0.2 * t), radius * np.sqrt(1 - t**1.6)) for t in np.linspace(0, 0.98, 6)]
    body = revolve_about_x([(0, radius * 0.7), (0.05, radius), *((float(x), float(r)) for x, r in nose)], sides=14)
    wings, fins = (
        extrude_along_y(outline, -0.012, 0.012).scaled(length, 1, radius * height).moved(z=radius * 0.9)
        for outline, height in (
            ([(0.40, 0), (0.62, 0), (0.46, 1), (0.40, 1)], 2.1),
            ([(0.02, 0), (0.13, 0), (0.07, 1), (0.02, 1)], 2.0),
        )
    )
    return body + join_shapes((wings + fins).turned("x", a) for a in (45, 135, 225, 315))


def make_dish(radius: float, depth: float) -> Shape:
    """Return a parabolic reflector, its back at the origin, looking along +x, with a feed horn on struts."""
    bowl = [(radius * t, depth * t * t) for t in np.linspace(0.02, 1, 7)]
    skin = revolve_about_y([*bowl, *((r, y + 0.04) for r, y in reversed(bowl))], sides=24).turned("z", -90)
    struts = join_shapes(
        make_cylinder((depth, radius * 0.9 * np.cos(a), radius * 0.9 * np.sin(a)), (depth + radius * 0.8, 0, 0), 0.02, sides=5)
        for a in np.radians([90, 210, 330])
    )
    return skin + struts + revolve_about_x([(depth + radius * 0.62, 0.05), (depth + radius * 0.9, 0.1)])


def build_canister_launcher(m: BlendModel, p: Paints, folder: Path) -> None:
    """Build an 8x8 launcher vehicle with four big missile canisters, half raised on a turntable."""
    axles = (3.9, 2.3, -1.5, -3.1)
    chassis.add_wheels_and_axles(m, p, axles, y=1.15, radius=0.68, width=0.5)
    chassis.add_ladder_frame(m, p, -4.7, 4.9, 1.3, y=0.5)
    add_flat_cab(m, p, x0=3.3, x1=5.2, z0=1.2, z1=2.75, half=1.45)
    m.add("Deck", extrude_about_middle([(-4.8, 1.3), (3.2, 1.3), (3.2, 1.5), (-4.8, 1.5)], 1.5), p.body, bevel=0.02)
    equipment_cabin = extrude_about_middle([(1.3, 1.5), (3.15, 1.5), (3.15, 2.7), (1.5, 2.7), (1.3, 2.5)], 1.4)
    m.add("Equipment_Cabin", equipment_cabin, p.body, bevel=0.04)
    cabin_louvres = join_shapes(make_corner_box((x, 1.4, 1.8), (x + 0.06, 1.43, 2.4)) for x in np.arange(1.6, 2.9, 0.12))
    m.add("Cabin_Louvres", cabin_louvres, p.dark, mirror=True, bevel=0)
    lockers = join_shapes(make_standing_box((1.1, 0.4, 0.55), (x, 1.25, 0.72)) for x in (0.75, -0.3))
    m.add("Lockers", lockers, p.body, mirror=True, bevel=0.03)
    chassis.add_mudguards(m, p, axles, y=1.15, radius=0.68, width=0.56)
    legs = join_shapes(
        make_cylinder((x, 1.4, 0.55), (x, 1.4, 1.4), 0.1) + make_cylinder((x, 1.4, 0.48), (x, 1.4, 0.56), 0.25, sides=16)
        for x in (1.1, -4.5)
    )
    m.add("Outriggers", legs, p.steel, mirror=True, bevel=0.01)
    m.add("Tail_Lamps", make_standing_box((0.06, 0.24, 0.1), (-4.84, 1.2, 1.32)), p.red, mirror=True, bevel=0.01)
    mast = make_cylinder((2.9, -1.1, 2.7), (2.9, -1.1, 3.6), 0.05) + make_standing_box((0.2, 0.5, 0.3), (2.9, -1.1, 3.5))
    m.add("Mast", mast, p.dark, bevel=0)

    m.pivot("turret", (-2.6, 0, 1.5), name="Launcher_Pivot")
    m.add("Turntable", make_cylinder((-2.6, 0, 1.5), (-2.6, 0, 1.72), 1.15, sides=28), p.dark, part="turret", bevel=0.02)
    cradle_arms = extrude_along_y([(-4.2, 1.7), (-1.2, 1.7), (-1.8, 2.0), (-3.4, 2.4), (-4.3, 2.3)], 0.95, 1.08)
    m.add("Cradle_Arms", cradle_arms, p.body, part="turret", mirror=True, bevel=0.02)
    hinge, rise = (-3.9, 0.0, 2.1), -38.0
    m.pivot("gun", hinge, on="turret", name="Barrel_Elevation")
    tubes, caps, bands, frame = [], [], [], []
    for y in (-0.53, 0.53):
        for z in (0.0, 1.02):
            body = make_cylinder((-4.7, y, 2.4 + z), (2.1, y, 2.4 + z), 0.46, sides=22)
            tubes.append(body)
            caps.append(
                make_cylinder((2.1, y, 2.4 + z), (2.16, y, 2.4 + z), 0.49, sides=22)
                + make_cylinder((-4.78, y, 2.4 + z), (-4.7, y, 2.4 + z), 0.49, sides=22)
            )
            bands += [make_cylinder((x, y, 2.4 + z), (x + 0.14, y, 2.4 + z), 0.5, sides=22) for x in (-3.6, -1.6, 0.6)]
    frame = [
        make_corner_box((-4.5, -1.0, 1.9), (-4.3, 1.0, 4.0)),
        make_corner_box((0.2, -1.02, 2.88), (0.35, 1.02, 2.94)),
        *(make_corner_box((-4.6, y - 0.08, 1.82), (0.9, y + 0.08, 1.95)) for y in (-0.75, 0.75)),
    ]
    for name, parts, paint in (
        ("Canisters", tubes, p.body),
        ("Canister_Caps", caps, p.dark),
        ("Canister_Bands", bands, p.steel),
        ("Cradle", frame, p.dark),
    ):
        m.add(name, join_shapes(parts).turned("y", rise, hinge), paint, part="gun", bevel=0.015, smooth=40)
    hoist_rams = make_cylinder((-2.0, 0.85, 1.85), (-0.85, 0.85, 3.2), 0.1)
    m.add("Hoist_Rams", hoist_rams, p.steel, part="turret", mirror=True, bevel=0)


def build_rail_launcher(m: BlendModel, p: Paints, folder: Path) -> None:
    """Build a tracked chassis with three finned missiles on rails over a turntable."""
    gear = Running(6, -2.15, 0.82, 0.34, 1.25, 0.42, sprocket=(2.95, 0.68, 0.28), idler=(-3.0, 0.6, 0.26))
    chassis.add_running_gear(m, p, gear)
    m.add("Hull_Lower", extrude_about_middle([(-3.3, 1.0), (-3.2, 0.45), (2.9, 0.45), (3.4, 0.95), (3.2, 1.1)], 1.02), p.body)
    hull_upper = extrude_about_middle([(-3.4, 0.98), (-3.4, 1.62), (1.7, 1.62), (3.5, 1.08), (3.45, 0.94)], 1.5)
    m.add("Hull_Upper", hull_upper, p.body, bevel=0.03)
    side_louvres = join_shapes(make_corner_box((x, 1.5, 1.2), (x + 0.05, 1.525, 1.5)) for x in np.arange(-2.9, -1.4, 0.1))
    m.add("Side_Louvres", side_louvres, p.dark, mirror=True, bevel=0)
    driver_windows = make_standing_box((0.02, 0.5, 0.24), (2.15, 0.75, 1.52)).turned("y", -52, (2.15, 0.75, 1.5))
    m.add("Driver_Windows", driver_windows, p.glass, bevel=0.005)
    m.add("Driver_Hatch", make_hatch(1.45, 0.8, 1.62, 0.27) + make_hatch(1.45, -0.8, 1.62, 0.27), p.body, bevel=0.01)
    deck_boxes = join_shapes(make_standing_box((0.9, 0.35, 0.25), (x, 1.28, 1.62)) for x in (-2.7, 0.5))
    m.add("Deck_Boxes", deck_boxes, p.body, mirror=True, bevel=0.03)
    chassis.add_lamps(m, p, x=3.0, y=1.2, z=1.36, radius=0.1, tail_x=-3.42, tail_z=1.3)
    tow_hooks = join_shapes(make_standing_box((0.16, 0.08, 0.2), (x, 0.8, 0.7)).with_mirror_image() for x in (3.35, -3.4))
    m.add("Tow_Hooks", tow_hooks, p.dark, bevel=0.01)
    add_antenna(m, p, (-3.0, 1.2, 1.6), height=1.1)
    add_antenna(m, p, (-3.0, -1.2, 1.6), height=1.1)

    ring = make_cylinder((-0.55, 0, 1.62), (-0.55, 0, 1.92), 0.98, 0.9, sides=26)
    m.add_part_on_mesh("turret", (-0.55, 0, 1.62), ring, p.body, bevel=0.02, name="Launcher")
    pedestal = extrude_along_y([(-1.7, 1.9), (0.2, 1.9), (-0.25, 2.45), (-1.35, 2.5)], 0.62, 0.76)
    m.add("Pedestal", pedestal, p.body, part="turret", mirror=True, bevel=0.02)
    m.add("Pedestal_Block", make_standing_box((0.9, 1.2, 0.4), (-0.9, 0, 1.88)), p.dark, part="turret", bevel=0.03)
    hinge, rise = (-0.8, 0.0, 2.4), -14.0
    m.pivot("gun", hinge, on="turret", name="Missile_Barrel_Axis")
    beams = [make_corner_box((-2.6, y - 0.09, 2.48), (1.9, y + 0.09, 2.66)) for y in (-0.95, 0, 0.95)]
    cross = [make_corner_box((x - 0.09, -1.1, 2.32), (x + 0.09, 1.1, 2.48)) for x in (-1.6, -0.8, 0.9)]
    m.add("Rails", join_shapes(beams + cross).turned("y", rise, hinge), p.body, part="gun", bevel=0.015)
    rockets = join_shapes(make_missile(5.7, 0.17).moved(-2.9, y, 2.95) for y in (-0.95, 0, 0.95))
    white = materials.plain_material("Missile_White", "#d9d8cf", rough=0.42)
    m.add("Missiles", rockets.turned("y", rise, hinge), white, part="gun", bevel=0, smooth=40)
    shoes = join_shapes(
        make_corner_box((x, y - 0.05, 2.64), (x + 0.3, y + 0.05, 2.82)) for x in (-2.2, 0.9) for y in (-0.95, 0, 0.95)
    )
    m.add("Launch_Shoes", shoes.turned("y", rise, hinge), p.steel, part="gun", bevel=0)


def build_turret_launcher(m: BlendModel, p: Paints, folder: Path) -> None:
    """Build a tracked vehicle whose turret carries missile boxes, a search dish on top and a flat tracking radar."""
    image = bpy.data.images.load(str(folder / "textures" / "forest_blocks.png"))
    image.pack()
    paint = materials.image_paint_material("Forest_Blocks", image, dust="#8d7c5f", by_uv=False)
    p = Paints(paint, p.rubber, p.steel, p.dark, p.glass, p.canvas, p.wood, p.lamp, p.red)
    gear = Running(6, -2.4, 0.92, 0.37, 1.35, 0.5, sprocket=(-3.35, 0.72, 0.3), idler=(3.2, 0.7, 0.29), rollers=3)
    chassis.add_running_gear(m, p, gear)
    m.add(
        "Hull_Lower", extrude_about_middle([(-3.75, 1.05), (-3.6, 0.48), (3.1, 0.48), (3.75, 0.95), (3.5, 1.1)], 1.08), p.body
    )
    hull_upper = extrude_about_middle([(-3.85, 1.02), (-3.85, 1.6), (2.1, 1.6), (3.85, 1.12), (3.75, 0.96)], 1.62)
    m.add("Hull_Upper", hull_upper, p.body, bevel=0.03)
    m.add("Track_Flaps", make_corner_box((-3.5, 1.6, 0.9), (3.3, 1.64, 1.3)), p.body, mirror=True, bevel=0.01)
    driver_window = make_standing_box((0.03, 0.9, 0.22), (2.5, 0, 1.52)).turned("y", -60, (2.5, 0, 1.5))
    m.add("Driver_Window", driver_window, p.glass, bevel=0.005)
    m.add("Exhaust", make_cylinder((-3.0, 1.62, 1.35), (-2.2, 1.72, 1.35), 0.12), p.steel, mirror=True, bevel=0)
    chassis.add_lamps(m, p, x=3.3, y=1.35, z=1.4, radius=0.1, tail_x=-3.88, tail_z=1.3)

    m.add_part_in_collection("turret", (-0.3, 0, 1.6), name="Turret")
    m.add("Ring", make_cylinder((-0.3, 0, 1.58), (-0.3, 0, 1.72), 1.3, sides=28), p.dark, part="turret", bevel=0)
    body = extrude_about_middle([(-2.0, 1.72), (1.0, 1.72), (1.35, 2.2), (1.05, 3.05), (-1.85, 3.05), (-2.0, 2.9)], 0.78)
    m.add("Shell", body, p.body, part="turret", bevel=0.03)
    m.add("Shell_Hatches", make_hatch(-0.2, -0.4, 3.05), p.body, part="turret", bevel=0.01)
    vents = join_shapes(make_corner_box((x, 0.78, 2.1), (x + 0.05, 0.8, 2.6)) for x in np.arange(-1.8, -0.9, 0.1))
    m.add("Vents", vents, p.dark, part="turret", mirror=True, bevel=0)
    panel = stack_outlines(
        [
            (2.0, [(0, -0.62), (0.28, -0.62), (0.28, 0.62), (0, 0.62)]),
            (3.55, [(-0.1, -0.62), (0.18, -0.62), (0.18, 0.62), (-0.1, 0.62)]),
        ]
    )
    m.add("Tracking_Panel", panel.moved(1.3), p.dark, part="turret", bevel=0.04)
    m.add("Panel_Frame", make_standing_box((0.24, 0.5, 0.5), (1.2, 0, 2.1)), p.body, part="turret", bevel=0.03)
    dish_mast = make_cylinder((-1.45, 0, 3.05), (-1.45, 0, 3.5), 0.16) + make_standing_box((0.4, 0.4, 0.3), (-1.45, 0, 3.4))
    m.add("Dish_Mast", dish_mast, p.body, part="turret", bevel=0.02)
    reflector = make_dish(0.9, 0.32).scaled(1, 1.25, 0.62).turned("y", -6).moved(-1.4, 0, 3.95)
    light = materials.plain_material("Radar_Gray", "#8b8f86", rough=0.5)
    m.add("Search_Dish", reflector, light, part="turret", bevel=0, smooth=50)
    m.add("Smoke_Launchers", smoke_launchers(0.6, 0.82, 1.9, tubes=3).with_mirror_image(), p.dark, part="turret", bevel=0)
    add_antenna(m, p, (-1.8, 0.6, 3.05), part="turret", height=0.8)
    hinge, rise = (-0.3, 0.0, 2.35), -16.0
    m.add_part_in_collection("gun", hinge, on="turret", name="Guns")
    cells, lids, gaps = [], [], []
    for z in (2.02, 2.46):
        for y in (0.92, 1.36):
            cells.append(make_corner_box((-1.5, y, z), (1.7, y + 0.4, z + 0.4)))
            lids.append(make_corner_box((1.7, y + 0.03, z + 0.03), (1.74, y + 0.37, z + 0.37)))
    gaps = [make_corner_box((x, 0.88, 1.98), (x + 0.12, 1.8, 2.9)) for x in (-1.2, 0.1, 1.3)]
    for name, parts, paint in (("Missile_Boxes", cells, p.body), ("Box_Lids", lids, p.dark), ("Box_Bands", gaps, p.steel)):
        m.add(name, join_shapes(parts).turned("y", rise, hinge), paint, part="gun", mirror=True, bevel=0.015)
    m.add("Trunnion", make_cylinder((-0.3, -0.95, 2.35), (-0.3, 0.95, 2.35), 0.18), p.dark, part="gun", bevel=0)
