"""The two demo sceneries, temperate hills and dry steppe, each written into one .blend file."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import bpy
import numpy as np
from mathutils import Matrix

from render.demo import earth, scatter, vegetation
from render.demo.relief import Course, Height, Noise, quads, ribbon, sheet, smoothstep

FAR = 4500.0  # metres to where the surroundings end, below the horizon's haze
HIDDEN_EDGE = 4.0  # metres by which surroundings reach below the ground, that no gap shows between them


class Land:
    """A scenery's file under construction."""

    def __init__(self) -> None:
        bpy.ops.wm.read_factory_settings(use_empty=True)
        self.scene = bpy.context.scene
        self.collections: dict[str, Any] = {}

    def collection(self, name: str) -> Any:
        """The collection of that name, made when first asked for."""
        if name not in self.collections:
            self.collections[name] = bpy.data.collections.new(name)
            self.scene.collection.children.link(self.collections[name])
        return self.collections[name]

    def add(self, name: str, geometry: tuple[np.ndarray, np.ndarray], material: Any, *, home: str) -> Any:
        """A smooth mesh object."""
        mesh = bpy.data.meshes.new(name)
        mesh.from_pydata(geometry[0], [], geometry[1])
        mesh.materials.append(material)
        mesh.shade_smooth()
        thing = bpy.data.objects.new(name, mesh)
        self.collection(home).objects.link(thing)
        return thing

    def road(self, name: str, course: Course, z: np.ndarray, material: Any, *, half: float) -> None:
        """A strip with ruts in its shape and (across, along) in metres as its UV map; its edges dip into the ground."""
        across = np.array([-half, -half + 0.6, -1.4, -0.95, -0.5, 0.5, 0.95, 1.4, half - 0.6, half])
        rise = [-0.25, 0.0, 0.03, -0.03, 0.03, 0.03, -0.03, 0.03, 0.0, -0.25]
        thing = self.add(name, ribbon(course, z, across, rise), material, home="Terrain")
        uv = np.stack(np.broadcast_arrays(across[None], course.at[:, None]), axis=-1).reshape(-1, 2)
        corners = quads(len(course.xy), len(across)).ravel()
        thing.data.uv_layers.new(name="UVMap").uv.foreach_set("vector", uv[corners].astype(np.float32).ravel())

    def surroundings(self, half: float, height: Height, material: Any) -> None:
        """Eight sheets around the square of the ground, coarser outwards, that carry the view to the horizon."""
        out = half - HIDDEN_EDGE + (FAR - half) * (np.linspace(0, 1, 36) ** 2.6)
        inner = np.linspace(-half + HIDDEN_EDGE, half - HIDDEN_EDGE, 41)
        spans = {"West": -out[::-1], "": inner, "East": out}
        for east, xs in spans.items():
            for north, ys in {"South": -out[::-1], "": inner, "North": out}.items():
                if east or north:
                    self.add(f"Horizon_{north}{east}", sheet(xs, ys, height), material, home="Surroundings")

    def camera(self, at: tuple[float, float, float], turn_deg: float) -> None:
        """The camera that the file is delivered with."""
        camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
        camera.matrix_world = (
            Matrix.Translation(at)
            @ Matrix.Rotation(np.radians(turn_deg), 4, "Z")
            @ Matrix.Rotation(np.radians(84), 4, "X")
        )
        camera.data.clip_end = 2 * FAR
        self.scene.collection.objects.link(camera)
        self.scene.camera = camera

    def save(self, path: Path) -> Path:
        """Write the file."""
        path.parent.mkdir(parents=True, exist_ok=True)
        bpy.ops.wm.save_as_mainfile(filepath=str(path), compress=True)
        return path


def subdivided(thing: Any) -> None:
    """A subdivision modifier that is finer in renders than on the screen."""
    modifier = thing.modifiers.new("Subdivision", "SUBSURF")
    modifier.levels, modifier.render_levels = 1, 2


def highest(*surfaces: Height) -> Height:
    """The top of several surfaces."""
    return lambda x, y: np.max([surface(x, y) for surface in surfaces], axis=0)


def mound(
    centre: tuple[float, float], half: tuple[float, float], turn_deg: float, top: float, base: Height, *, steep: float
) -> Height:
    """A hill over `base` that dips below it at its rim; its far side falls off `steep` times as fast as its near one."""
    c, s = np.cos(np.radians(turn_deg)), np.sin(np.radians(turn_deg))

    def height(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        u, v = (x - centre[0]) * c + (y - centre[1]) * s, -(x - centre[0]) * s + (y - centre[1]) * c
        v = np.where(v > 0, v * steep, v)
        rim = np.sqrt((u / half[0]) ** 2 + (v / half[1]) ** 2)
        return base(x, y) + top * smoothstep(rim, 1.0, 0.0) - 1.5 * smoothstep(rim, 0.82, 1.0)

    return height


def patch(centre: tuple[float, float], reach: float, height: Height, *, step: float) -> tuple[np.ndarray, np.ndarray]:
    """A square sheet about a centre."""
    line = np.linspace(-reach, reach, int(2 * reach / step) + 1)
    return sheet(centre[0] + line, centre[1] + line, height)


def temperate_hills(path: Path, *, rng: np.random.Generator) -> Path:
    """Meadows, a wooded hill with a steep flank, a crest to hide behind, a dirt road, 500 m square."""
    land, noise, half = Land(), Noise(rng), 250.0
    soil = earth.Soil(
        cover=("#4b5a24", "#66692f", "#8b8046"),
        bare=("#6b5335", "#85704d"),
        rock=("#6e6a60", "#8d8778"),
        haze="#a9b9c6",
        bare_share=(0.60, 0.68),
        tufts=0.10,
    )
    rolling: Height = lambda x, y: (
        5.5 * noise(x, y, 170.0, octaves=2) + 0.7 * noise(x + 90, y, 28.0, octaves=2) + 0.1 * noise(x, y, 7.0)
    )
    course = Course([(-270, -120), (-170, -60), (-90, -95), (-10, -30), (60, 40), (150, 30), (190, 110), (280, 150)])
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
    open_land = lambda x, y: smoothstep(noise(x + 500, y, 90.0, octaves=3), 0.3, -0.2) * off_road(x, y, 9.0)
    scatter.copies(
        trees, broad, scatter.spots(half, 45, open_land, gap=22.0, rng=rng), top, scale=(0.8, 1.2), sink=0.25, rng=rng
    )
    outer = lambda x, y: smoothstep(noise(x + 500, y, 140.0, octaves=3), -0.15, 0.2)
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
        modifier=subdivided,
    )
    shrub = [bpy.data.objects.new(f"Bush_Scattered_{k}", mesh) for k, mesh in enumerate(bushes)]
    scatter.by_nodes(wooded, shrub, density=0.012, seed=int(rng.integers(1000)), scale=(0.5, 1.1))
    blades = earth.leaves("Grass_Blades", ("#5d6a2a", "#968b4e"))
    tufts = [
        vegetation.tussock(f"Grass_Tuft_{k}", [blades], height=h, blades=260, radius=1.1, rng=rng)
        for k, h in enumerate((0.16, 0.28))
    ]
    meadows = lambda x, y: (0.25 + 0.75 * smoothstep(noise(x, y, 25.0, octaves=2), -0.3, 0.4)) * off_road(x, y, 2.9)
    scatter.copies(
        land.collection("Grass"),
        tufts,
        scatter.spots(half, 9000, meadows, gap=1.3, rng=rng),
        top,
        scale=(0.7, 1.3),
        sink=0.02,
        rng=rng,
    )
    land.camera((-20.0, -150.0, 14.0), 5.0)
    return land.save(path)


def dry_steppe(path: Path, *, rng: np.random.Generator) -> Path:
    """A plain with dunes, a wadi with steep banks, rocks and shrubs, a gravel track, 600 m square."""
    land, noise, half = Land(), Noise(rng), 300.0
    soil = earth.Soil(
        cover=("#a58c62", "#b59c70", "#94794f"),
        bare=("#9c8055", "#bda67a"),
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
    course = Course([(-310, -160), (-180, -110), (-60, -150), (50, -90), (160, -130), (310, -70)])
    plain: Height = lambda x, y: 3.5 * noise(x, y, 240.0, octaves=2) + 0.5 * noise(x, y + 70, 30.0, octaves=3)
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
    along = lambda x, y: (np.abs(wadi.nearest(x, y)[0] - 22.0) < 7.0).astype(float)
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
        modifier=subdivided,
    )
    everywhere = lambda x, y: np.full(x.shape, 0.6)
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
    tufts = [vegetation.tussock("Grass_Dry_Tuft", [straw], height=0.3, blades=110, radius=0.3, rng=rng)]
    scatter.copies(
        land.collection("Grass"),
        tufts,
        scatter.spots(half, 4500, dry, gap=1.0, rng=rng),
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


BUILD = {"temperate_hills": temperate_hills, "dry_steppe": dry_steppe}
