"""The scenery dry_steppe: a plain with dunes, a wadi with steep banks, rocks and shrubs, a gravel track."""

from __future__ import annotations

from pathlib import Path

import bpy
import numpy as np

from hulldown.demo import earth, vegetation
from hulldown.demo.land import Land, patch_vertices_and_quads, surface_leveled_along_road, surface_with_mound, upper_envelope
from hulldown.demo.planting import Planting
from hulldown.demo.relief import Course, Height, Noise, grid_vertices_and_quads, smoothstep

STEPPE_SOIL = earth.Soil(
    cover=("#836a45", "#b29a70", "#725c3d"),
    bare=("#96784e", "#bfa97f"),
    rock=("#66563f", "#a08b6a"),
    haze="#c3bcae",
    bare_share=(0.5, 0.62),
    stony=0.75,
    tufts=0.05,
    clumps=0.45,
)
SAND_SOIL = earth.Soil(
    cover=("#c2a674", "#c9b082", "#b89a66"),
    bare=("#c2a674", "#cdb68a"),
    rock=("#b4966a", "#c4aa7c"),
    haze="#c3bcae",
    bare_share=(0.55, 0.7),
    stony=0.0,
    tufts=0.03,
    clumps=0.0,
)
WADI_COURSE = [(-330, 60), (-220, 90), (-130, 20), (-40, 60), (40, 10), (120, 60), (210, 20), (330, 70)]
TRACK_COURSE = [(-299, -155), (-180, -110), (-60, -150), (50, -90), (160, -130), (299, -75)]


def write_dry_steppe(path: Path, *, rng: np.random.Generator) -> Path:
    """Return a plain with dunes, a wadi with steep banks, rocks and shrubs, a gravel track, 600 m square."""
    land, noise = Land(300.0), Noise(rng)
    wadi, course = Course(WADI_COURSE), Course(TRACK_COURSE)

    def plain(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return 3.5 * noise(x, y, 240.0, octaves=2) + 0.5 * noise(x, y + 70, 30.0, octaves=3)

    def carved(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        bed, _ = wadi.nearest(x, y)
        width = 11.0 + 3.0 * noise(x, y, 40.0)
        return plain(x, y) - 4.2 * smoothstep(bed, width + 5.5, width) + 0.25 * noise(x, y, 9.0, octaves=2)

    level = course.profile(plain)
    ground = surface_leveled_along_road(carved, course, level, reach=(4.5, 12.0))

    def dune(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        # Wind from the west: long slopes rise to sharp crests, slip faces fall at 33 degrees behind them.
        phase = (x + 18 * noise(x, y, 70.0, octaves=2) + 0.25 * y) / 62.0
        saw = phase - np.floor(phase)
        ridge = np.where(saw < 0.78, smoothstep(saw / 0.78, 0.0, 1.0), 1 - (saw - 0.78) / 0.22)
        cover = smoothstep(np.hypot((x - 120) / 150, (y - 185) / 90), 1.0, 0.45)
        return ground(x, y) - 0.8 + cover * (1.2 + 7.5 * ridge)

    mesa = surface_with_mound((-190.0, 200.0), (75.0, 60.0), 10.0, 24.0, ground, steep=1.6)
    field = np.linspace(-land.half, land.half, 241)
    earthy, sand = earth.ground_material("Steppe_Ground", STEPPE_SOIL), earth.ground_material("Dune_Sand", SAND_SOIL)
    plain_mesh = land.add("Ground_Plain", grid_vertices_and_quads(field, field, ground), earthy, home="Terrain")
    dunes = grid_vertices_and_quads(np.linspace(-40, 280, 161), np.linspace(90, 280, 96), dune)
    land.add("Sand_Dunes", dunes, sand, home="Terrain")
    land.add("Terrain_Mesa", patch_vertices_and_quads((-190, 200), 82, mesa), earthy, home="Terrain")
    gravel = earth.road_material("Gravel", ("#a8926c", "#bda985"), "#a98f66", half=2.4)
    land.add_road("Track_Gravel", course, level, gravel, half=2.4)

    def mountains(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return 40 + 120 * np.abs(noise(x, y, 1100.0, octaves=4))

    land.add_surroundings(ground, mountains, earth.ground_material("Far_Ground", STEPPE_SOIL, far=True), rise=(300.0, 3000.0))

    def dry(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        clear = course.clear(x, y, 5.0) * (dune(x, y) < ground(x, y))
        return (0.2 + smoothstep(noise(x + 300, y, 60.0, octaves=3), -0.1, 0.5)) * clear

    _add_steppe_plants_and_rocks(Planting(land, upper_envelope(ground, dune, mesa), rng), dry, wadi, plain_mesh)
    lamp = bpy.data.objects.new("Sun_Weak", bpy.data.lights.new("Sun_Weak", "SUN"))
    lamp.data.energy, lamp.data.angle = 0.15, 0.02
    lamp.rotation_euler = (0.8, 0.1, 2.0)
    land.scene.collection.objects.link(lamp)
    land.camera((60.0, -220.0, 9.0), 10.0)
    return land.save(path)


def _add_steppe_plants_and_rocks(planting: Planting, dry: Height, wadi: Course, plain_mesh: object) -> None:
    rng = planting.rng
    wood = earth.bark_material("Dry_Bark", "#6e5a44")
    scrub = earth.leaf_material("Scrub_Leaves", ("#5b5a34", "#8b8152"))
    shrubs = [
        vegetation.make_bush_mesh(f"Shrub_{k}", [wood, scrub], height=h, rng=rng, leaf=0.07, clumps=c)
        for k, (h, c) in enumerate([(0.7, 6), (1.1, 8), (1.6, 9)])
    ]
    thorn = [vegetation.make_broadleaf_mesh("Tree_Thorn", [wood, scrub], height=5.0, spread=2.8, rng=rng)]

    def shape_along_course(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return (np.abs(wadi.nearest(x, y)[0] - 22.0) < 7.0).astype(float)

    def everywhere(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return np.full(x.shape, 0.6)

    planting.strew_copies("Vegetation", shrubs, 1500, dry, gap=2.5, scale=(0.5, 1.3), sink=0.08)
    planting.strew_copies("Vegetation", thorn, 90, shape_along_course, gap=7.0, scale=(0.6, 1.2), sink=0.15)
    planting.plant_outskirts("Shrub_Patch", shrubs, 380, everywhere, reach=750.0, group=7)
    stone = earth.stone_material("Desert_Stone", ("#7a654a", "#a38c69"), "#b39a70")
    stones = planting.add_stones("Rock", stone, (0.6, 0.8, 0.5), 350, dry)
    planting.add_undergrowth(plain_mesh, "Rock_Scattered", stones[0], size=0.35, density=0.008, scale=(0.25, 1.2))
    planting.add_grass("Grass_Dry_Tuft", ("#9c8756", "#c9b784"), (0.3, 0.4), 2200, dry, clumps=40)
