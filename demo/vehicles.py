"""Paint the demo vehicles and distractors, and write each into its .blend file."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from hulldown.demo import cars, civilian, container, launchers, materials, tanks_cast, tanks_plated, trucks
from hulldown.demo.catalog import CIVILIAN_NAMES
from hulldown.demo.chassis import Paints
from hulldown.demo.model import BlendModel

OLIVE_PAINT = ("#4d5237", "#3c402b")
NATO_PAINT = ("#4c5a3c", "#54412f", "#25272a")
STEPPE_PAINT = ("#8a7a55", "#5a5a3a")
SAND_PAINT = ("#b39a6b", "#8a6f48")
SPRING_PAINT = ("#55633a", "#8d8257", "#30352a")
DUST_COLORS = {"earth": "#7d6b50", "sand": "#b59b74"}

VEHICLE_LOOKS = {  # paint colors, dust, size of the patches, file units in a meter
    "mbt_wedge": (tanks_plated.build_wedge_tank, NATO_PAINT, "earth", 1.0, 1.0),
    "mbt_dome": (tanks_cast.build_dome_tank, OLIVE_PAINT, "earth", 1.2, 1.0),
    "mbt_slab": (tanks_plated.build_slab_tank, SAND_PAINT, "sand", 1.0, 1.0),
    "mbt_classic": (tanks_cast.build_classic_tank, STEPPE_PAINT, "earth", 1.1, 1.0),
    "truck_canvas": (trucks.build_canvas_truck, OLIVE_PAINT, "earth", 1.3, 1.0),
    "truck_cargo": (trucks.build_cargo_truck, NATO_PAINT, "earth", 1.0, 1.0),
    "truck_tanker": (trucks.build_tanker_truck, SAND_PAINT, "sand", 1.3, 100.0),
    "sam_canister": (launchers.build_canister_launcher, SPRING_PAINT, "earth", 1.2, 1.0),
    "sam_rails": (launchers.build_rail_launcher, ("#59603f", "#3f4630"), "earth", 1.2, 1.0),
    "sam_turret": (launchers.build_turret_launcher, OLIVE_PAINT, "earth", 1.0, 1.0),
}


# Vehicles painted from an image: its file beside the .blend, and the colors of its blocks.
VEHICLE_TEXTURES = {
    "mbt_slab": ("desert_blocks.png", ("#b8a074", "#9c8156", "#c9b68d", "#7d6748")),
    "sam_turret": ("forest_blocks.png", ("#566043", "#3d4531", "#6d6f4f", "#2b2f27")),
}


# What builds each, and the material of its body.
DISTRACTOR_BUILDERS: dict[str, tuple[Callable[..., None], Callable[[], Any]]] = {
    "civilian_car": (cars.build_civilian_car, lambda: materials.gloss_paint_material("#7d1f1c", dust=DUST_COLORS["earth"])),
    "panel_van": (cars.build_panel_van, lambda: materials.gloss_paint_material("#d9dad6", dust=DUST_COLORS["earth"])),
    "container": (
        container.build_container,
        lambda: materials.rusted_paint_material("Paint", "#2f5f7d", rust="#6b3a22", share=0.35),
    ),
    **{
        name: (
            partial(civilian.build_civilian_vehicle, name=name),
            lambda: materials.gloss_paint_material("#8d9194", dust=DUST_COLORS["earth"]),
        )
        for name in CIVILIAN_NAMES
    },
}
# Where one differs from `_paints_with_body`: a part's name there, and the material in its place.
OTHER_MATERIALS = {
    **{
        name: {
            "canvas": lambda: materials.plain_material("Plates", "#e6e4d8", rough=0.4, mottle=0.03),
            "steel": lambda: materials.plain_material("Chrome", "#c9cbce", rough=0.08, metal=1.0, mottle=0.02),
        }
        for name in ("civilian_car", *CIVILIAN_NAMES)
    },
    "panel_van": {"canvas": lambda: materials.plain_material("Plates", "#e2c33a", rough=0.4, mottle=0.03)},
    "container": {"canvas": lambda: materials.plain_material("Lettering", "#dedad0", rough=0.6, mottle=0.1)},
}


def build_distractor_file(name: str, folder: Path) -> Path:
    """Model one thing that is no target and save it as folder/<name>.blend."""
    build, body = DISTRACTOR_BUILDERS[name]
    model = BlendModel(name)
    build(model, replace(_paints_with_body(body()), **{part: make() for part, make in OTHER_MATERIALS.get(name, {}).items()}))
    return _save_model(model, name, folder)


def build_vehicle_file(name: str, folder: Path, *, rng: np.random.Generator) -> Path:
    """Model one vehicle and save it as folder/<name>.blend, and its texture, if it has one, in folder/textures."""
    if name in VEHICLE_TEXTURES:
        file, blocks = VEHICLE_TEXTURES[name]
        materials.write_block_camouflage(folder / "textures" / file, blocks, rng=rng)
    build, colors, dust, size, unit = VEHICLE_LOOKS[name]
    model = BlendModel(name, unit=unit)
    build(
        model,
        _paints_with_body(materials.camouflage_material("Camouflage", colors, dust=DUST_COLORS[dust], unit=unit, size=size)),
        folder,
    )
    return _save_model(model, name, folder)


def _paints_with_body(body: Any) -> Paints:
    return Paints(
        body=body,
        rubber=materials.plain_material("Rubber", "#2b2a28", rough=0.85, mottle=0.3),
        steel=materials.plain_material("Steel", "#5e5c57", rough=0.5, metal=0.6),
        dark=materials.plain_material("Dark_Steel", "#35332f", rough=0.7, metal=0.3, mottle=0.3),
        glass=materials.dark_glass_material(),
        canvas=materials.plain_material("Canvas", "#5b5840", rough=0.95, mottle=0.25),
        wood=materials.plain_material("Wood", "#7a6444", rough=0.8, mottle=0.3),
        lamp=materials.plain_material("Lamp", "#d8d6c8", rough=0.1, mottle=0.02),
        red=materials.plain_material("Tail_Lamp", "#8e1712", rough=0.25, mottle=0.05),
    )


def _save_model(model: BlendModel, name: str, folder: Path) -> Path:
    for material in list(bpy.data.materials):
        if material.users == 0:
            bpy.data.materials.remove(material)
    path = folder / f"{name}.blend"
    model.save(path)
    return path
