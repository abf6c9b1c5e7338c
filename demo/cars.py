"""A civilian estate car and a panel van, of no make, and parts that others share."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hulldown.demo.chassis import Paints
from hulldown.demo.model import BlendModel
from hulldown.demo.shapes import (
    Outline,
    Point,
    Shape,
    extrude_about_middle,
    extrude_along_y,
    join_shapes,
    make_bent_bar,
    make_corner_box,
    make_cylinder,
    make_standing_box,
    revolve_about_x,
    revolve_about_y,
    stack_outlines,
)


def profile_with_wheel_arches(
    outline: Outline, axles: Sequence[float], *, center: float, radius: float, sill: float
) -> list[tuple[float | int, float | int]]:
    """Return a side profile (x, z), counter-clockwise from its lower rear corner, with arches for wheels."""
    reach = float(np.sqrt(radius**2 - (sill - center) ** 2))
    low = np.arcsin((sill - center) / radius)
    points = [outline[0]]
    for x in sorted(axles):
        points.append((x - reach, sill))
        angles = np.linspace(np.pi - low, low, 13)[1:-1]
        points += [(x + radius * np.cos(a), center + radius * np.sin(a)) for a in angles]
        points.append((x + reach, sill))
    return [*points, *outline[1:]]


def add_car_wheels(m: BlendModel, p: Paints, axles: Sequence[float], *, y: float, radius: float, width: float) -> None:
    """Road tires on rims with five double spokes, the tires standing on z = 0."""
    w, inner = width / 2, radius * 0.66
    tire = revolve_about_y(
        [(inner, -w * 0.9), (radius * 0.93, -w), (radius, -w * 0.7), (radius, w * 0.7), (radius * 0.93, w), (inner, w)],
        sides=36,
        hollow=True,
    )
    dish = revolve_about_y([(inner, -w * 0.9), (inner, w * 0.85), (inner * 0.93, w * 0.6), (inner * 0.9, 0.0)], sides=36)
    spoke = make_standing_box((0.045, w * 0.3, inner * 0.95), (0, w * 0.68, 0)).turned("x", 4)
    spokes = join_shapes(spoke.turned("y", k * 72 + side) for k in range(5) for side in (-9, 9))
    hub = revolve_about_y([(inner * 0.24, 0.0), (inner * 0.24, w * 0.86), (inner * 0.14, w * 0.9)], sides=16)
    for k, x in enumerate(axles):
        m.add(f"Tire_{k + 1}", tire.moved(x, y, radius), p.rubber, bevel=0, mirror=True)
        m.add(f"Rim_{k + 1}", dish.moved(x, y, radius), p.dark, bevel=0, mirror=True)
        m.add(f"Spokes_{k + 1}", (spokes + hub).moved(x, y, radius), p.steel, bevel=0, mirror=True)
    well = join_shapes(
        make_corner_box((x - radius - 0.06, -y + w, 0.24), (x + radius + 0.06, y - w - 0.02, 0.75)) for x in axles
    )
    m.add("Wheel_Wells", well, p.dark, bevel=0)


def door_seams(lines: Sequence[Sequence[tuple[float, float]]], y: float) -> Shape:
    """Return gaps between doors as thin bars along lines (x, z)."""
    return join_shapes(make_bent_bar([(x, y, z) for x, z in line], 0.007, sides=4) for line in lines)


def number_plates(front: float, rear: float, z: tuple[float, float]) -> Shape:
    """Return number plates at both ends (x), with lower edges at `z`."""
    return make_standing_box((0.02, 0.52, 0.11), (front, 0, z[0])) + make_standing_box((0.02, 0.52, 0.11), (rear, 0, z[1]))


def window_pillar(foot: Point, head: Point, width: float) -> Shape:
    """Return a pillar just outside of the glass of the left side, from the waist to the roof."""
    across, out = np.array([width / 2, 0, 0]), np.array([0.0, 0.012, 0.006])
    low, high = np.array(foot) + out, np.array(head) + out
    ring = [low - across, low + across, high + across, high - across]
    return Shape(
        np.array([*ring, *(point - np.array([0, 0.05, 0]) for point in ring)]),
        ((0, 1, 2, 3), (7, 6, 5, 4), (0, 4, 5, 1), (1, 5, 6, 2), (2, 6, 7, 3), (3, 7, 4, 0)),
    )


def build_civilian_car(m: BlendModel, p: Paints) -> None:
    """Build a five-door estate with roof rails."""
    axles = (1.32, -1.36)
    outline = [
        (-2.22, 0.32),
        (2.12, 0.26),
        (2.26, 0.36),
        (2.25, 0.62),
        (2.14, 0.76),
        (1.05, 0.94),
        (-1.9, 0.98),
        (-2.24, 0.94),
        (-2.29, 0.55),
    ]
    profile = profile_with_wheel_arches(outline, axles, center=0.32, radius=0.385, sill=0.29)
    m.add("Body", extrude_about_middle(profile, 0.89), p.body, bevel=0.06, smooth=40)
    bonnet = extrude_about_middle([(1.02, 0.9), (2.08, 0.74), (1.98, 0.8), (1.06, 0.975)], 0.66)
    m.add("Bonnet", bonnet, p.body, bevel=0.04, smooth=50)
    waist = [(-2.2, -0.8), (1.12, -0.8), (1.12, 0.8), (-2.2, 0.8)]
    roof = [(-1.92, -0.6), (0.2, -0.58), (0.2, 0.58), (-1.92, 0.6)]
    m.add("Windows", stack_outlines([(0.95, waist), (1.42, roof)]), p.glass, bevel=0.02)
    top = [(x * 1.01, y * 1.04) for x, y in roof]
    crown = [(x * 0.9 - 0.08, y * 0.8) for x, y in roof]
    m.add("Roof", stack_outlines([(1.40, top), (1.44, top), (1.475, crown)]), p.body, bevel=0.02, smooth=60)

    pillars = join_shapes(
        window_pillar((x0, 0.8, 0.93), (x1, 0.605, 1.43), width)
        for x0, x1, width in ((1.08, 0.2, 0.1), (-0.28, -0.3, 0.09), (-1.3, -1.26, 0.09), (-2.12, -1.88, 0.2))
    )
    m.add("Pillars", pillars, p.body, mirror=True, bevel=0.008)
    roof_rails = make_bent_bar([(0.0, 0.55, 1.44), (-0.1, 0.56, 1.51), (-1.7, 0.57, 1.51), (-1.8, 0.56, 1.45)], 0.018)
    m.add("Roof_Rails", roof_rails, p.dark, mirror=True, bevel=0)
    doors = [
        [(0.92, 0.94), (0.9, 0.42), (0.82, 0.34), (-0.3, 0.36), (-0.29, 0.95)],
        [(-0.3, 0.36), (-0.9, 0.38), (-1.12, 0.72), (-1.3, 0.95)],
        [(1.02, 0.93), (1.1, 0.7)],
    ]
    m.add("Door_Seams", door_seams(doors, 0.892), p.dark, mirror=True, bevel=0)
    handles = join_shapes(make_standing_box((0.2, 0.03, 0.03), (x, 0.9, 0.83)) for x in (-0.12, -1.06))
    m.add("Handles", handles, p.dark, mirror=True, bevel=0.008)
    m.add("Sills", make_corner_box((-0.95, 0.84, 0.25), (0.92, 0.905, 0.34)), p.dark, mirror=True, bevel=0.02)
    m.add("Front_Bumper", extrude_about_middle([(2.2, 0.26), (2.3, 0.34), (2.29, 0.5), (2.2, 0.52)], 0.8), p.dark, bevel=0.03)
    bars = join_shapes(make_corner_box((2.24, -0.42, z), (2.28, 0.42, z + 0.02)) for z in (0.56, 0.6, 0.64))
    m.add("Grille", bars, p.dark, bevel=0)
    head_lamps = extrude_along_y([(2.02, 0.6), (2.27, 0.58), (2.2, 0.7), (1.98, 0.74)], 0.5, 0.84)
    m.add("Head_Lamps", head_lamps, p.lamp, mirror=True, bevel=0.03)
    fog_lamps = revolve_about_x([(2.24, 0.06), (2.305, 0.055)], sides=16).moved(y=0.62, z=0.38)
    m.add("Fog_Lamps", fog_lamps, p.lamp, mirror=True, bevel=0)
    m.add(
        "Rear_Bumper",
        extrude_about_middle([(-2.24, 0.3), (-2.36, 0.36), (-2.35, 0.56), (-2.24, 0.6)], 0.84),
        p.body,
        bevel=0.04,
    )
    tail_lamps = extrude_along_y([(-2.3, 0.66), (-2.16, 0.66), (-2.1, 1.0), (-2.25, 0.98)], 0.66, 0.86)
    m.add("Tail_Lamps", tail_lamps, p.red, mirror=True, bevel=0.02)
    m.add("Tailgate_Seam", make_bent_bar([(-2.285, -0.62, 0.62), (-2.285, 0.62, 0.62)], 0.008, sides=4), p.dark, bevel=0)
    m.add("Number_Plates", number_plates(2.305, -2.31, (0.4, 0.74)), p.canvas, bevel=0)
    mirror = make_standing_box((0.13, 0.2, 0.13), (0.78, 0.98, 0.94)) + make_standing_box((0.06, 0.14, 0.04), (0.8, 0.87, 0.93))
    m.add("Mirrors", mirror, p.body, mirror=True, bevel=0.03)
    wipers = join_shapes(make_bent_bar([(1.1, y, 0.965), (0.72, y + 0.34, 1.155)], 0.01) for y in (-0.5, 0.12))
    m.add("Wipers", wipers, p.dark, bevel=0)
    m.add("Aerial", make_bent_bar([(-1.8, 0, 1.46), (-2.05, 0, 1.62)], 0.008), p.dark, bevel=0)
    m.add("Exhaust", make_cylinder((-2.1, 0.5, 0.3), (-2.36, 0.5, 0.28), 0.035), p.steel, bevel=0)
    m.add("Floor_Pan", make_corner_box((-2.1, -0.8, 0.2), (2.0, 0.8, 0.34)), p.dark, bevel=0)
    add_car_wheels(m, p, axles, y=0.78, radius=0.32, width=0.21)


def build_panel_van(m: BlendModel, p: Paints) -> None:
    """Build a high-roofed delivery van with a sliding door."""
    axles = (1.75, -1.65)
    outline = [
        (-2.75, 0.42),
        (2.55, 0.34),
        (2.72, 0.46),
        (2.7, 0.92),
        (2.5, 1.12),
        (1.72, 1.32),
        (1.05, 2.3),
        (0.75, 2.46),
        (-2.5, 2.5),
        (-2.74, 2.36),
        (-2.78, 1.0),
    ]
    profile = profile_with_wheel_arches(outline, axles, center=0.36, radius=0.44, sill=0.38)
    m.add("Body", extrude_about_middle(profile, 0.99), p.body, bevel=0.08, smooth=40)
    roof_ribs = join_shapes(make_corner_box((x, -0.72, 2.46), (x + 0.09, 0.72, 2.515)) for x in np.arange(-2.2, 0.6, 0.45))
    m.add("Roof_Ribs", roof_ribs, p.body, bevel=0.02)
    lean = np.degrees(np.arctan2(1.68 - 1.1, 2.22 - 1.4))
    pane = make_standing_box((0.02, 1.64, 0.98), (0, 0, -0.49)).turned("y", -lean).moved(1.415, 0, 1.82)
    m.add("Windscreen", pane, p.glass, bevel=0.004)
    window = extrude_along_y([(0.42, 1.36), (1.46, 1.36), (1.02, 2.08), (0.42, 2.08)], 0.97, 1.0)
    m.add("Side_Windows", window, p.glass, mirror=True, bevel=0.006)
    seams = [
        [(1.62, 1.24), (1.34, 0.5), (0.36, 0.46), (0.34, 2.2), (1.06, 2.2)],
        [(0.3, 0.46), (-1.05, 0.48), (-1.05, 2.24), (0.3, 2.24)],
    ]
    m.add("Door_Seams", door_seams(seams, 0.993), p.dark, mirror=True, bevel=0)
    m.add("Slide_Rail", make_corner_box((-2.3, 0.98, 1.32), (-1.05, 1.003, 1.37)), p.dark, mirror=True, bevel=0.004)
    m.add("Rub_Strip", make_corner_box((-2.6, 0.97, 0.72), (2.3, 1.015, 0.84)), p.dark, mirror=True, bevel=0.015)
    handles = join_shapes(make_standing_box((0.2, 0.04, 0.045), (x, 1.0, 1.14)) for x in (0.55, 0.1))
    m.add("Handles", handles, p.dark, mirror=True, bevel=0.01)
    rear = [make_bent_bar([(-2.775, y, 0.5), (-2.785, y, 1.1), (-2.76, y, 2.34)], 0.008, sides=4) for y in (-0.9, 0.0, 0.9)]
    m.add("Rear_Seams", join_shapes(rear), p.dark, bevel=0)
    glass = (
        extrude_along_y([(-0.02, 1.42), (0.02, 1.42), (0.06, 2.1), (0.02, 2.1)], 0.12, 0.82).with_mirror_image().moved(-2.785)
    )
    m.add("Rear_Windows", glass, p.glass, bevel=0.004)
    hinges = join_shapes(make_standing_box((0.06, 0.05, 0.12), (-2.77, 0.93, z)) for z in (0.8, 1.4, 2.0))
    m.add("Hinges", hinges, p.dark, mirror=True, bevel=0.008)
    m.add("Front_Bumper", extrude_about_middle([(2.5, 0.3), (2.76, 0.4), (2.77, 0.66), (2.6, 0.7)], 0.95), p.dark, bevel=0.05)
    m.add("Rear_Bumper", make_standing_box((0.24, 1.9, 0.22), (-2.78, 0, 0.42)), p.dark, bevel=0.04)
    bars = join_shapes(make_corner_box((2.68, -0.55, z), (2.72, 0.55, z + 0.035)) for z in (0.74, 0.81, 0.88))
    m.add("Grille", bars, p.dark, bevel=0)
    head_lamps = extrude_along_y([(2.5, 0.74), (2.72, 0.72), (2.64, 1.0), (2.46, 1.1)], 0.6, 0.95)
    m.add("Head_Lamps", head_lamps, p.lamp, mirror=True, bevel=0.03)
    m.add("Tail_Lamps", make_standing_box((0.06, 0.14, 0.7), (-2.77, 0.93, 0.86)), p.red, mirror=True, bevel=0.02)
    m.add("Number_Plates", number_plates(2.775, -2.91, (0.46, 0.46)), p.canvas, bevel=0)
    mirror = make_standing_box((0.12, 0.2, 0.34), (1.5, 1.12, 1.34)) + make_standing_box((0.06, 0.2, 0.05), (1.5, 1.02, 1.34))
    m.add("Mirrors", mirror, p.dark, mirror=True, bevel=0.03)
    wipers = join_shapes(make_bent_bar([(1.7, y, 1.36), (1.36, y + 0.4, 1.86)], 0.012) for y in (-0.7, 0.15))
    m.add("Wipers", wipers, p.dark, bevel=0)
    m.add("Exhaust", make_cylinder((-2.4, -0.6, 0.34), (-2.86, -0.6, 0.32), 0.04), p.steel, bevel=0)
    m.add("Floor_Pan", make_corner_box((-2.6, -0.85, 0.28), (2.4, 0.85, 0.44)), p.dark, bevel=0)
    add_car_wheels(m, p, axles, y=0.86, radius=0.35, width=0.24)
