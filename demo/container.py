"""A shipping container."""

from __future__ import annotations

import numpy as np

from hulldown.demo.chassis import Paints
from hulldown.demo.model import BlendModel
from hulldown.demo.shapes import (
    extrude_along_y,
    join_shapes,
    make_bent_bar,
    make_corner_box,
    make_cylinder,
    make_standing_box,
    stack_outlines,
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


def build_container(m: BlendModel, p: Paints) -> None:
    """Build a twenty-foot container with corrugated sides and double doors at its rear."""
    half, width, height = 3.03, 1.22, 2.59
    side = stack_outlines(
        [(z, [(x - half + 0.1, y + width - 0.02) for x, y in corrugated_outline(2 * half - 0.2)]) for z in (0.16, 2.5)]
    )
    m.add("Side_Panels", side + side.turned("z", 180), p.body, bevel=0, smooth=20)
    end = stack_outlines([(z, [(x - width + 0.1, y) for x, y in corrugated_outline(2 * width - 0.2)]) for z in (0.16, 2.5)])
    m.add("Front_Panel", end.turned("z", -90).moved(half - 0.02), p.body, bevel=0, smooth=20)
    roof = [(x - half + 0.05, y + height - 0.03) for x, y in corrugated_outline(2 * half - 0.1, depth=0.02)]
    m.add("Roof_Panel", extrude_along_y(roof, -width + 0.06, width - 0.06), p.body, bevel=0, smooth=20)
    posts = join_shapes(
        make_standing_box((0.12, 0.12, height - 0.24), (x, y, 0.12))
        for x in (-half + 0.06, half - 0.06)
        for y in (-width + 0.06, width - 0.06)
    )
    rails = join_shapes(
        make_corner_box((-half, y, z), (half, y + 0.07, z + 0.12)) for y in (-width, width - 0.07) for z in (0.06, 2.46)
    )
    sills = join_shapes(
        make_corner_box((x, -width, z), (x + 0.08, width, z + 0.12)) for x in (-half, half - 0.08) for z in (0.06, 2.46)
    )
    m.add("Frame", posts + rails + sills, p.body, bevel=0.008)
    castings = join_shapes(
        make_standing_box((0.18, 0.16, 0.12), (x, y, z))
        for x in (-half + 0.09, half - 0.09)
        for y in (-width + 0.08, width - 0.08)
        for z in (0.0, height - 0.12)
    )
    m.add("Corner_Castings", castings, p.dark, bevel=0.012)
    holes = join_shapes(
        make_cylinder((x, y * 1.003, z + 0.06), (x, y * 0.9, z + 0.06), 0.04, sides=12)
        for x in (-half + 0.09, half - 0.09)
        for y in (-width, width)
        for z in (0.0, height - 0.12)
    )
    m.add("Casting_Holes", holes, p.rubber, bevel=0)
    floor_beams = join_shapes(
        make_corner_box((x - 0.03, -width + 0.05, 0.05), (x + 0.03, width - 0.05, 0.17))
        for x in np.linspace(-half + 0.3, half - 0.3, 16)
    )
    m.add("Floor_Beams", floor_beams, p.dark, bevel=0)
    fork_pockets = join_shapes(
        make_corner_box((x - 0.18, -width - 0.002, 0.07), (x + 0.18, -width + 0.02, 0.16)).with_mirror_image()
        for x in (-1.05, 1.05)
    )
    m.add("Fork_Pockets", fork_pockets, p.rubber, bevel=0)
    leaf = make_corner_box((-half - 0.02, 0.02, 0.2), (-half + 0.03, width - 0.11, 2.44))
    folds = join_shapes(
        make_corner_box((-half - 0.035, 0.1, z), (-half, width - 0.18, z + 0.26)) for z in (0.3, 0.74, 1.18, 1.62, 2.06)
    )
    m.add("Doors", leaf + folds, p.body, mirror=True, bevel=0.01)
    bars = join_shapes(make_cylinder((-half - 0.07, y, 0.14), (-half - 0.07, y, 2.5), 0.02, sides=8) for y in (0.24, 0.86))
    keeps = join_shapes(
        make_standing_box((0.07, 0.09, 0.07), (-half - 0.05, y, z)) for y in (0.24, 0.86) for z in (0.2, 0.8, 1.5, 2.36)
    )
    m.add("Lock_Bars", bars + keeps, p.steel, mirror=True, bevel=0)
    handles = join_shapes(make_bent_bar([(-half - 0.09, y, 1.02), (-half - 0.1, y + 0.34, 1.06)], 0.016) for y in (0.24, 0.5))
    m.add("Handles", handles, p.steel, mirror=True, bevel=0)
    hinges = join_shapes(make_standing_box((0.05, 0.1, 0.14), (-half - 0.01, width - 0.06, z)) for z in (0.4, 1.0, 1.6, 2.2))
    m.add("Hinges", hinges, p.dark, mirror=True, bevel=0.01)
    m.add("Seals", make_corner_box((-half - 0.028, -0.015, 0.2), (-half + 0.02, 0.015, 2.44)), p.rubber, bevel=0)
    marks = join_shapes(
        make_corner_box((x, width - 0.018, 2.08), (x + 0.11, width - 0.012, 2.26)) for x in (1.1, 1.28, 1.46, 1.64, 2.0, 2.18)
    )
    m.add("Markings", marks + make_corner_box((-half - 0.04, 0.3, 1.86), (-half - 0.036, 0.82, 1.98)), p.canvas, bevel=0)
