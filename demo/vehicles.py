"""Paints the ten demo vehicles and writes each into its .blend file."""

from __future__ import annotations

from pathlib import Path

import bpy
import numpy as np

from demo import launchers, materials, tanks_cast, tanks_plated, trucks
from demo.chassis import Paints
from demo.model import BlendModel

OLIVE = ("#4d5237", "#3c402b")
NATO = ("#4c5a3c", "#54412f", "#25272a")
STEPPE = ("#8a7a55", "#5a5a3a")
SAND = ("#b39a6b", "#8a6f48")
SPRING = ("#55633a", "#8d8257", "#30352a")
DUSTS = {"earth": "#7d6b50", "sand": "#b59b74"}

LOOK = {  # paint colours, dust, size of the patches, file units in a metre
    "mbt_wedge": (tanks_plated.mbt_wedge, NATO, "earth", 1.0, 1.0),
    "mbt_dome": (tanks_cast.mbt_dome, OLIVE, "earth", 1.2, 1.0),
    "mbt_slab": (tanks_plated.mbt_slab, SAND, "sand", 1.0, 1.0),
    "mbt_classic": (tanks_cast.mbt_classic, STEPPE, "earth", 1.1, 1.0),
    "truck_canvas": (trucks.truck_canvas, OLIVE, "earth", 1.3, 1.0),
    "truck_cargo": (trucks.truck_cargo, NATO, "earth", 1.0, 1.0),
    "truck_tanker": (trucks.truck_tanker, SAND, "sand", 1.3, 100.0),
    "sam_canister": (launchers.sam_canister, SPRING, "earth", 1.2, 1.0),
    "sam_rails": (launchers.sam_rails, ("#59603f", "#3f4630"), "earth", 1.2, 1.0),
    "sam_turret": (launchers.sam_turret, OLIVE, "earth", 1.0, 1.0),
}


# Vehicles painted from an image: its file beside the .blend, and the colours of its blocks.
TEXTURES = {
    "mbt_slab": ("desert_blocks.png", ("#b8a074", "#9c8156", "#c9b68d", "#7d6748")),
    "sam_turret": ("forest_blocks.png", ("#566043", "#3d4531", "#6d6f4f", "#2b2f27")),
}


def write_vehicle(name: str, folder: Path, *, rng: np.random.Generator) -> Path:
    """BlendModel one vehicle and save it as folder/<name>.blend, its texture, if any, in folder/textures."""
    if name in TEXTURES:
        file, blocks = TEXTURES[name]
        materials.block_pattern(folder / "textures" / file, blocks, rng=rng)
    build, colours, dust, size, unit = LOOK[name]
    model = BlendModel(name, unit=unit)
    paints = Paints(
        body=materials.camouflage("Camouflage", colours, dust=DUSTS[dust], unit=unit, size=size),
        rubber=materials.plain("Rubber", "#2b2a28", rough=0.85, mottle=0.3),
        steel=materials.plain("Steel", "#5e5c57", rough=0.5, metal=0.6),
        dark=materials.plain("Dark_Steel", "#35332f", rough=0.7, metal=0.3, mottle=0.3),
        glass=materials.glass(),
        canvas=materials.plain("Canvas", "#5b5840", rough=0.95, mottle=0.25),
        wood=materials.plain("Wood", "#7a6444", rough=0.8, mottle=0.3),
        lamp=materials.plain("Lamp", "#d8d6c8", rough=0.1, mottle=0.02),
        red=materials.plain("Tail_Lamp", "#8e1712", rough=0.25, mottle=0.05),
    )
    build(model, paints, folder)
    for material in list(bpy.data.materials):
        if material.users == 0:
            bpy.data.materials.remove(material)
    path = folder / f"{name}.blend"
    model.save(path)
    return path
