"""`python -m hulldown.benchmarks.town FILE SEED`: a town of streets, parking lots, lawns, houses, and trees."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from itertools import pairwise, product
from pathlib import Path

import bpy
import numpy as np
from PIL import Image
from scipy.ndimage import zoom

from hulldown.demo import earth, shapes, vegetation
from hulldown.demo.land import Land
from hulldown.demo.materials import Graph, plain_material
from hulldown.demo.relief import grid_vertices_and_quads

HALF, TEXELS = 90.0, 4096  # meters; of the ground's texture, 4 cm each
EAST, NORTH = (-60.0, 0.0, 60.0), (-45.0, 45.0)  # y of the middles of streets to the east, x of those to the north
STREET, WALK = 15.0, 4.0  # meters wide
LANES = (-3.5, 0.0, 3.5)
PAVING, ASPHALT, GRASS, WHITE = (150, 146, 138), (96, 96, 98), (74, 92, 48), (205, 205, 200)
Lot = tuple[float, float, float, float]  # west, south, east, north


def lots() -> list[Lot]:
    """The blocks between sidewalks, parking lots and lawns in turn."""
    away = STREET / 2 + WALK
    spans = [[(a + away, b - away) for a, b in pairwise((-HALF - away, *at, HALF + away))] for at in (NORTH, EAST)]
    return [(west, south, east, north) for (west, east), (south, north) in product(*spans)]


def markings() -> Iterator[Lot]:
    """White lines: stalls, lanes between crossings, zebra crossings."""
    for west, south, east, north in lots()[::2]:
        for x, y in product(np.arange(west + 1, east, 2.6), np.arange(south + 1, north - 5, 11.0)):
            yield x, y, x + 0.12, y + 5
    dashes = np.arange(-HALF, HALF, 9.0)
    for at, lane, x in product(EAST, LANES, dashes):
        if min(abs(x + 1.5 - street) for street in NORTH) > STREET:
            yield x, at + lane - 0.08, x + 3, at + lane + 0.08
    for at, lane, y in product(NORTH, LANES, dashes):
        if min(abs(y + 1.5 - street) for street in EAST) > STREET:
            yield at + lane - 0.08, y, at + lane + 0.08, y + 3
    for x, y, k in product(NORTH, EAST, np.arange(-STREET / 2, STREET / 2)):
        yield x + k, y + STREET / 2 + 1, x + k + 0.5, y + STREET / 2 + 4


def ground_picture(rng: np.random.Generator) -> Image.Image:
    """The ground seen from above, mottled."""
    picture = np.empty((TEXELS, TEXELS, 3), np.float32)

    def paint(area: Lot, color: tuple[int, int, int]) -> None:
        west, south, east, north = (round((v + HALF) * TEXELS / (2 * HALF)) for v in area)
        picture[max(TEXELS - north, 0) : TEXELS - south, max(west, 0) : east] = color

    paint((-HALF, -HALF, HALF, HALF), PAVING)
    for k, lot in enumerate(lots()):
        paint(lot, GRASS if k % 2 else ASPHALT)
    for y in EAST:
        paint((-HALF, y - STREET / 2, HALF, y + STREET / 2), ASPHALT)
    for x in NORTH:
        paint((x - STREET / 2, -HALF, x + STREET / 2, HALF), ASPHALT)
    for line in markings():
        paint(line, WHITE)
    for cells, amount in ((32, 0.07), (256, 0.05), (TEXELS, 0.05)):
        noise = rng.normal(size=(cells, cells)).astype(np.float32)
        picture *= 1 + amount * zoom(noise, TEXELS // cells, order=1)[..., None]
    return Image.fromarray(picture.clip(0, 255).astype(np.uint8))


def paved(path: Path) -> bpy.types.Material:
    """A material of a picture by the UV map."""
    graph = Graph("Paved")
    picture = graph.add("TexImage", image=bpy.data.images.load(str(path)))
    return graph.surface({"Base Color": picture.outputs["Color"], "Roughness": 0.9})


def write_town(path: Path, *, rng: np.random.Generator) -> None:
    """Write a scenery 180 m square, and its ground's texture beside it."""
    land = Land(HALF)
    path.parent.mkdir(parents=True, exist_ok=True)
    ground_picture(rng).save(path.with_suffix(".png"))
    points = np.linspace(-HALF, HALF, 21)
    ground = land.add(
        "Ground", grid_vertices_and_quads(points, points, lambda x, y: 0 * x), paved(path.with_suffix(".png")), home="Land"
    )
    mesh = ground.data
    at = np.array([mesh.vertices[loop.vertex_index].co[:2] for loop in mesh.loops])
    mesh.uv_layers.new(name="UVMap").uv.foreach_set("vector", ((at + HALF) / (2 * HALF)).astype(np.float32).ravel())
    _houses(land, rng)
    _trees(land, rng)
    land.save(path)


def _houses(land: Land, rng: np.random.Generator) -> None:
    walls = [plain_material(f"Wall_{k}", color) for k, color in enumerate(("#cfc6b0", "#b9b2a8", "#d8d4cc"))]
    roofs = [plain_material(f"Roof_{k}", color) for k, color in enumerate(("#8c3f2b", "#9c4f36", "#5d5f63", "#a9a9a6"))]
    k = 0
    for west, south, east, north in lots()[1::2]:
        y, deep = (south + north) / 2, min(9.0, (north - south) / 2 - 3)
        for x in np.arange(west + 8, east - 7, 22.0):
            high, wide = rng.uniform(6, 14), rng.uniform(6, 9)
            wall = shapes.make_corner_box((x - wide, y - deep, 0), (x + wide, y + deep, high))
            roof = shapes.make_corner_box((x - wide, y - deep, high), (x + wide, y + deep, high + 0.3))
            if rng.random() < 0.7:
                gable = [(x - wide - 0.5, high), (x + wide + 0.5, high), (x, high + 4)]
                roof = shapes.extrude_along_y(gable, y - deep - 0.5, y + deep + 0.5)
            for name, shape, material in (("House", wall, walls[k % 3]), ("Roof", roof, roofs[k % 4])):
                house = land.add(f"{name}_{k}", (shape.vertices, shape.faces), material, home="Houses")
                house.data.shade_flat()
            k += 1


def _trees(land: Land, rng: np.random.Generator) -> None:
    """Trees along the sidewalks and in the gardens."""
    dress = [earth.bark_material("Bark", "#5a4a3a"), earth.leaf_material("Leaves", ("#2f4016", "#52652a"))]
    kinds = [
        vegetation.make_broadleaf_mesh(f"Tree_{k}", dress, height=height, spread=spread, rng=rng)
        for k, (height, spread) in enumerate([(9.0, 3.4), (7.0, 2.8), (11.0, 4.0)])
    ]
    along = [(x, y + side) for y, side, x in product(EAST, (-STREET / 2 - 3, STREET / 2 + 3), np.arange(-85, 85, 12.0))
             if min(abs(x - street) for street in NORTH) > 14 and rng.random() < 0.55]  # fmt: skip
    gardens = [(rng.uniform(lot[0], lot[2]), rng.choice([lot[1] + 1.5, lot[3] - 1.5])) for lot in lots()[1::2] * 8]
    for k, (x, y) in enumerate([*along, *gardens]):
        tree = bpy.data.objects.new(f"Tree.{k:03d}", kinds[k % 3])
        tree.location, tree.rotation_euler = (x, y, -0.1), (0, 0, rng.uniform(0, 2 * np.pi))
        tree.scale = (rng.uniform(0.7, 1.2),) * 3
        land.collection("Trees").objects.link(tree)


if __name__ == "__main__":
    write_town(Path(sys.argv[1]), rng=np.random.default_rng(int(sys.argv[2])))
