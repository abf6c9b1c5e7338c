"""Two modern battle tanks of welded plates: one wedge-nosed, one slab-sided."""

from __future__ import annotations

from pathlib import Path

import bpy
import numpy as np

from hulldown.demo import chassis, materials
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
    make_standing_box,
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


def build_wedge_tank(m: BlendModel, p: Paints, folder: Path) -> None:
    """Build a modern tank with arrow-shaped add-on armor on its turret, deep skirts, seven road wheels."""
    gear = Running(7, -2.35, 0.78, 0.35, 1.47, 0.60, sprocket=(-3.15, 0.62, 0.33), idler=(3.1, 0.62, 0.31))
    chassis.add_running_gear(m, p, gear)
    m.add("Hull_Lower", extrude_about_middle([(-3.6, 1.1), (-3.3, 0.48), (3.0, 0.48), (3.72, 0.92), (3.3, 1.2)], 1.12), p.body)
    hull_upper = extrude_about_middle(
        [(-3.72, 1.12), (-3.75, 1.68), (0.4, 1.68), (1.7, 1.58), (3.86, 1.13), (3.72, 0.98), (3.2, 1.05)], 1.78
    )
    m.add("Hull_Upper", hull_upper, p.body, bevel=0.02)
    add_skirts(m, p, -3.5, 3.5, 1.80, 0.66, 1.42, 7)
    heavy = extrude_along_y([(1.5, 1.46), (1.5, 0.66), (3.5, 0.66), (3.62, 0.95), (3.4, 1.25), (2.4, 1.46)], 1.84, 1.93)
    m.add("Heavy_Skirts", heavy, p.body, mirror=True)
    m.add("Driver_Hatch", make_hatch(2.2, 0.55, 1.5, 0.26), p.body, bevel=0.01)
    add_engine_deck(m, p, -3.6, -1.7, 1.69, 1.6)
    exhaust_grille = join_shapes(make_corner_box((-3.80, y, 1.2), (-3.74, y + 0.06, 1.6)) for y in np.arange(-1.5, 1.5, 0.12))
    m.add("Exhaust_Grille", exhaust_grille, p.dark, bevel=0)
    add_tow_gear_and_tools(m, p, front=3.8, rear=-3.72, half=1.55, z=1.69)
    chassis.add_lamps(m, p, x=3.45, y=1.3, z=1.32, radius=0.08, tail_x=-3.78, tail_z=1.3)

    m.pivot("turret", (0.25, 0, 1.7), name="Turret_Yaw")
    low: Outline = [(1.55, 0.45), (1.35, 1.25), (-0.6, 1.42), (-2.25, 1.25), (-2.35, 0.9)]
    top: Outline = [(0.95, 0.42), (0.8, 1.05), (-0.7, 1.2), (-2.2, 1.08), (-2.3, 0.8)]
    shell = stack_outlines(
        [(1.72, outline_with_mirror_image(low)), (2.1, outline_with_mirror_image(low)), (2.46, outline_with_mirror_image(top))]
    )
    m.add("Shell", shell, p.body, part="turret", bevel=0.02)
    nose = stack_outlines(
        [
            (1.84, [(1.5, 0.4), (1.25, 1.3), (0.2, 1.46), (0.3, 0.4)]),
            (2.1, [(2.45, 0.38), (1.9, 1.12), (0.25, 1.58), (0.3, 0.38)]),
            (2.44, [(0.95, 0.38), (0.8, 1.06), (0.1, 1.3), (0.2, 0.38)]),
        ]
    )
    m.add("Wedge", nose.with_mirror_image(), p.body, part="turret", bevel=0.015)
    basket = stack_outlines(
        [
            (1.85, outline_with_mirror_image([(-2.3, 1.0), (-2.9, 0.98)])),
            (2.25, outline_with_mirror_image([(-2.3, 1.02), (-2.95, 1.0)])),
        ]
    )
    m.add("Bustle", basket, p.body, part="turret", bevel=0.02)
    m.add("Hatches", make_hatch(-0.3, -0.55, 2.46) + make_hatch(-0.4, 0.55, 2.46), p.body, part="turret", bevel=0.01)
    m.add("Gunner_Sight", make_standing_box((0.5, 0.42, 0.3), (0.55, -0.62, 2.44)), p.body, part="turret", bevel=0.03)
    panorama_sight = make_cylinder((-0.75, -0.05, 2.4), (-0.75, -0.05, 2.72), 0.17) + make_standing_box(
        (0.3, 0.34, 0.32), (-0.75, -0.05, 2.7)
    )
    m.add("Panorama_Sight", panorama_sight, p.body, part="turret", bevel=0.02)
    sight_glass = make_standing_box((0.02, 0.24, 0.18), (-0.59, -0.05, 2.78)) + make_standing_box(
        (0.02, 0.3, 0.16), (0.81, -0.62, 2.52)
    )
    m.add("Sight_Glass", sight_glass, p.glass, part="turret", bevel=0)
    m.add("Smoke_Launchers", smoke_launchers(-0.9, 1.4, 2.15).with_mirror_image(), p.dark, part="turret", bevel=0)
    add_machine_gun(m, p, (-0.25, 0.75, 2.55))
    add_antenna(m, p, (-2.0, 0.8, 2.45), part="turret")
    add_antenna(m, p, (-2.0, -0.8, 2.45), height=0.8, part="turret")
    m.pivot("gun", (1.2, 0, 2.1), on="turret", name="Gun")
    mantlet = stack_outlines(
        [
            (1.88, outline_with_mirror_image([(1.75, 0.33), (1.1, 0.35)])),
            (2.32, outline_with_mirror_image([(1.5, 0.3), (1.0, 0.33)])),
        ]
    )
    m.add("Mantlet", mantlet, p.body, part="gun", bevel=0.03)
    m.add("Barrel", make_barrel(1.6, 6.5, 2.1, 0.085, evacuator=0.5), p.body, part="gun", bevel=0)


def build_slab_tank(m: BlendModel, p: Paints, folder: Path) -> None:
    """Build a wide, low desert tank of flat plates, painted from an external image."""
    image = bpy.data.images.load(str(folder / "textures" / "desert_blocks.png"))
    paint = materials.image_paint_material("Desert_Blocks", image, dust="#b59b74", by_uv=True)
    p = Paints(paint, p.rubber, p.steel, p.dark, p.glass, p.canvas, p.wood, p.lamp, p.red)
    gear = Running(7, -2.5, 0.8, 0.33, 1.5, 0.62, sprocket=(-3.35, 0.68, 0.34), idler=(3.15, 0.62, 0.33))
    chassis.add_running_gear(m, p, gear)
    m.add("Hull_Lower", extrude_about_middle([(-3.85, 1.2), (-3.5, 0.46), (3.1, 0.46), (3.8, 0.95), (3.4, 1.2)], 1.15), p.body)
    hull_upper = extrude_about_middle(
        [(-3.9, 1.1), (-3.95, 1.62), (-1.4, 1.62), (-1.2, 1.5), (1.9, 1.42), (3.95, 1.14), (3.85, 0.98), (3.3, 1.05)], 1.83
    )
    m.add("Hull_Upper", hull_upper, p.body, bevel=0.02)
    add_skirts(m, p, -3.1, 3.6, 1.85, 0.7, 1.36, 7)
    m.add("Driver_Hatch", make_standing_box((0.7, 0.7, 0.09), (2.15, 0, 1.38)), p.body, bevel=0.03)
    rear_grille = join_shapes(make_corner_box((-4.0, -1.5, z), (-3.92, 1.5, z + 0.05)) for z in np.arange(1.16, 1.58, 0.09))
    m.add("Rear_Grille", rear_grille, p.dark, bevel=0)
    add_engine_deck(m, p, -3.8, -1.7, 1.63, 1.6)
    add_tow_gear_and_tools(m, p, front=3.9, rear=-3.9, half=1.6, z=1.6)
    chassis.add_lamps(m, p, x=3.55, y=1.45, z=1.3, radius=0.08, tail_x=-4.0, tail_z=1.3)

    m.add_part_in_collection("turret", (0.1, 0, 1.52), name="Turret")
    low: Outline = [(2.1, 0.42), (1.45, 1.72), (-1.1, 1.78), (-2.1, 1.55), (-2.15, 1.2)]
    top: Outline = [(1.75, 0.4), (1.15, 1.42), (-1.0, 1.5), (-2.05, 1.38), (-2.1, 1.1)]
    shell = stack_outlines(
        [(1.56, outline_with_mirror_image(low)), (1.72, outline_with_mirror_image(low)), (2.34, outline_with_mirror_image(top))]
    )
    m.add("Shell", shell, p.body, part="turret", bevel=0.02)
    racks = join_shapes(
        make_bent_bar([(-2.1, -1.35, z), (-2.9, -1.3, z), (-2.9, 1.3, z), (-2.1, 1.35, z)], 0.025) for z in (1.75, 2.0, 2.25)
    )
    m.add("Racks", racks, p.dark, part="turret", bevel=0)
    m.add("Rack_Floor", make_corner_box((-2.9, -1.28, 1.72), (-2.1, 1.28, 1.75)), p.dark, part="turret", bevel=0)
    rack_load = join_shapes(
        [make_standing_box((0.55, 0.8, 0.4), (-2.5, -0.75, 1.75)), make_cylinder((-2.5, -0.2, 1.95), (-2.5, 1.1, 1.95), 0.2)]
    )
    m.add("Rack_Load", rack_load, p.canvas, part="turret", bevel=0.06)
    m.add("Side_Boxes", make_standing_box((1.3, 0.26, 0.36), (-0.9, 1.76, 1.8)), p.body, part="turret", bevel=0.03, mirror=True)
    m.add("Hatches", make_hatch(-0.2, -0.62, 2.38, 0.34) + make_hatch(-0.3, 0.65, 2.34), p.body, part="turret", bevel=0.01)
    blow_panels = join_shapes(make_standing_box((0.75, 0.85, 0.05), (-1.5, y, 2.32)) for y in (-0.5, 0.5))
    m.add("Blow_Panels", blow_panels, p.body, part="turret", bevel=0.015)
    m.add("Gunner_Sight", make_standing_box((0.6, 0.5, 0.36), (0.75, -0.75, 2.3)), p.body, part="turret", bevel=0.04)
    m.add("Sight_Glass", make_standing_box((0.02, 0.34, 0.2), (1.06, -0.75, 2.38)), p.glass, part="turret", bevel=0)
    m.add("Smoke_Launchers", smoke_launchers(0.95, 1.62, 1.98, tubes=4).with_mirror_image(), p.dark, part="turret", bevel=0)
    add_machine_gun(m, p, (0.05, -0.62, 2.46))
    add_machine_gun(m, p, (0.0, 0.7, 2.4))
    add_antenna(m, p, (-1.9, 1.1, 2.3), part="turret")
    add_antenna(m, p, (-1.9, -1.1, 2.3), height=1.2, part="turret")
    m.add_part_in_collection("gun", (1.4, 0, 1.98), on="turret", name="Main_Gun")
    mantlet = stack_outlines(
        [
            (1.7, outline_with_mirror_image([(2.3, 0.34), (1.4, 0.38)])),
            (2.28, outline_with_mirror_image([(2.05, 0.3), (1.4, 0.36)])),
        ]
    )
    m.add("Mantlet", mantlet, p.body, part="gun", bevel=0.03)
    m.add("Barrel", make_barrel(2.15, 6.3, 1.98, 0.085, evacuator=0.48), p.body, part="gun", bevel=0)
