"""Matching of names in files: whole words in any case and spelling, or globs."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Iterable
from fnmatch import fnmatchcase
from functools import lru_cache

TURRET_WORDS = ("turret",)
LAUNCHER_WORDS = ("launcher", "tower")  # the turret in files without one named so
NOT_LAUNCHER = ("smoke", "grenade")
GUN_WORDS = ("gun", "barrel", "cannon", "howitzer", "mantlet")
NOT_GUN = ("machine", "mg", "coax", "oil", "fuel", "water", "drum", "rack")
PIVOT_WORDS = ("pivot",)
# Tried if no name has one of those as a whole word: parts of words, other languages, typos of one letter.
TURRET_HINTS = (
    *("turret", "turm", "tourelle", "bashnya", "bashnia", "torreta", "torretta", "torre", "wieza", "vez", "torn"),
    *("koepel", "torony", "kupol", "taret", "houtou", "paota", "башня", "башн", "炮塔", "砲塔", "포탑"),
)
LAUNCHER_HINTS = ("launcher", "werfer", "lanceur", "lanciatore", "lanzador", "puskov", "пусков", "wyrzutnia")
GUN_HINTS = (
    *("gun", "barrel", "cannon", "howitzer", "kanone", "kanon", "canon", "cannone", "rohr", "geschuetz", "haubitze"),
    *("obusier", "pushka", "puska", "stvol", "orudie", "canna", "lufa", "armata", "hlaven", "delo", "agyu", "loveg"),
    *("eldror", "namlu", "kanonsloop", "shuhou", "paoguan", "пушка", "ствол", "орудие", "炮管", "砲身", "포신"),
)
NOT_GUN_HINTS = (
    *("machine", "mitrailleuse", "maschinen", "pulemet", "smoke", "rauch", "fume", "auspuff", "abgas", "fuel"),
    *("kraft", "treib", "oil", "drum", "rack", "ammo", "munition", "coax", "gunner", "gunmetal", "gunpowder"),
    *("begun",),
)

WEAPON_WORDS = ("missile", "rocket", "trunnion", "muzzle", "breech", "cradle arm")  # an aiming part carries these

FRONT_WORDS = (  # parts at a vehicle's nose
    *("front", "windscreen", "windshield", "headlight", "head light", "head lamp", "headlamp", "grille", "grill"),
    *("bonnet", "hood", "cab", "cabin", "driver", "glacis", "radiator", "wiper", "steering", "mirror", "fog light"),
    *("scheinwerfer", "motorhaube", "kuehlergrill", "fahrerhaus", "fuehrerhaus", "frontscheibe", "vorne", "lenkrad"),
    *("capot", "phare", "pare brise", "avant", "cabine", "volant", "kabina", "kapot", "fara", "cofano", "faro"),
    *("delantero", "anteriore", "cabina", "parabrezza", "parabrisas"),
)
REAR_WORDS = (  # parts at a vehicle's tail
    *("rear", "tail", "taillight", "tail lamp", "tailgate", "trunk", "brake light", "back", "exhaust", "tow bar"),
    *("tow hook", "tow hitch", "trailer hitch", "heck", "hinten", "rueckleuchte", "auspuff", "arriere", "hayon"),
    *("zad", "posteriore", "trasero"),
)

VEHICLE_PART_WORDS = (  # parts that only vehicles have
    *("turret", "gun", "cannon", "howitzer", "launcher", "hull", "chassis", "wheel", "tyre", "tire", "axle"),
)

VEHICLE_WORDS = (  # whole vehicles
    *("vehicle", "car", "truck", "lorry", "bus", "van", "minivan", "pickup", "jeep", "suv", "sedan", "hatchback"),
    *("taxi", "cab", "limousine", "ambulance", "firetruck", "humvee", "tractor", "bulldozer", "excavator"),
    *("motorcycle", "motorbike", "tank", "mbt", "apc", "ifv", "howitzer", "semi trailer", "police car", "auto"),
    *("pkw", "lkw", "lastwagen", "panzer", "voiture", "camion", "coche", "macchina", "samochod", "ciezarowka"),
    *("mashina", "avtomobil", "автомобиль", "машина", "танк", "грузовик", "汽车", "自動車"),
)
NOT_VEHICLE_WORDS = (  # things beside vehicles, or that hold water
    *("park", "parking", "port", "carport", "garage", "stop", "station", "shelter", "wash", "lane", "track", "sign"),
    *("toll", "barrier", "trap", "wheel", "tire", "tyre", "road", "street", "water", "fuel", "oil", "gas", "septic"),
    *("storage", "tower", "rail", "cable", "ramp", "propane", "rain", "auto save"),
)

TURRETLESS_WORDS = (  # vehicles without a turret
    *("interior", "cockpit", "cabin", "dashboard", "seat", "steering", "door", "window", "indicator", "convertible"),
    *("roof", "lamp", "light", "mirror", "wiper", "hood", "bonnet", "trunk"),
)

BODY_WORDS = (  # other parts: a file with such names would name a turret too
    *("body", "door", "track", "suspension", "engine", "fender", "skirt", "armor", "armour", "seat", "window"),
    *("glass", "bumper", "roof", "plate", "hatch", "rim", "lamp", "light", "frame"),
)

HELPER_WORDS = (
    *("collision", "collider", "hitbox", "helper", "ucx", "ubx", "ucp", "usp", "bounding box", "bbox", "occluder"),
    *("shadow catcher", "backdrop", "cyclorama", "skydome", "softbox", "chrome ball", "blueprint", "wgt"),
)
PERSON_WORDS = ("human", "person", "soldier", "figure", "man", "woman", "mannequin", "character", "dummy")  # for scale
STAGE_WORDS = (
    *("floor", "ground", "groundplane", "terrain", "landscape", "stage", "ref", "reference", "platform", "pedestal"),
    *("podium", "plinth", "turntable", "shadow"),
)
PRIMITIVE_WORDS = ("grid", "plane")  # Blender's names of a new sheet, which things modeled from it keep, such as car bodies

GROUND_WORDS = (
    *("ground", "groundplane", "terrain", "landscape", "floor", "road", "soil", "dirt", "sand", "grassland", "field"),
    *("meadow", "street", "path", "track", "hill", "land", "earth", "heightmap", "dem", "island"),
)
NOT_GROUND = (
    *("rock", "stone", "boulder", "tree", "bush", "bushes", "shrub", "grass", "grasses", "plant", "fern", "flower"),
    *("leaf", "leaves", "branch", "branches", "log", "trunk", "stump", "fence", "wall", "sign", "lamp", "pole"),
    *("post", "house", "building", "hut", "bridge", "car", "cover", "scatter", "debris", "water", "sky", "skydome"),
    *("cloud", "barrier", "guardrail", "kerb", "curb", "fog", "asset", "prop", "vegetation", "foliage", "forest"),
    *("obstacle", "prototype"),
)
WATER_WORDS = (  # substances
    *("water", "wasser", "eau", "agua", "água", "acqua", "woda", "voda", "vatten", "vann", "vand", "вода", "水"),
    *("waterplane", "watersurface", "watermesh", "waterbody", "watersheet", "watervolume", "waterlevel", "水面"),
    *("wasserfläche", "wasserflaeche", "wasseroberfläche", "wasserspiegel", "seawater", "lakewater", "riverwater"),
    *("seewasser",),
)
WATER_BODY_WORDS = (  # bodies of water
    *("lake", "river", "sea", "ocean", "pond", "pool", "stream", "creek", "brook", "lagoon", "canal", "swamp"),
    *("puddle", "flood", "lakesurface", "riversurface", "oceansurface", "oceanplane", "seasurface", "see", "fluss"),
    *("teich", "meer", "ozean", "bach", "tümpel", "weiher", "kanal", "pfütze", "lac", "rivière", "riviere", "fleuve"),
    *("mer", "océan", "étang", "etang", "ruisseau", "lago", "río", "rio", "mar", "océano", "oceano", "estanque"),
    *("laguna", "fiume", "mare", "stagno", "lagoa", "jezioro", "rzeka", "morze", "staw", "jezero", "řeka", "reka"),
    *("rybník", "ozero", "more", "prud", "озеро", "река", "море", "пруд", "rivier", "vijver", "sjö", "sjø", "hav"),
    *("flod", "elv", "göl", "deniz", "nehir", "湖", "河", "海", "川", "池", "湖面", "海面"),
)
NOT_WATER = (  # things near water
    *("bed", "bottom", "shore", "bank", "beach", "coast", "side", "edge", "tower", "tank", "pump", "bottle"),
    *("barrel", "drum", "trough", "mill", "wheel", "lily", "lilies", "weed", "melon", "pipe", "hose", "hydrant"),
    *("fall", "well", "barrier", "barriers", "guardrail", "kerb", "curb", "boat", "ship", "bird", "dam", "pier"),
    *("gate", "lock", "window", "glass", "roof", "greenhouse", "under"),
)
BACKDROP_WORDS = ("sky", "skydome", "sky sphere", "backdrop", "cloud", "atmosphere", "fog")


def name_words(name: str) -> tuple[str, ...]:
    """Return the lower-case words and numbers of `name`, split at camelCase too, without Blender's ``.001``."""
    return _split_words(re.sub(r"\.\d{3,}$", "", name))


@lru_cache(maxsize=65536)
def _split_words(text: str) -> tuple[str, ...]:
    spaced = ""
    for before, char, after in zip(f" {text}", text, f"{text[1:]} ", strict=False):
        hump = char.isupper() and (before.islower() or (before.isupper() and after.islower()))
        if hump or char.isdigit() != before.isdigit():
            spaced += " "
        spaced += char if char.isalnum() else " "
    return tuple(spaced.lower().split())


def first_matching_pattern(name: str, patterns: Iterable[str]) -> str | None:
    """Return the first of `patterns` that matches `name`, or None."""
    patterns = tuple(patterns)
    numbers, globs = _pattern_words_and_globs(patterns)
    matched = [numbers[word] for word in _joined_word_runs(name) if word in numbers]
    matched += [i for i, glob in globs if fnmatchcase(name.lower(), glob)]
    return patterns[min(matched)] if matched else None


def name_matches_pattern(name: str, pattern: str) -> bool:
    """Return whether `pattern` is the whole name, or matches it as in `first_matching_pattern`."""
    return name.lower() == pattern.lower() or first_matching_pattern(name, [pattern]) is not None


@lru_cache(maxsize=4096)  # a name is held against many patterns, one after the other
def _joined_word_runs(name: str) -> tuple[str, ...]:
    parts = name_words(name)
    return tuple("".join(parts[i:k]) for i in range(len(parts)) for k in range(i + 1, len(parts) + 1))


@lru_cache(maxsize=256)
def _pattern_words_and_globs(patterns: tuple[str, ...]) -> tuple[dict[str, int], list[tuple[int, str]]]:
    globs = [(i, pattern.lower()) for i, pattern in enumerate(patterns) if any(c in pattern for c in "*?[")]
    numbers: dict[str, int] = {}
    for i, pattern in enumerate(patterns):
        word = "".join(name_words(pattern))
        if word and i not in dict(globs):
            numbers.setdefault(word, i)
            numbers.setdefault(word + "s", i)
    return numbers, globs


def first_matching_stem(name: str, stems: Iterable[str]) -> str | None:
    """Return the first of `stems` that a word of `name` begins or ends with, or nearly is; None if none.

    Accents make no difference. Stems of up to four letters must be a whole word or begin or end a longer one, and are
    never taken for another by a slip, which keeps the first letter: the Spanish "pieza" is no Polish "wieza". Scripts
    that are written without spaces match anywhere.
    """
    folded = [_fold_text(word) for word in name_words(name)]
    for stem in map(_fold_text, stems):
        for word in folded:
            at_end = word.startswith(stem) or word.endswith(stem)
            foreign = not stem.isascii() and stem in word
            slip = len(stem) >= 5 and word[:1] == stem[0] and abs(len(word) - len(stem)) <= 1 and _is_one_edit_apart(word, stem)
            if (at_end and (len(stem) >= 3 or word == stem)) or foreign or slip:
                return stem
    return None


def _fold_text(text: str) -> str:
    text = text.lower().replace("ä", "ae").replace("ö", "oe").replace("ü", "ue")
    return "".join(c for c in unicodedata.normalize("NFKD", text) if not unicodedata.combining(c))


def _is_one_edit_apart(a: str, b: str) -> bool:
    if len(a) > len(b):
        a, b = b, a
    same = next((i for i, (x, y) in enumerate(zip(a, b, strict=False)) if x != y), len(a))
    return a[same + (len(a) == len(b)) :] == b[same + 1 :]
