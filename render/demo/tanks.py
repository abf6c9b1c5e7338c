"""Four main battle tanks of generic type: wedge-nosed, domed, slab-sided, and a classic of the 1950s."""

from __future__ import annotations

from pathlib import Path

import bpy
import numpy as np

from render.demo import chassis, materials
from render.demo.chassis import Paints, Running, antenna, hatch, smoke_launchers
from render.demo.model import Model
from render.demo.shapes import (
    Outline,
    Shape,
    block,
    box,
    ellipsoid,
    joined,
    path_tube,
    prism,
    profile_tube,
    slab,
    stack,
    tube,
)


def mirrored(outline: Outline) -> Outline:
    """A plan outline (x, y) closed by its mirror image; give the left half from front to rear."""
    return [*outline, *((x, -y) for x, y in reversed(outline))]


def barrel(x0: float, x1: float, z: float, radius: float, *, evacuator: float, brake: bool = False) -> Shape:
    """A gun barrel with thermal sleeve bands, a bore evacuator at a share of its length and maybe a muzzle brake."""
    e, length = x0 + evacuator * (x1 - x0), x1 - x0
    stations = [
        (x0, radius * 1.5),
        (x0 + 0.3, radius * 1.25),
        (e - 0.42, radius * 1.2),
        (e - 0.36, radius * 1.75),
        (e + 0.36, radius * 1.75),
        (e + 0.42, radius),
    ]
    if brake:
        stations += [(x1 - 0.5, radius * 0.95), (x1 - 0.48, radius * 1.7), (x1, radius * 1.6)]
    else:
        stations += [(x1 - 0.12, radius * 0.95), (x1 - 0.11, radius * 1.15), (x1 - 0.005, radius * 1.15)]
    stations += [(x1, radius * 0.7), (x1 - 0.2, radius * 0.6)]
    bands = joined(tube((x, 0, z), (x + 0.05, 0, z), radius * 1.32) for x in x0 + length * np.array([0.18, 0.3]))
    return profile_tube(stations, z=z, sides=16) + bands


def skirts(m: Model, p: Paints, x0: float, x1: float, y: float, z0: float, z1: float, panels: int) -> None:
    """A row of side plates with gaps, by an array and a mirror modifier."""
    step = (x1 - x0) / panels
    plate = prism(
        [(x0 + 0.02, z1), (x0 + 0.02, z0 + 0.05), (x0 + 0.1, z0), (x0 + step - 0.02, z0), (x0 + step - 0.02, z1)],
        y,
        y + 0.05,
    )
    m.add("Side_Skirts", plate, p.body, mirror=True, copies=(panels, step))


def engine_deck(m: Model, p: Paints, x0: float, x1: float, z: float, half: float) -> None:
    """Louvred grilles on the rear deck."""
    frame = joined(
        block((x0, y - half * 0.42, z - 0.02), (x1, y + half * 0.42, z + 0.03)) for y in (-half * 0.5, half * 0.5)
    )
    m.add("Engine_Covers", frame, p.body, bevel=0.01)
    bars = joined(
        block((x, y - half * 0.36, z + 0.03), (x + 0.05, y + half * 0.36, z + 0.06))
        for x in np.arange(x0 + 0.1, x1 - 0.1, 0.11)
        for y in (-half * 0.5, half * 0.5)
    )
    m.add("Engine_Louvres", bars, p.dark, bevel=0)


def fittings(m: Model, p: Paints, *, front: float, rear: float, half: float, z: float) -> None:
    """Tow hooks, cables and a rear stowage of tools."""
    hooks = joined(box((0.16, 0.08, 0.2), (x, 0.85, 0.72)).pair() for x in (front, rear))
    m.add("Tow_Hooks", hooks, p.dark, bevel=0.01)
    cable = path_tube(
        [
            (front - 1.9, half, z),
            (front - 2.6, half + 0.08, z + 0.03),
            (0, half + 0.05, z + 0.03),
            (rear + 1.4, half, z),
        ],
        0.035,
    )
    m.add("Tow_Cable", cable, p.steel, bevel=0, mirror=True)
    m.add("Shovel", block((-1.2, half - 0.28, z), (0.1, half - 0.23, z + 0.05)), p.wood, bevel=0)


def machine_gun(m: Model, p: Paints, at: tuple[float, float, float], *, part: str = "turret") -> None:
    """A heavy machine gun on a pintle."""
    x, y, z = at
    gun = box((0.55, 0.12, 0.15), (x, y, z + 0.25)) + tube(
        (x + 0.2, y, z + 0.34), (x + 1.25, y, z + 0.4), 0.025, sides=8
    )
    m.add(
        "Roof_MG",
        gun + tube(at, (x, y, z + 0.28), 0.04) + box((0.2, 0.14, 0.2), (x + 0.05, y + 0.15, z + 0.22)),
        p.dark,
        bevel=0.008,
        part=part,
    )


def mbt_wedge(m: Model, p: Paints, folder: Path) -> None:
    """A modern tank with arrow-shaped add-on armour on its turret, deep skirts, seven road wheels."""
    gear = Running(7, -2.35, 0.78, 0.35, 1.47, 0.60, sprocket=(-3.15, 0.62, 0.33), idler=(3.1, 0.62, 0.31))
    chassis.tracks(m, p, gear)
    m.add("Hull_Lower", slab([(-3.6, 1.1), (-3.3, 0.48), (3.0, 0.48), (3.72, 0.92), (3.3, 1.2)], 1.12), p.body)
    m.add(
        "Hull_Upper",
        slab([(-3.72, 1.12), (-3.75, 1.68), (0.4, 1.68), (1.7, 1.58), (3.86, 1.13), (3.72, 0.98), (3.2, 1.05)], 1.78),
        p.body,
        bevel=0.02,
    )
    skirts(m, p, -3.5, 3.5, 1.80, 0.66, 1.42, 7)
    heavy = prism([(1.5, 1.46), (1.5, 0.66), (3.5, 0.66), (3.62, 0.95), (3.4, 1.25), (2.4, 1.46)], 1.84, 1.93)
    m.add("Heavy_Skirts", heavy, p.body, mirror=True)
    m.add("Driver_Hatch", hatch(2.2, 0.55, 1.5, 0.26), p.body, bevel=0.01)
    engine_deck(m, p, -3.6, -1.7, 1.69, 1.6)
    m.add(
        "Exhaust_Grille",
        joined(block((-3.80, y, 1.2), (-3.74, y + 0.06, 1.6)) for y in np.arange(-1.5, 1.5, 0.12)),
        p.dark,
        bevel=0,
    )
    fittings(m, p, front=3.8, rear=-3.72, half=1.55, z=1.69)
    chassis.lamps(m, p, x=3.45, y=1.3, z=1.32, radius=0.08, tail_x=-3.78, tail_z=1.3)

    m.pivot("turret", (0.25, 0, 1.7), name="Turret_Yaw")
    low: Outline = [(1.55, 0.45), (1.35, 1.25), (-0.6, 1.42), (-2.25, 1.25), (-2.35, 0.9)]
    top: Outline = [(0.95, 0.42), (0.8, 1.05), (-0.7, 1.2), (-2.2, 1.08), (-2.3, 0.8)]
    m.add(
        "Shell",
        stack([(1.72, mirrored(low)), (2.1, mirrored(low)), (2.46, mirrored(top))]),
        p.body,
        part="turret",
        bevel=0.02,
    )
    nose = stack(
        [
            (1.84, [(1.5, 0.4), (1.25, 1.3), (0.2, 1.46), (0.3, 0.4)]),
            (2.1, [(2.45, 0.38), (1.9, 1.12), (0.25, 1.58), (0.3, 0.38)]),
            (2.44, [(0.95, 0.38), (0.8, 1.06), (0.1, 1.3), (0.2, 0.38)]),
        ]
    )
    m.add("Wedge", nose.pair(), p.body, part="turret", bevel=0.015)
    basket = stack([(1.85, mirrored([(-2.3, 1.0), (-2.9, 0.98)])), (2.25, mirrored([(-2.3, 1.02), (-2.95, 1.0)]))])
    m.add("Bustle", basket, p.body, part="turret", bevel=0.02)
    m.add("Hatches", hatch(-0.3, -0.55, 2.46) + hatch(-0.4, 0.55, 2.46), p.body, part="turret", bevel=0.01)
    m.add("Gunner_Sight", box((0.5, 0.42, 0.3), (0.55, -0.62, 2.44)), p.body, part="turret", bevel=0.03)
    m.add(
        "Panorama_Sight",
        tube((-0.75, -0.05, 2.4), (-0.75, -0.05, 2.72), 0.17) + box((0.3, 0.34, 0.32), (-0.75, -0.05, 2.7)),
        p.body,
        part="turret",
        bevel=0.02,
    )
    m.add(
        "Sight_Glass",
        box((0.02, 0.24, 0.18), (-0.59, -0.05, 2.78)) + box((0.02, 0.3, 0.16), (0.81, -0.62, 2.52)),
        p.glass,
        part="turret",
        bevel=0,
    )
    m.add("Smoke_Launchers", smoke_launchers(-0.9, 1.4, 2.15).pair(), p.dark, part="turret", bevel=0)
    machine_gun(m, p, (-0.25, 0.75, 2.55))
    antenna(m, p, (-2.0, 0.8, 2.45), part="turret")
    antenna(m, p, (-2.0, -0.8, 2.45), height=1.7, part="turret")
    m.pivot("gun", (1.2, 0, 2.1), on="turret", name="Gun")
    m.add(
        "Mantlet",
        stack([(1.88, mirrored([(1.75, 0.33), (1.1, 0.35)])), (2.32, mirrored([(1.5, 0.3), (1.0, 0.33)]))]),
        p.body,
        part="gun",
        bevel=0.03,
    )
    m.add("Barrel", barrel(1.6, 6.5, 2.1, 0.085, evacuator=0.5), p.body, part="gun", bevel=0)


def mbt_dome(m: Model, p: Paints, folder: Path) -> None:
    """A low tank with a round cast turret, reactive bricks, fuel drums at the rear, six road wheels."""
    gear = Running(6, -2.3, 0.86, 0.38, 1.42, 0.56, sprocket=(-3.05, 0.66, 0.3), idler=(2.85, 0.66, 0.27))
    chassis.tracks(m, p, gear)
    m.add("Hull_Lower", slab([(-3.35, 1.0), (-3.2, 0.45), (2.7, 0.45), (3.3, 0.9), (3.0, 1.1)], 1.1), p.body)
    m.add(
        "Hull_Upper",
        slab([(-3.4, 1.0), (-3.35, 1.4), (-1.3, 1.46), (1.5, 1.46), (3.35, 0.94), (3.2, 0.84)], 1.16),
        p.body,
        bevel=0.02,
    )
    m.add(
        "Fenders",
        prism([(-3.35, 1.1), (-3.35, 1.14), (2.9, 1.14), (3.3, 0.95), (3.28, 0.92), (2.9, 1.1)], 1.1, 1.74),
        p.body,
        mirror=True,
        bevel=0.006,
    )
    boxes = joined(block((x, 1.2, 1.14), (x + 1.05, 1.7, 1.4)) for x in (-2.9, -1.75, -0.6, 0.55))
    m.add("Fender_Boxes", boxes, p.body, mirror=True, bevel=0.025)
    skirts(m, p, -3.0, 2.8, 1.74, 0.72, 1.12, 5)
    bricks = joined(
        box((0.32, 0.3, 0.09), (x, y, 0)).turned("y", 15.7, (1.5, 0, 0)).moved(0, 0, 1.46)
        for x in (1.75, 2.1, 2.45)
        for y in np.arange(-0.9, 1.0, 0.36)
    )
    m.add("Glacis_Bricks", bricks, p.body, bevel=0.015)
    m.add("Splash_Board", box((0.03, 1.5, 0.16), (1.65, 0, 1.42)).turned("y", -20, (1.65, 0, 1.42)), p.body, bevel=0)
    drums = joined(tube((-3.62, y, 1.38), (-3.62, y + 0.98, 1.38), 0.28, sides=18) for y in (-1.04, 0.06))
    bands = joined(tube((-3.62, y, 1.38), (-3.62, y + 0.05, 1.38), 0.3, sides=18) for y in (-0.85, -0.3, 0.25, 0.8))
    m.add("Fuel_Drums", drums, p.body, bevel=0.02)
    m.add("Drum_Bands", bands, p.dark, bevel=0)
    m.add("Log", tube((-3.55, -1.3, 0.93), (-3.55, 1.3, 0.93), 0.11), p.wood, bevel=0)
    engine_deck(m, p, -3.2, -1.5, 1.45, 1.05)
    m.add("Driver_Hatch", hatch(1.55, 0, 1.42, 0.25), p.body, bevel=0.01)
    fittings(m, p, front=3.25, rear=-3.4, half=1.05, z=1.47)
    chassis.lamps(m, p, x=3.0, y=0.85, z=1.18, radius=0.09)

    shell = ellipsoid((1.42, 1.36, 0.72), (0, 0, 1.52), floor=-0.02, sides=24, rings=9).moved(0.15)
    m.pivot_object("turret", (0.15, 0, 1.5), shell, p.body, bevel=0, name="Turret")
    ring = tube((0.15, 0, 1.4), (0.15, 0, 1.53), 1.15, sides=24)
    m.add("Ring", ring, p.body, part="turret", bevel=0)
    cheeks = joined(
        box((0.2, 0.36, 0.34), (1.3, 0, 1.58)).turned("y", 24, (1.3, 0, 1.6)).turned("z", a).moved(0.15)
        for a in (22, 40, 58, 76)
    )
    m.add("Bricks", cheeks.pair(), p.body, part="turret", bevel=0.015)
    m.add(
        "Cupola",
        tube((-0.15, 0.5, 2.02), (-0.15, 0.5, 2.26), 0.36, 0.33, sides=18) + hatch(-0.15, 0.5, 2.24, 0.27),
        p.body,
        part="turret",
        bevel=0.01,
    )
    m.add("Loader_Hatch", hatch(-0.1, -0.5, 2.12, 0.27), p.body, part="turret", bevel=0.01)
    m.add("Snorkel", tube((-1.5, 0.95, 1.75), (-1.5, -0.95, 1.75), 0.13), p.body, part="turret", bevel=0.01)
    m.add("Stowage", box((0.5, 1.2, 0.34), (-1.36, 0, 1.86)), p.canvas, part="turret", bevel=0.05)
    m.add("Smoke_Launchers", smoke_launchers(0.95, 0.98, 1.98).pair(), p.dark, part="turret", bevel=0)
    machine_gun(m, p, (0.2, 0.5, 2.32))
    antenna(m, p, (-0.9, -0.7, 1.95), part="turret", lean=0.4)
    m.pivot("gun", (1.2, 0, 1.82), on="turret", name="Gun")
    m.add("Mantlet", ellipsoid((0.5, 0.42, 0.3), (1.45, 0, 1.82), sides=14, rings=8), p.canvas, part="gun", bevel=0)
    m.add("Barrel", barrel(1.7, 5.95, 1.82, 0.08, evacuator=0.62), p.body, part="gun", bevel=0)
    m.add(
        "Searchlight",
        profile_tube([(1.45, 0.16), (1.8, 0.21), (1.82, 0.19)]).moved(y=-0.55, z=2.0),
        p.dark,
        part="gun",
        bevel=0,
    )
    m.add(
        "Searchlight_Glass",
        profile_tube([(1.81, 0.18), (1.835, 0.12)]).moved(y=-0.55, z=2.0),
        p.glass,
        part="gun",
        bevel=0,
    )
    root_scale = 0.01  # as an importer of centimetre files leaves it
    m.under_scaled_root(root_scale)


def mbt_slab(m: Model, p: Paints, folder: Path) -> None:
    """A wide, low desert tank of flat plates, painted from an external image."""
    image = bpy.data.images.load(str(folder / "textures" / "desert_blocks.png"))
    paint = materials.image_paint("Desert_Blocks", image, dust="#b59b74", by_uv=True)
    p = Paints(paint, p.rubber, p.steel, p.dark, p.glass, p.canvas, p.wood, p.lamp, p.red)
    gear = Running(7, -2.5, 0.8, 0.33, 1.5, 0.62, sprocket=(-3.35, 0.68, 0.34), idler=(3.15, 0.62, 0.33))
    chassis.tracks(m, p, gear)
    m.add("Hull_Lower", slab([(-3.85, 1.2), (-3.5, 0.46), (3.1, 0.46), (3.8, 0.95), (3.4, 1.2)], 1.15), p.body)
    m.add(
        "Hull_Upper",
        slab(
            [
                (-3.9, 1.1),
                (-3.95, 1.62),
                (-1.4, 1.62),
                (-1.2, 1.5),
                (1.9, 1.42),
                (3.95, 1.14),
                (3.85, 0.98),
                (3.3, 1.05),
            ],
            1.83,
        ),
        p.body,
        bevel=0.02,
    )
    skirts(m, p, -3.1, 3.6, 1.85, 0.7, 1.36, 7)
    m.add("Driver_Hatch", box((0.7, 0.7, 0.09), (2.15, 0, 1.38)), p.body, bevel=0.03)
    m.add(
        "Rear_Grille",
        joined(block((-4.0, -1.5, z), (-3.92, 1.5, z + 0.05)) for z in np.arange(1.16, 1.58, 0.09)),
        p.dark,
        bevel=0,
    )
    engine_deck(m, p, -3.8, -1.7, 1.63, 1.6)
    fittings(m, p, front=3.9, rear=-3.9, half=1.6, z=1.6)
    chassis.lamps(m, p, x=3.55, y=1.45, z=1.3, radius=0.08, tail_x=-4.0, tail_z=1.3)

    m.pivot_collection("turret", (0.1, 0, 1.52), name="Turret")
    low: Outline = [(2.1, 0.42), (1.45, 1.72), (-1.1, 1.78), (-2.1, 1.55), (-2.15, 1.2)]
    top: Outline = [(1.75, 0.4), (1.15, 1.42), (-1.0, 1.5), (-2.05, 1.38), (-2.1, 1.1)]
    m.add(
        "Shell",
        stack([(1.56, mirrored(low)), (1.72, mirrored(low)), (2.34, mirrored(top))]),
        p.body,
        part="turret",
        bevel=0.02,
    )
    m.add(
        "Racks",
        joined(
            path_tube([(-2.1, -1.35, z), (-2.9, -1.3, z), (-2.9, 1.3, z), (-2.1, 1.35, z)], 0.025)
            for z in (1.75, 2.0, 2.25)
        ),
        p.dark,
        part="turret",
        bevel=0,
    )
    m.add("Rack_Floor", block((-2.9, -1.28, 1.72), (-2.1, 1.28, 1.75)), p.dark, part="turret", bevel=0)
    m.add(
        "Rack_Load",
        joined([box((0.55, 0.8, 0.4), (-2.5, -0.75, 1.75)), tube((-2.5, -0.2, 1.95), (-2.5, 1.1, 1.95), 0.2)]),
        p.canvas,
        part="turret",
        bevel=0.06,
    )
    m.add("Side_Boxes", box((1.3, 0.26, 0.36), (-0.9, 1.76, 1.8)), p.body, part="turret", bevel=0.03, mirror=True)
    m.add("Hatches", hatch(-0.2, -0.62, 2.38, 0.34) + hatch(-0.3, 0.65, 2.34), p.body, part="turret", bevel=0.01)
    m.add(
        "Blow_Panels",
        joined(box((0.75, 0.85, 0.05), (-1.5, y, 2.32)) for y in (-0.5, 0.5)),
        p.body,
        part="turret",
        bevel=0.015,
    )
    m.add("Gunner_Sight", box((0.6, 0.5, 0.36), (0.75, -0.75, 2.3)), p.body, part="turret", bevel=0.04)
    m.add("Sight_Glass", box((0.02, 0.34, 0.2), (1.06, -0.75, 2.38)), p.glass, part="turret", bevel=0)
    m.add("Smoke_Launchers", smoke_launchers(0.95, 1.62, 1.98, tubes=4).pair(), p.dark, part="turret", bevel=0)
    machine_gun(m, p, (0.05, -0.62, 2.46))
    machine_gun(m, p, (0.0, 0.7, 2.4))
    antenna(m, p, (-1.9, 1.1, 2.3), part="turret")
    antenna(m, p, (-1.9, -1.1, 2.3), height=2.4, part="turret")
    m.pivot("gun", (1.4, 0, 1.98), on="turret", name="Main_Gun")
    m.add(
        "Mantlet",
        stack([(1.7, mirrored([(2.3, 0.34), (1.4, 0.38)])), (2.28, mirrored([(2.05, 0.3), (1.4, 0.36)]))]),
        p.body,
        part="gun",
        bevel=0.03,
    )
    m.add("Barrel", barrel(2.15, 6.3, 1.98, 0.085, evacuator=0.48), p.body, part="gun", bevel=0)


def mbt_classic(m: Model, p: Paints, folder: Path) -> None:
    """A tank of the 1950s: rounded long turret, open running gear with rollers, broad fenders full of boxes."""
    gear = Running(6, -2.2, 0.84, 0.36, 1.32, 0.58, sprocket=(-3.1, 0.82, 0.32), idler=(2.95, 0.78, 0.3), rollers=4)
    chassis.tracks(m, p, gear)
    m.add(
        "Hull_Lower",
        stack(
            [
                (0.45, mirrored([(2.5, 0.7), (2.3, 1.0), (-3.0, 1.0)])),
                (1.0, mirrored([(3.3, 0.62), (2.7, 1.02), (-3.35, 1.02)])),
                (1.5, mirrored([(1.9, 0.7), (1.4, 1.02), (-3.4, 1.02)])),
            ]
        ),
        p.body,
        bevel=0.04,
        smooth=60,
    )
    m.add(
        "Fenders",
        prism(
            [
                (-3.4, 1.28),
                (-3.55, 1.15),
                (-3.55, 1.12),
                (-3.35, 1.24),
                (2.95, 1.24),
                (3.4, 1.05),
                (3.42, 1.08),
                (3.0, 1.28),
            ],
            0.98,
            1.7,
        ),
        p.body,
        mirror=True,
        bevel=0.006,
    )
    boxes = joined(
        block((x, 1.12, 1.28), (x + w, 1.66, 1.56)) for x, w in ((-2.9, 0.8), (-2.0, 1.1), (-0.8, 0.7), (0.5, 1.2))
    )
    m.add("Fender_Boxes", boxes, p.body, mirror=True, bevel=0.025)
    m.add("Mufflers", tube((-2.6, 1.2, 1.66), (-1.5, 1.2, 1.66), 0.13), p.steel, mirror=True, bevel=0.02)
    engine_deck(m, p, -3.3, -1.4, 1.5, 0.98)
    m.add("Driver_Hatch", hatch(1.5, 0.35, 1.42, 0.26), p.body, bevel=0.01)
    fittings(m, p, front=3.25, rear=-3.42, half=1.0, z=1.52)
    chassis.lamps(m, p, x=2.75, y=0.95, z=1.42, radius=0.11, tail_x=-3.42, tail_z=1.3)
    m.crate("Stowage_Crate", (0.7, 0.5, 0.4), (-3.0, -1.35, 1.28), p.wood, turn_deg=4)
    m.crate("Jerrycans", (0.5, 0.34, 0.46), (-3.1, 1.35, 1.56), p.steel, turn_deg=-3)

    m.pivot("turret", (0.2, 0, 1.5), name="turret_pivot")
    rings: list[tuple[float, Outline]] = []
    for z, grow in ((1.52, 0.86), (1.78, 1.0), (2.08, 0.97), (2.3, 0.82), (2.4, 0.55)):
        angles = np.linspace(0, 2 * np.pi, 25)[:-1]
        x = np.where(np.cos(angles) > 0, 1.45, 1.85) * np.cos(angles)
        rings.append(
            (z, [(0.1 + grow * float(a), grow * float(b)) for a, b in zip(x, 1.22 * np.sin(angles), strict=True)])
        )
    m.add("Casting", stack(rings), p.body, part="turret", bevel=0, smooth=70)
    m.add("Collar", tube((0.2, 0, 1.44), (0.2, 0, 1.56), 1.02, sides=24), p.body, part="turret", bevel=0)
    m.add(
        "Cupola",
        tube((-0.3, -0.5, 2.3), (-0.3, -0.5, 2.62), 0.42, 0.36, sides=18) + hatch(-0.3, -0.5, 2.6, 0.28),
        p.body,
        part="turret",
        bevel=0.015,
    )
    m.add("Loader_Hatch", hatch(-0.2, 0.5, 2.36, 0.3), p.body, part="turret", bevel=0.01)
    rail = joined(
        path_tube([(-1.3, -0.8, z), (-2.15, -0.7, z), (-2.15, 0.7, z), (-1.3, 0.8, z)], 0.025) for z in (1.85, 2.15)
    )
    m.add("Bustle_Rails", rail, p.dark, part="turret", bevel=0)
    m.add(
        "Bustle_Rolls",
        joined(tube((-1.9, -0.6, z), (-1.9, 0.6, z), 0.17) for z in (1.98,)),
        p.canvas,
        part="turret",
        bevel=0.03,
    )
    m.add(
        "Rangefinder_Ears",
        ellipsoid((0.22, 0.14, 0.2), (0.25, 1.12, 2.16), sides=12, rings=6).pair(),
        p.body,
        part="turret",
        bevel=0,
    )
    machine_gun(m, p, (-0.1, -0.5, 2.7))
    antenna(m, p, (-1.2, 0.5, 2.25), part="turret", height=2.4, lean=0.5)
    m.pivot("gun", (1.2, 0, 1.95), on="turret", name="Gun_Elevation")
    m.add(
        "Mantlet",
        stack(
            [
                (1.68, mirrored([(1.6, 0.4), (1.15, 0.62)])),
                (1.95, mirrored([(1.85, 0.4), (1.1, 0.7)])),
                (2.24, mirrored([(1.55, 0.38), (1.05, 0.62)])),
            ]
        ),
        p.body,
        part="gun",
        bevel=0.04,
    )
    m.add("Barrel", barrel(1.75, 5.7, 1.95, 0.085, evacuator=0.72, brake=True), p.body, part="gun", bevel=0)
    light = profile_tube([(1.5, 0.2), (1.95, 0.34), (1.98, 0.32)]).moved(y=0.0, z=2.55)
    m.add("Searchlight", light, p.body, part="gun", bevel=0)
    m.add("Searchlight_Glass", profile_tube([(1.97, 0.3), (2.0, 0.2)]).moved(z=2.55), p.glass, part="gun", bevel=0)
