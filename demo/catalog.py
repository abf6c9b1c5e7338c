"""Names and paths of the demo assets. Needs no Blender."""

from __future__ import annotations

TANK_CLASS = "main battle tank"
TRUCK_CLASS = "military truck"
LAUNCHER_CLASS = "surface-to-air missile system"

# Vehicle -> class. The file is vehicles/<name>.blend, nose along +x, z up.
VEHICLE_CLASSES = {
    "mbt_wedge": TANK_CLASS,
    "mbt_dome": TANK_CLASS,
    "mbt_slab": TANK_CLASS,
    "mbt_classic": TANK_CLASS,
    "truck_canvas": TRUCK_CLASS,
    "truck_cargo": TRUCK_CLASS,
    "truck_tanker": TRUCK_CLASS,
    "sam_canister": LAUNCHER_CLASS,
    "sam_rails": LAUNCHER_CLASS,
    "sam_turret": LAUNCHER_CLASS,
}
# Army vehicles keep their camouflage as often as not, or wear one plain color.
PLAIN_COLORS = ["own", "own", "own", "#5b6146", "#94835e", "#4d5154"]
CAMOUFLAGE_MATERIALS = {"mbt_slab": "Desert_Blocks", "sam_turret": "Forest_Blocks"}  # where the material has another name
CAR_COLORS = ["#d9dad6", "#8d9194", "#2b2d30", "#16191c", "#7d1f1c", "#23406e", "#3b4a3a", "#b9ad92"]
# More cars, trucks, and a bus, for `make photographs`.
CAR_NAMES = ("classic", "roadster", "hatchback", "sedan", "suv", "offroader", "minivan", "pickup")
CIVILIAN_NAMES = (*CAR_NAMES, "box_truck", "tipper", "bus")
# Vehicles that are no targets: distractor -> the keys that the config gives it. The file is distractors/<name>.blend.
DISTRACTORS: dict[str, dict[str, object]] = {
    "civilian_car": {"weight": 1.5, "paint": [{"materials": ["Paint"], "colors": CAR_COLORS}]},
    "panel_van": {"paint": [{"materials": ["Paint"], "colors": ["own", "own", *CAR_COLORS]}]},
    "container": {"paint": [{"materials": ["Paint"], "colors": ["own", "#7d3a1c", "#6b6a1f", "#23406e", "#8d9194"]}]},
    **{name: {"paint": [{"materials": ["Paint"], "colors": CAR_COLORS}]} for name in ("suv", "pickup", "box_truck", "bus")},
}
SCENERY_NAMES = ("temperate_hills", "dry_steppe")
# Blender's own HDRIs that show the open air, then the skies computed here, which add crisp sunlight.
STUDIO_HDRIS = ("city", "forest", "sunrise", "sunset")
SKY_NAMES = ("sky_noon", "sky_morning", "sky_evening", "sky_overcast")

VEHICLE_FILES = tuple(f"vehicles/{name}.blend" for name in VEHICLE_CLASSES)
DISTRACTOR_FILES = tuple(f"distractors/{name}.blend" for name in DISTRACTORS)
CIVILIAN_FILES = tuple(f"distractors/{name}.blend" for name in CIVILIAN_NAMES)
SCENERY_FILES = tuple(f"sceneries/{name}.blend" for name in SCENERY_NAMES)
HDRI_FILES = tuple(f"hdris/{name}.exr" for name in (*STUDIO_HDRIS, *SKY_NAMES))
