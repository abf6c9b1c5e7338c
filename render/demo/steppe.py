"""The scenery dry_steppe: a plain with dunes, a wadi with steep banks, rocks and shrubs, a gravel track."""

from __future__ import annotations

from pathlib import Path

import bpy
import numpy as np

from render.demo import earth, scatter, vegetation
from render.demo.land import Land, highest, mound, patch
from render.demo.relief import Course, Noise, sheet, smoothstep


def dry_steppe(path: Path, *, rng: np.random.Generator) -> Path:
    """A plain with dunes, a wadi with steep banks, rocks and shrubs, a gravel track, 600 m square."""
    land, noise, half = Land(), Noise(rng), 300.0
    soil = earth.Soil(
        cover=("#94794f", "#b39a6e", "#7f6743"),
        bare=("#96784e", "#bfa97f"),
        rock=("#7d6a50", "#a08b6a"),
        haze="#c3bcae",
        bare_share=(0.5, 0.62),
        tufts=0.05,
    )
    sand = earth.Soil(
        cover=("#c2a674", "#c9b082", "#b89a66"),
        bare=("#c2a674", "#cdb68a"),
        rock=("#b4966a", "#c4aa7c"),
        haze="#c3bcae",
        bare_share=(0.55, 0.7),
        tufts=0.03,
    )
    wadi = Course([(-330, 60), (-220, 90), (-130, 20), (-40, 60), (40, 10), (120, 60), (210, 20), (330, 70)])
    course = Course([(-299, -155), (-180, -110), (-60, -150), (50, -90), (160, -130), (299, -75)])

    def plain(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return 3.5 * noise(x, y, 240.0, octaves=2) + 0.5 * noise(x, y + 70, 30.0, octaves=3)

    level = course.profile(plain)

    def ground(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        bed, _ = wadi.nearest(x, y)
        width = 11.0 + 3.0 * noise(x, y, 40.0)
        carved = plain(x, y) - 4.2 * smoothstep(bed, width + 5.5, width) + 0.25 * noise(x, y, 9.0, octaves=2)
        distance, nearest = course.nearest(x, y)
        return carved + (level[nearest] - 0.06 - carved) * smoothstep(distance, 12.0, 4.5)

    def dune(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        # Wind from the west: long slopes rise to sharp crests, slip faces fall at 33 degrees behind them.
        phase = (x + 18 * noise(x, y, 70.0, octaves=2) + 0.25 * y) / 62.0
        saw = phase - np.floor(phase)
        ridge = np.where(saw < 0.78, smoothstep(saw / 0.78, 0.0, 1.0), 1 - (saw - 0.78) / 0.22)
        cover = smoothstep(np.hypot((x - 120) / 150, (y - 185) / 90), 1.0, 0.45)
        return ground(x, y) - 0.8 + cover * (1.2 + 7.5 * ridge)

    mesa = mound((-190.0, 200.0), (75.0, 60.0), 10.0, 24.0, ground, steep=1.6)
    top = highest(ground, dune, mesa)
    field = np.linspace(-half, half, 241)
    earthy = earth.ground("Steppe_Ground", soil)
    plain_mesh = land.add("Ground_Plain", sheet(field, field, ground), earthy, home="Terrain")
    land.add(
        "Sand_Dunes",
        sheet(np.linspace(-40, 280, 161), np.linspace(90, 280, 96), dune),
        earth.ground("Dune_Sand", sand),
        home="Terrain",
    )
    land.add("Terrain_Mesa", patch((-190, 200), 82, mesa, step=2.0), earthy, home="Terrain")
    land.road(
        "Track_Gravel", course, level, earth.road("Gravel", ("#a8926c", "#bda985"), "#a98f66", half=2.4), half=2.4
    )

    def beyond(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        away = np.maximum(np.abs(x), np.abs(y)) - half
        rise = smoothstep(away, 300.0, 3000.0)
        return (
            ground(x, y) * smoothstep(away, 500.0, 0.0)
            - 0.35
            + rise * (40 + 120 * np.abs(noise(x, y, 1100.0, octaves=4)))
        )

    land.surroundings(half, beyond, earth.ground("Far_Ground", soil, far=True))

    wood = earth.bark("Dry_Bark", "#6e5a44")
    scrub = earth.leaves("Scrub_Leaves", ("#5b5a34", "#8b8152"))
    shrubs = [
        vegetation.bush(f"Shrub_{k}", [wood, scrub], height=h, rng=rng, leaf=0.07, clumps=c)
        for k, (h, c) in enumerate([(0.7, 6), (1.1, 8), (1.6, 9)])
    ]
    thorn = [vegetation.broadleaf("Tree_Thorn", [wood, scrub], height=5.0, spread=2.8, rng=rng)]
    stones = [
        vegetation.boulder(f"Rock_{k}", earth.stone("Desert_Stone", ("#7a654a", "#a38c69"), "#b39a70"), flat=f, rng=rng)
        for k, f in enumerate((0.6, 0.8, 0.5))
    ]

    def dry(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        clear = (course.nearest(x, y)[0] > 5.0) & (dune(x, y) < ground(x, y))
        return (0.2 + smoothstep(noise(x + 300, y, 60.0, octaves=3), -0.1, 0.5)) * clear

    plants, rocks = land.collection("Vegetation"), land.collection("Rocks")
    scatter.copies(
        plants, shrubs, scatter.spots(half, 1500, dry, gap=2.5, rng=rng), top, scale=(0.5, 1.3), sink=0.08, rng=rng
    )

    few = scatter.spots(250.0, 10, dry, gap=30.0, rng=rng)
    scatter.copies(rocks, stones, few, top, scale=(1.5, 2.6), sink=0.4, rng=rng, tilt=0.2, modifier=scatter.subdivided)

    def along(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return (np.abs(wadi.nearest(x, y)[0] - 22.0) < 7.0).astype(float)

    scatter.copies(
        plants, thorn, scatter.spots(half, 90, along, gap=7.0, rng=rng), top, scale=(0.6, 1.2), sink=0.15, rng=rng
    )
    scatter.copies(
        rocks,
        stones,
        scatter.spots(half, 350, dry, gap=4.0, rng=rng),
        top,
        scale=(0.2, 1.4),
        sink=0.1,
        rng=rng,
        tilt=0.3,
    )

    def everywhere(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return np.full(x.shape, 0.6)

    scatter.groups(
        land.scene,
        "Shrub_Patch",
        shrubs,
        scatter.spots(750, 380, everywhere, gap=12.0, inside=half + 8, rng=rng),
        beyond,
        members=7,
        radius=7.0,
        rng=rng,
    )
    small = bpy.data.objects.new("Rock_Scattered", stones[0])
    small.scale = (0.35, 0.35, 0.35)
    scatter.by_nodes(plain_mesh, [small], density=0.004, seed=int(rng.integers(1000)), scale=(0.4, 1.2))
    straw = earth.leaves("Dry_Grass_Blades", ("#9c8756", "#c4b07c"))
    tufts = [vegetation.tussock("Grass_Dry_Tuft", [straw], height=0.3, blades=260, radius=0.7, rng=rng)]
    scatter.copies(
        land.collection("Grass"),
        tufts,
        scatter.spots(half, 1500, dry, gap=2.0, rng=rng),
        top,
        scale=(0.6, 1.3),
        sink=0.02,
        rng=rng,
    )
    lamp = bpy.data.objects.new("Sun_Weak", bpy.data.lights.new("Sun_Weak", "SUN"))
    lamp.data.energy, lamp.data.angle = 0.15, 0.02
    lamp.rotation_euler = (0.8, 0.1, 2.0)
    land.scene.collection.objects.link(lamp)
    land.camera((60.0, -220.0, 9.0), 10.0)
    return land.save(path)
