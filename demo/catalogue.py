"""What the demo assets are called and where they lie below their folder. Needs no Blender."""

from __future__ import annotations

from typing import Any

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
# What is no target: distractor -> the keys that the config gives it. The file is distractors/<name>.blend.
DISTRACTORS: dict[str, dict[str, Any]] = {
    "civilian_car": {"weight": 1.5},
    "panel_van": {},
    "container": {},
    "bale_stack": {"forward": "+x", "sceneries": ["temperate_hills"]},
    "tractor_trailer": {"sceneries": ["temperate_hills"]},
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
