"""Parts that tanks share: gun barrels, skirts, engine decks, tools, machine guns."""

from __future__ import annotations

import numpy as np

from hulldown.demo.chassis import Paints
from hulldown.demo.model import BlendModel
from hulldown.demo.shapes import (
    Outline,
    Shape,
    extrude_along_y,
    join_shapes,
    make_bent_bar,
    make_corner_box,
    make_cylinder,
    make_standing_box,
    revolve_about_x,
)


def outline_with_mirror_image(outline: Outline) -> Outline:
    """Return a plan outline (x, y) closed by its mirror image; give the left half from front to rear."""
    return [*outline, *((x, -y) for x, y in reversed(outline))]


def make_barrel(x0: float, x1: float, z: float, radius: float, *, evacuator: float, brake: bool = False) -> Shape:
    """Return a gun barrel with thermal sleeve bands, a bore evacuator at a share of its length, and perhaps a brake."""
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
    bands = join_shapes(make_cylinder((x, 0, z), (x + 0.05, 0, z), radius * 1.32) for x in x0 + length * np.array([0.18, 0.3]))
    return revolve_about_x(stations, z=z, sides=16) + bands


def add_skirts(m: BlendModel, p: Paints, x0: float, x1: float, y: float, z0: float, z1: float, panels: int) -> None:
    """Add a row of side plates with gaps, by an array and a mirror modifier."""
    step = (x1 - x0) / panels
    plate = extrude_along_y(
        [(x0 + 0.02, z1), (x0 + 0.02, z0 + 0.05), (x0 + 0.1, z0), (x0 + step - 0.02, z0), (x0 + step - 0.02, z1)], y, y + 0.05
    )
    m.add("Side_Skirts", plate, p.body, mirror=True, copies=(panels, step))


def add_engine_deck(m: BlendModel, p: Paints, x0: float, x1: float, z: float, half: float) -> None:
    """Add louvered grilles on the rear deck."""
    frame = join_shapes(
        make_corner_box((x0, y - half * 0.42, z - 0.02), (x1, y + half * 0.42, z + 0.03)) for y in (-half * 0.5, half * 0.5)
    )
    m.add("Engine_Covers", frame, p.body, bevel=0.01)
    bars = join_shapes(
        make_corner_box((x, y - half * 0.36, z + 0.03), (x + 0.05, y + half * 0.36, z + 0.06))
        for x in np.arange(x0 + 0.1, x1 - 0.1, 0.11)
        for y in (-half * 0.5, half * 0.5)
    )
    m.add("Engine_Louvres", bars, p.dark, bevel=0)


def add_tow_gear_and_tools(m: BlendModel, p: Paints, *, front: float, rear: float, half: float, z: float) -> None:
    """Add tow hooks, cables, and a rear stowage of tools."""
    hooks = join_shapes(make_standing_box((0.16, 0.08, 0.2), (x, 0.85, 0.72)).with_mirror_image() for x in (front, rear))
    m.add("Tow_Hooks", hooks, p.dark, bevel=0.01)
    cable = make_bent_bar(
        [(front - 1.9, half, z), (front - 2.6, half + 0.08, z + 0.03), (0, half + 0.05, z + 0.03), (rear + 1.4, half, z)], 0.035
    )
    m.add("Tow_Cable", cable, p.steel, bevel=0, mirror=True)
    m.add("Shovel", make_corner_box((-1.2, half - 0.28, z), (0.1, half - 0.23, z + 0.05)), p.wood, bevel=0)


def add_machine_gun(m: BlendModel, p: Paints, at: tuple[float, float, float]) -> None:
    """Add a heavy machine gun on a pintle to the turret."""
    x, y, z = at
    gun = make_standing_box((0.55, 0.12, 0.15), (x, y, z + 0.25)) + make_cylinder(
        (x + 0.2, y, z + 0.34), (x + 1.25, y, z + 0.4), 0.025, sides=8
    )
    roof_mg = (
        gun + make_cylinder(at, (x, y, z + 0.28), 0.04) + make_standing_box((0.2, 0.14, 0.2), (x + 0.05, y + 0.15, z + 0.22))
    )
    m.add("Roof_MG", roof_mg, p.dark, bevel=0.008, part="turret")
