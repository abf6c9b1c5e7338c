"""Names and paths of the demo assets. Needs no Blender."""

from __future__ import annotations

TANK = "main battle tank"
TRUCK = "military truck"
LAUNCHER = "surface-to-air missile system"

# Vehicle -> class. The file is vehicles/<name>.blend, nose along +x, z up.
CATEGORY = {
    "mbt_wedge": TANK,
    "mbt_dome": TANK,
    "mbt_slab": TANK,
    "mbt_classic": TANK,
    "truck_canvas": TRUCK,
    "truck_cargo": TRUCK,
    "truck_tanker": TRUCK,
    "sam_canister": LAUNCHER,
    "sam_rails": LAUNCHER,
    "sam_turret": LAUNCHER,
}
# Army vehicles keep their camouflage as often as not, or wear one plain color.
PLAIN = ["own", "own", "own", "#5b6146", "#94835e", "#4d5154"]
CAMOUFLAGE = {"mbt_slab": "Desert_Blocks", "sam_turret": "Forest_Blocks"}  # where the material has another name
GLOSS = ["#d9dad6", "#8d9194", "#2b2d30", "#16191c", "#7d1f1c", "#23406e", "#3b4a3a", "#b9ad92"]
# What is no target: distractor -> the keys that the config gives it. The file is distractors/<name>.blend.
DISTRACTORS: dict[str, dict[str, object]] = {
    "civilian_car": {"weight": 1.5, "paint": [{"materials": ["Paint"], "colors": GLOSS}]},
    "panel_van": {"paint": [{"materials": ["Paint"], "colors": ["own", "own", *GLOSS]}]},
    "container": {"paint": [{"materials": ["Paint"], "colors": ["own", "#7d3a1c", "#6b6a1f", "#23406e", "#8d9194"]}]},
    "bale_stack": {"forward": "+x", "sceneries": ["temperate_hills"]},
    "tractor_trailer": {
        "sceneries": ["temperate_hills"],
        "paint": [{"materials": ["Paint"], "colors": ["own", "#9a2a1d", "#25508c", "#b58a1c"]}],
    },
    "burnt_hull": {"turret": "", "gun": ""},
}
SCENERIES = ("temperate_hills", "dry_steppe")
# Blender's own HDRIs that show the open air, then the skies computed here, which add crisp sunlight.
STUDIO_HDRIS = ("city", "forest", "sunrise", "sunset")
SKIES = ("sky_noon", "sky_morning", "sky_evening", "sky_overcast")

VEHICLE_FILES = tuple(f"vehicles/{name}.blend" for name in CATEGORY)
DISTRACTOR_FILES = tuple(f"distractors/{name}.blend" for name in DISTRACTORS)
SCENERY_FILES = tuple(f"sceneries/{name}.blend" for name in SCENERIES)
HDRI_FILES = tuple(f"hdris/{name}.exr" for name in (*STUDIO_HDRIS, *SKIES))
