"""The scenery temperate_hills: meadows, a wooded hill with a steep flank, a crest to hide behind, a dirt road."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from hulldown.demo import earth, vegetation
from hulldown.demo.land import Land, patch_vertices_and_quads, surface_leveled_along_road, surface_with_mound, upper_envelope
from hulldown.demo.planting import Planting
from hulldown.demo.relief import Course, Noise, grid_vertices_and_quads, smoothstep

MEADOW_SOIL = earth.Soil(
    cover=("#37471d", "#545f2b", "#857c4a"),
    bare=("#6b5335", "#85704d"),
    rock=("#6e6a60", "#8d8778"),
    haze="#a9b9c6",
    bare_share=(0.60, 0.68),
    stony=0.0,
    tufts=0.10,
    clumps=1.0,
)
ROAD_COURSE = [(-249, -110), (-170, -60), (-90, -95), (-10, -30), (60, 40), (150, 30), (190, 110), (249, 135)]


def write_temperate_hills(path: Path, *, rng: np.random.Generator) -> Path:
    """Meadows, a wooded hill with a steep flank, a crest to hide behind, a dirt road, 500 m square."""
    land, noise = Land(250.0), Noise(rng)
    course = Course(ROAD_COURSE)

    def rolling(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return 5.5 * noise(x, y, 170.0, octaves=2) + 0.7 * noise(x + 90, y, 28.0, octaves=2) + 0.1 * noise(x, y, 7.0)

    level = course.profile(rolling)
    meadow = surface_leveled_along_road(rolling, course, level, reach=(4.5, 14.0))
    hill = surface_with_mound((-90.0, 110.0), (115.0, 85.0), 20.0, 27.0, meadow, steep=1.9)
    knoll = surface_with_mound((120.0, -110.0), (70.0, 55.0), -35.0, 15.0, meadow, steep=1.7)
    crest = surface_with_mound((40.0, 150.0), (105.0, 24.0), -12.0, 4.6, meadow, steep=1.3)
    grass, hillside = (earth.ground_material("Meadow_Ground", MEADOW_SOIL), earth.ground_material("Hill_Ground", MEADOW_SOIL))
    field = np.linspace(-land.half, land.half, 201)
    land.add("Ground_Meadow", grid_vertices_and_quads(field, field, meadow), grass, home="Terrain")
    wooded = land.add("Ground_Hill", patch_vertices_and_quads((-90, 110), 125, hill), hillside, home="Terrain")
    land.add("Ground_Knoll", patch_vertices_and_quads((120, -110), 78, knoll), hillside, home="Terrain")
    land.add("Ground_Crest", patch_vertices_and_quads((40, 150), 108, crest), grass, home="Terrain")
    dirt = earth.road_material("Dirt_Road", ("#7a6446", "#94805c"), "#666330", half=2.6)
    land.add_road("Road_Dirt", course, level, dirt, half=2.6)

    def mountains(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return 70 + 110 * noise(x, y, 900.0, octaves=4, rough=0.45)

    land.add_surroundings(meadow, mountains, earth.ground_material("Far_Ground", MEADOW_SOIL, far=True), rise=(250.0, 2600.0))
    planting = Planting(land, upper_envelope(meadow, hill, knoll, crest), rng)
    _add_hill_plants_and_rocks(planting, noise, course, wooded)
    land.camera((-20.0, -150.0, 14.0), 5.0)
    return land.save(path)


def _add_hill_plants_and_rocks(planting: Planting, noise: Noise, course: Course, wooded: object) -> None:
    rng = planting.rng
    trunk, dark = earth.bark_material("Bark", "#5a4a3a"), earth.bark_material("Dark_Bark", "#41352b")
    foliage = earth.leaf_material("Leaves", ("#2f4016", "#65772c"))
    needles = earth.leaf_material("Needles", ("#1c2e18", "#3c5128"))
    broad = [
        vegetation.make_broadleaf_mesh(f"Tree_Broadleaf_{k}", [trunk, foliage], height=h, spread=w, rng=rng)
        for k, (h, w) in enumerate([(13.0, 4.6), (10.0, 4.0), (15.0, 4.8)])
    ]
    spruce = [
        vegetation.make_conifer_mesh(f"Tree_Conifer_{k}", [dark, needles], height=h, spread=w, rng=rng)
        for k, (h, w) in enumerate([(16.0, 3.0), (11.0, 2.4)])
    ]
    bushes = [vegetation.make_bush_mesh(f"Bush_{k}", [trunk, foliage], height=h, rng=rng) for k, h in enumerate((1.2, 1.9))]

    def wild(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return noise(x + 500, y, 90.0, octaves=3)

    def woods(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        border = smoothstep(np.maximum(np.abs(x), np.abs(y)), 200.0, 245.0)
        return np.maximum(smoothstep(wild(x, y), 0.12, 0.45), 0.55 * border) * course.clear(x, y, 7.0)

    def sparse(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return (0.15 + 0.85 * smoothstep(wild(x, y), -0.1, 0.2)) * course.clear(x, y, 5.0)

    def open_land(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return smoothstep(wild(x, y), 0.3, -0.2) * course.clear(x, y, 9.0)

    def outer(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return smoothstep(noise(x + 500, y, 140.0, octaves=3), -0.15, 0.2)

    def meadows(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return (0.25 + 0.75 * smoothstep(noise(x, y, 25.0, octaves=2), -0.3, 0.4)) * course.clear(x, y, 5.5)

    planting.strew_copies("Vegetation", [*broad, *spruce], 1000, woods, gap=4.5, scale=(0.7, 1.15), sink=0.25)
    planting.strew_copies("Vegetation", bushes, 700, sparse, gap=3.0, scale=(0.6, 1.3), sink=0.1)
    planting.strew_copies("Vegetation", broad, 45, open_land, gap=22.0, scale=(0.8, 1.2), sink=0.25)
    planting.plant_outskirts("Grove", [*spruce, *broad], 420, outer, reach=700.0, group=6)
    planting.add_undergrowth(wooded, "Bush_Scattered", bushes[0], size=1.0, density=0.012, scale=(0.5, 1.1))
    stone = earth.stone_material("Boulder_Stone", ("#69655c", "#8f897c"), "#5d6030")
    planting.add_stones("Boulder", stone, (0.7, 0.85, 0.6), 150, sparse)
    planting.add_grass("Grass_Tuft", ("#4d5f26", "#b3a868"), (0.32, 0.46), 2600, meadows, clumps=110)
