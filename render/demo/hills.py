"""The scenery temperate_hills: meadows, a wooded hill with a steep flank, a crest to hide behind, a dirt road."""

from __future__ import annotations

from pathlib import Path

import bpy
import numpy as np

from render.demo import earth, scatter, vegetation
from render.demo.land import Land, highest, mound, patch
from render.demo.relief import Course, Noise, sheet, smoothstep


def temperate_hills(path: Path, *, rng: np.random.Generator) -> Path:
    """Meadows, a wooded hill with a steep flank, a crest to hide behind, a dirt road, 500 m square."""
    land, noise, half = Land(), Noise(rng), 250.0
    soil = earth.Soil(
        cover=("#465427", "#676b38", "#958a58"),
        bare=("#6b5335", "#85704d"),
        rock=("#6e6a60", "#8d8778"),
        haze="#a9b9c6",
        bare_share=(0.60, 0.68),
        tufts=0.10,
    )

    def rolling(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return 5.5 * noise(x, y, 170.0, octaves=2) + 0.7 * noise(x + 90, y, 28.0, octaves=2) + 0.1 * noise(x, y, 7.0)

    course = Course([(-249, -110), (-170, -60), (-90, -95), (-10, -30), (60, 40), (150, 30), (190, 110), (249, 135)])
    level = course.profile(rolling)

    def meadow(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        distance, nearest = course.nearest(x, y)
        return rolling(x, y) + (level[nearest] - 0.06 - rolling(x, y)) * smoothstep(distance, 14.0, 4.5)

    hill = mound((-90.0, 110.0), (115.0, 85.0), 20.0, 27.0, meadow, steep=1.9)
    knoll = mound((120.0, -110.0), (70.0, 55.0), -35.0, 15.0, meadow, steep=1.7)
    crest = mound((40.0, 150.0), (105.0, 24.0), -12.0, 4.6, meadow, steep=1.3)
    top = highest(meadow, hill, knoll, crest)
    grass, hillside = earth.ground("Meadow_Ground", soil), earth.ground("Hill_Ground", soil)
    field = np.linspace(-half, half, 201)
    land.add("Ground_Meadow", sheet(field, field, meadow), grass, home="Terrain")
    wooded = land.add("Ground_Hill", patch((-90, 110), 125, hill, step=2.0), hillside, home="Terrain")
    land.add("Ground_Knoll", patch((120, -110), 78, knoll, step=2.0), hillside, home="Terrain")
    land.add("Ground_Crest", patch((40, 150), 108, crest, step=2.0), grass, home="Terrain")
    land.road(
        "Road_Dirt", course, level, earth.road("Dirt_Road", ("#7a6446", "#94805c"), "#666330", half=2.6), half=2.6
    )

    def beyond(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        away = np.maximum(np.abs(x), np.abs(y)) - half
        rise = smoothstep(away, 250.0, 2600.0)
        return (
            meadow(x, y) * smoothstep(away, 400.0, 0.0)
            - 0.35
            + rise * (70 + 110 * noise(x, y, 900.0, octaves=4, rough=0.45))
        )

    land.surroundings(half, beyond, earth.ground("Far_Ground", soil, far=True))

    trunk, dark = earth.bark("Bark", "#5a4a3a"), earth.bark("Dark_Bark", "#41352b")
    foliage = earth.leaves("Leaves", ("#2f4016", "#65772c"))
    needles = earth.leaves("Needles", ("#1c2e18", "#3c5128"))
    broad = [
        vegetation.broadleaf(f"Tree_Broadleaf_{k}", [trunk, foliage], height=h, spread=w, rng=rng)
        for k, (h, w) in enumerate([(13.0, 4.6), (10.0, 4.0), (15.0, 4.8)])
    ]
    spruce = [
        vegetation.conifer(f"Tree_Conifer_{k}", [dark, needles], height=h, spread=w, rng=rng)
        for k, (h, w) in enumerate([(16.0, 3.0), (11.0, 2.4)])
    ]
    bushes = [vegetation.bush(f"Bush_{k}", [trunk, foliage], height=h, rng=rng) for k, h in enumerate((1.2, 1.9))]
    stones = [
        vegetation.boulder(
            f"Boulder_{k}", earth.stone("Boulder_Stone", ("#69655c", "#8f897c"), "#5d6030"), flat=f, rng=rng
        )
        for k, f in enumerate((0.7, 0.85, 0.6))
    ]

    def off_road(x: np.ndarray, y: np.ndarray, gap: float) -> np.ndarray:
        return (course.nearest(x, y)[0] > gap).astype(float)

    def woods(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        dense = smoothstep(noise(x + 500, y, 90.0, octaves=3), 0.12, 0.45)
        border = smoothstep(np.maximum(np.abs(x), np.abs(y)), 200.0, 245.0)
        return np.maximum(dense, 0.55 * border) * off_road(x, y, 7.0)

    def sparse(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return (0.15 + smoothstep(noise(x + 500, y, 90.0, octaves=3), -0.1, 0.2) * 0.85) * off_road(x, y, 5.0)

    trees = land.collection("Vegetation")
    scatter.copies(
        trees,
        [*broad, *spruce],
        scatter.spots(half, 1000, woods, gap=4.5, rng=rng),
        top,
        scale=(0.7, 1.15),
        sink=0.25,
        rng=rng,
    )
    scatter.copies(
        trees, bushes, scatter.spots(half, 700, sparse, gap=3.0, rng=rng), top, scale=(0.6, 1.3), sink=0.1, rng=rng
    )

    def open_land(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return smoothstep(noise(x + 500, y, 90.0, octaves=3), 0.3, -0.2) * off_road(x, y, 9.0)

    scatter.copies(
        trees, broad, scatter.spots(half, 45, open_land, gap=22.0, rng=rng), top, scale=(0.8, 1.2), sink=0.25, rng=rng
    )

    def outer(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return smoothstep(noise(x + 500, y, 140.0, octaves=3), -0.15, 0.2)

    scatter.groups(
        land.scene,
        "Grove",
        [*spruce, *broad],
        scatter.spots(700, 420, outer, gap=15.0, inside=half + 12, rng=rng),
        beyond,
        members=6,
        radius=8.0,
        rng=rng,
    )
    rocks = land.collection("Rocks")
    scatter.copies(
        rocks,
        stones,
        scatter.spots(half, 130, sparse, gap=6.0, rng=rng),
        top,
        scale=(0.3, 1.3),
        sink=0.1,
        rng=rng,
        tilt=0.3,
    )
    few = scatter.spots(200.0, 8, sparse, gap=30.0, rng=rng)
    scatter.copies(rocks, stones, few, top, scale=(1.5, 2.3), sink=0.4, rng=rng, tilt=0.2, modifier=scatter.subdivided)
    shrub = [bpy.data.objects.new(f"Bush_Scattered_{k}", mesh) for k, mesh in enumerate(bushes)]
    scatter.by_nodes(wooded, shrub, density=0.012, seed=int(rng.integers(1000)), scale=(0.5, 1.1))
    blades = earth.leaves("Grass_Blades", ("#5d6a2a", "#968b4e"))
    tufts = [
        vegetation.tussock(f"Grass_Tuft_{k}", [blades], height=h, blades=1100, radius=2.4, rng=rng)
        for k, h in enumerate((0.16, 0.28))
    ]

    def meadows(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return (0.25 + 0.75 * smoothstep(noise(x, y, 25.0, octaves=2), -0.3, 0.4)) * off_road(x, y, 2.9)

    scatter.copies(
        land.collection("Grass"),
        tufts,
        scatter.spots(half, 2400, meadows, gap=3.0, rng=rng),
        top,
        scale=(0.7, 1.3),
        sink=0.02,
        rng=rng,
    )
    land.camera((-20.0, -150.0, 14.0), 5.0)
    return land.save(path)
