"""The commented config that `hulldown init` writes: every key, its default, what it does and what it may be."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any


def config_text(
    *,
    vehicles: Sequence[Mapping[str, Any]],
    sceneries: Sequence[Mapping[str, Any]],
    hdris: Sequence[str],
    distractors: Sequence[Mapping[str, Any]] = (),
    values: Mapping[str, Any] = MappingProxyType({}),
    notes: Mapping[str, Sequence[str]] = MappingProxyType({}),
    remarks: Sequence[str] = (),
) -> str:
    """A complete config for these assets, with a comment on every key.

    Parameters
    ----------
    vehicles, sceneries, distractors
        Keys and values of each `[[assets.vehicles]]`, `[[assets.sceneries]]` and `[[assets.distractors]]`.
    hdris
        Patterns of HDRI files.
    values
        "section.key" -> what it is set to in place of the default; only numbers, strings, and lists and tables of them.
    notes
        Path of an entry, or pattern of HDRIs -> what is said of it in comments, a line each.
    remarks
        What is said in comments below the entries, a line each.
    """
    entries = [
        _comments(notes.get(entry["path"], ())) + _table(f"assets.{kind}", entry)
        for kind, listed in (("vehicles", vehicles), ("distractors", distractors), ("sceneries", sceneries))
        for entry in listed
    ]
    if remarks:
        entries.append(_comments(remarks))
    text = _TEXT.format(entries="\n".join(entries), hdris=_patterns(hdris, notes))
    for key, value in values.items():
        text = _set(text, key, value)
    return text


def _set(text: str, key: str, value: Any) -> str:
    """The text with another value for "section.key", its comment left where it was as far as there is room."""
    section, name = key.split(".")
    line = re.compile(rf"(?ms)(^\[{section}\][^\n]*\n(?:(?!^\[).)*?^{name} = )([^#\n]*?)( *)(#|$)")

    def changed(found: re.Match[str]) -> str:
        new = _value(value)
        room = len(found[2]) + len(found[3]) - len(new)
        return found[1] + new + (" " * max(room, 2) if found[4] else "") + found[4]

    text, times = line.subn(changed, text, count=1)
    if not times:
        raise ValueError(f"values: the template has no line for {key!r}")
    return text


def _comments(lines: Sequence[str], indent: str = "") -> str:
    """A comment of each line, whatever characters of other people's names are in it."""
    return "".join(f"{indent}# {_printable(line)}\n" for line in lines)


def _printable(text: str) -> str:
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode("ascii") for c in text)


def _patterns(patterns: Sequence[str], notes: Mapping[str, Sequence[str]]) -> str:
    """A list in a line; a line for each where they have comments."""
    if not any(notes.get(pattern) is not None for pattern in patterns):
        return _value(list(patterns))
    indent = " " * 4
    lines = [f"{_comments(notes.get(one, ()), indent)}{indent}{_value(one)},\n" for one in patterns]
    return f"[\n{''.join(lines)}]"


def _table(name: str, entry: Mapping[str, Any]) -> str:
    return "\n".join([f"[[{name}]]", *(f"{key} = {_value(value)}" for key, value in entry.items()), ""])


def _value(value: Any) -> str:
    # What JSON and TOML write alike: strings, numbers, true and false, lists of them. Tables they do not.
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{_key(key)} = {_value(one)}" for key, one in value.items()) + " }"
    if isinstance(value, Sequence) and any(isinstance(one, Mapping) for one in value):
        return "[" + ", ".join(map(_value, value)) + "]"
    return json.dumps(value, ensure_ascii=False)


def _key(name: str) -> str:
    return name if re.fullmatch("[A-Za-z0-9_-]+", name) else _value(name)


_TEXT = """\
# hulldown config. Every key is shown with its default; delete what you do not want to change.
# Paths are relative to this file's folder. A range is [low, high]; a single number is a range of one value.

seed = 0  # the same seed, config and assets give the same plan, byte for byte

[assets]
cache = ".hulldown-cache"  # folder for geometry read from the files below
texture_size = 1024        # texels of the longer side that textures which cut out leaves are kept at
hdris = {hdris}  # patterns of .exr or .hdr files: light and backdrop

# A vehicle: path (.blend, .glb, .gltf, .fbx, .obj) and category (its class) are needed. Optional:
#   name = "..."                what the plan calls it; default: the file's name
#   forward = "+x"              where its nose points once z is up: "+x", "-x", "+y", "-y", degrees from +x towards
#                               +y, or a vector [x, y]; default: by its wheels, gun and names
#   yaw_deg = 0.0               degrees to turn its nose further, counter-clockwise seen from above
#   up = "z"                    axis that points up: "z", "y", "x" or one with a minus; default: by the file and wheels
#   scale = 1.0                 metres per unit of the file; default: from the file
#   keep = [...], drop = [...]  patterns of object names that are, or are not, the vehicle
#   turret = "...", gun = "..." pattern of the objects that turn and rise; "" for none; default: by name
#   turret_pivot, gun_pivot     about what they turn: [x, y, z] in the file's axes and units, or an object's name;
#                               default: origins, or by shape
#   turret_limits_deg = [-180, 180], gun_limits_deg = [-5, 20]
#                               how far they turn from how they stand in the file: left and up are positive
#   paint = [{{ materials = ["camo*"], colours = ["own", "#4b5320"], hue_deg = [-5, 5], value = [0.8, 1.2] }}]
#                               materials by name, painted anew at each position: in one of the colours ("own": as
#                               it is), turned by hue_deg, times saturation and value; never tyres, tracks, glass,
#                               lamps and bare metal, unless by their whole name; `inspect` lists the materials
#   sceneries = ["..."]         names or patterns of the sceneries that it is placed on; default: all
# A scenery: path is needed. Optional: name, up, scale, and
#   weight = 1.0                how often it is drawn beside the others
#   ground = [...], not_ground = [...]  whole names of objects that are, or are not, its ground; * for a part of a name
#   water = [...]               all of its water, below which nothing is placed; [] for none; default: by name, material
#   drop = [...]                objects that are neither planned with nor rendered
# A distractor is no target, such as a civilian car or a container; it stands beside targets and has no label.
# [[assets.distractors]]        path is needed. Optional: all that a vehicle has, and
#   category = "..."            its class, if it is to be labelled; budgets do not count it
#   weight = 1.0                how often it is drawn beside the others
#   sceneries = [...]           names or patterns of the sceneries that it occurs in; default: all

{entries}
[ground]
include = []      # whole names of objects that are ground in all sceneries; * for a part of a name
exclude = []      # and that are not
fallback_z = 0.0  # height of the plane that is the ground if no object is, in the file's coordinates, metres

[placement]
margin = 0.8               # share of the scenery's extent that vehicles are placed in, about its centre
max_slope_deg = 30.0       # steeper ground is refused, at the spot and under the whole vehicle
rule = "support"           # how the resting plane is found: "support", "least_squares", "averaged" (the paper's)
contact = "footprint"      # what stands on the ground: "footprint", tracks or wheels; "box", all under the bounding box
footprint = 5              # n x n rays under it
min_valid_share = 0.8      # least share of them that must meet ground
max_gap = 1.0              # metres of air under the vehicle's underside, at most
max_penetration = 0.3      # metres of ground above it, at most
fording_depth = 0.0        # metres of water that a vehicle may stand in
obstacle_clearance = 0.5   # metres between vehicles and obstacles, at least
vehicle_clearance = 2.0    # metres between vehicles, at least
vehicles_per_image = [1, 1]       # 1 is the target alone; more adds companions, drawn from all vehicles
companion_distance = [8.0, 40.0]  # metres from the target
distractors_per_image = [0, 3]    # if any are listed above
distractor_distance = [0.0, 40.0] # metres from the target; all places within are alike
articulate = true          # turn turrets and raise guns, within the limits of each vehicle
max_tries = 10000          # places tried before giving up, with the counted reasons

[camera]
fov_x_deg = [40.0, 60.0]       # horizontal field of view
size_measure = "paper"         # "paper": distance by eq 6; "height", "width", "diagonal", "area": of the box, exactly
target_fraction = [0.1, 0.3]   # share of the image height that the vehicle's smallest dimension fills: T_f of eq 5;
                               # with another measure the share of the image's height, width, ... that its box fills
distance_factor = [0.7, 4.0]   # distances are D of eq 6 times this; only with "paper"
distance_m = [2.0, 5000.0]     # and within these metres
elevation_deg = [3.0, 35.0]    # of the camera above the vehicle's horizon
elevation_sampling = "angle"   # "angle": uniform in degrees; "sphere": uniform on the shell's area
framing = 0.8                  # 0 centres the target, 1 lets it be anywhere in the frame
ground_clearance = 0.5         # metres of the camera above the ground, at least
obstacle_clearance = 1.0       # metres between camera and obstacles, at least
visible_fraction = [0.3, 1.0]  # share of the target's outline that nothing hides; [0.3, 0.8] asks for half-hidden ones
visibility_rays = 256          # rays per image that measure it
truncated_fraction = [0.0, 0.0]  # share of the target's box that the frame cuts off
min_box_px = 8.0               # least width and height of the target's box
max_tries = 50                 # cameras tried for an image before the vehicle is moved elsewhere

[annotate]  # what a label shows at least, beside a target's, for which [camera] says it
# min_box_px = 8.0             # least width and height of its box; default: camera.min_box_px
# min_visible_fraction = 0.3   # default: the least camera.visible_fraction
# max_truncated_fraction = 0.8 # default: 0.8, or the largest camera.truncated_fraction if that is more
below = "ignored"              # what shows less: "ignored", a label with iscrowd = 1; "left_out"

[budget]
images_per_class = 140  # its models take turns; or a table by class: {{ tank = 200, truck = 100 }}
# positions_per_vehicle = 28  # instead: images = vehicles x positions x images_per_position (eq 1)
images_per_position = 5       # images of one vehicle at one place
background_share = 0.0        # share of all images that show no target, beside those above
background_distractors = 0.5  # in this share of them a distractor stands where the target would

[light]
hdris = []             # names or patterns of HDRIs, or {{ name = "noon*", weight = 2.0 }}; empty: all alike
yaw_deg = [0.0, 360.0] # turn of the HDRI about the vertical
strength = [0.7, 1.3]  # factor on its brightness
backdrop = "hdri"      # what is seen of it: "hdri", all; "sky", what is above its horizon, whose colour goes on below
exposure = "auto"      # "auto": a grey card on open land is mid-grey; or EV, the same for all images
exposure_error_ev = [-1.0, 1.0]     # what the camera is off that
white_balance_error_k = [0.0, 0.0]  # kelvin that its white balance is off 6500 K; more is warmer

overcast = []          # names or patterns of HDRIs for rain and snow; empty: the same as for all other weather

[weather]  # shares of images; the rest is clear
fog = 0.0
rain = 0.0
snow = 0.0
dust = 0.0
visibility_m = [300.0, 3000.0]       # how far one sees in fog; 3000: haze
rain_mm_h = [2.0, 50.0]              # rate of rain, from which all of it follows; 2: light, 10: heavy, 50: a cloudburst
snow_visibility_m = [300.0, 2000.0]  # how far one sees in falling snow
dust_visibility_m = [200.0, 2000.0]  # how far one sees in blown dust
snow_cover = [0.3, 1.0]              # how far the ground is under snow
vehicle_snow_cover = [0.0, 0.8]      # how far vehicles are: one in use is bare, a parked one is not
dust_cover = [0.0, 0.5]              # how far the ground is under dust
vehicle_dust_cover = [0.1, 0.8]      # how far the lower parts of vehicles are
wind_m_s = [0.0, 8.0]                # speed of the wind, from anywhere; it slants what falls
exposure_s = 0.004                   # how long the shutter is open: the length of streaks
min_contrast = 0.05                  # share of its contrast that the air must leave a target; 0: it may be a ghost

[render]
profile = "paper"  # "paper": 128 samples, denoised; "fast": for a look. Sets the commented keys below.
width = 1920
height = 1080
# samples = 128             # rays per pixel
# denoise = true            # OpenImageDenoise
# adaptive_threshold = 0.0  # noise at which a pixel gets no more samples; 0: all get all
# bounces = 12              # of light
"""

CONFIG_TEMPLATE = config_text(
    vehicles=[{"path": "vehicles/tank.blend", "category": "main battle tank"}],
    sceneries=[{"path": "sceneries/hills.blend"}],
    hdris=["hdris/*.exr"],
)
