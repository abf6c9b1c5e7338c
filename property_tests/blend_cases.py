"""Descriptions of .blend files for `blend_maker`: mostly sound vehicles and sceneries, with a few odd things."""

from typing import Any

from hypothesis import strategies as st

ODD_NUMBERS = [0.0, -0.0, 1e-30, 1e6, 5e6, 1e20, -3e38, float("nan"), float("inf"), float("-inf")]
numbers = st.floats(-100.0, 100.0, width=32) | st.sampled_from(ODD_NUMBERS)
triples = st.tuples(numbers, numbers, numbers)
tame = st.tuples(*[st.floats(-9.0, 9.0, width=32)] * 3)
sizes = st.tuples(*[st.floats(0.25, 4.0, width=32)] * 3)
names = st.one_of(
    st.sampled_from(["Hull", "Turret", "Gun", "gun barrel", "Wheel", "ground", "Sky", "Water", "Tree.001", "Road"]),
    st.sampled_from(["", "\x1b[2J", "a/b", "../x", "[red]", "ü" * 40, "*", "mesh:x"]),
    st.text(st.characters(exclude_categories=["Cs"], exclude_characters="\0"), max_size=20),
)
SOLID = ("cube", "plane", "grid", "tube", "sphere")
OTHER = ("bare", "text", "curve", "ball", "empty", "lattice", "armature", "light", "camera", "hair", "points", "volume")
types = st.sampled_from([*SOLID, *SOLID, *OTHER, "pencil"])
modifiers = st.sampled_from([
    *("SUBSURF", "ARRAY", "MIRROR", "SOLIDIFY", "BOOLEAN", "DECIMATE", "CLOTH", "PARTICLE_SYSTEM", "PARTICLE_SYSTEM"),
    *("SKIN", "REMESH", "WIREFRAME", "SCREW", "ARMATURE", "SOFT_BODY", "OCEAN", "EXPLODE", "FLUID", "DYNAMIC_PAINT"),
    *("NODES", "NODES", "NODES"),
])  # fmt: skip
materials = st.sampled_from([
    *("plain", "bare", "glass", "clear", "volume", "displaced", "holes", "leaves", "missing", "water"),
])  # fmt: skip
extras = st.sampled_from([
    *("key", "constraint", "shape key", "carried", "on faces", "hidden", "adaptive", "bald", "furry", "refers"),
])  # fmt: skip


def part(type: str, name: str, location: Any, scale: Any, rotation: Any = (0.0, 0.0, 0.0), **more: Any) -> dict:
    """An ordinary object."""
    given = {"type": type, "name": name, "location": location, "scale": scale, "rotation": rotation}
    return {**given, "vertex": None, "material": None, "modifiers": [], "extras": [], **more}


LYING, ACROSS = (0.0, 1.5707964, 0.0), (1.5707964, 0.0, 0.0)
WHEELS = [part("tube", "Wheel", (x, y, 0.4), (0.4, 0.4, 0.1), ACROSS) for x in (-2.0, 2.0) for y in (-1.5, 1.5)]
TANK = [
    part("cube", "Hull", (0.0, 0.0, 1.0), (3.0, 1.6, 0.5), material="plain"),
    part("cube", "Turret", (0.3, 0.0, 1.9), (1.2, 1.0, 0.4), material="plain"),
    part("tube", "Gun", (2.9, 0.0, 1.9), (0.08, 0.08, 2.0), LYING),
    *WHEELS,
]
UNNAMED = [{**each, "name": f"Cube.{number:03}"} for number, each in enumerate(TANK)]
FIELD = [
    part("grid", "ground", (0.0, 0.0, 0.0), (2.0, 2.0, 1.0), material="plain"),
    part("tube", "Tree", (9.0, 4.0, 2.0), (0.3, 0.3, 2.0)),
    part("sphere", "Tree.001", (9.0, 4.0, 5.0), (2.0, 2.0, 2.0), material="leaves"),
    part("cube", "House", (-20.0, 9.0, 3.0), (5.0, 4.0, 3.0)),
]
SHORE = [
    part("grid", "Landscape", (0.0, 0.0, 0.0), (2.0, 2.0, 1.0), vertex=(-9.0, 9.0, -6.0)),
    part("plane", "Lake", (0.0, 0.0, -1.0), (2.0, 2.0, 1.0), material="water"),
    part("sphere", "Sky", (0.0, 0.0, 0.0), (90.0, 90.0, 90.0)),
    part("cube", "rock", (9.0, 9.0, 1.0), (1.0, 1.0, 1.0), modifiers=["NODES"]),
]
SOUND = [("vehicle", TANK), ("vehicle", UNNAMED), ("scenery", FIELD), ("scenery", SHORE)]

wild = st.fixed_dictionaries({
    "type": types,
    "name": names,
    "location": st.one_of(tame, triples),
    "scale": st.one_of(st.just((1.0, 1.0, 1.0)), sizes, triples),
    "rotation": st.one_of(st.just((0.0, 0.0, 0.0)), triples),
    "vertex": st.one_of(st.none(), st.none(), triples),
    "material": st.none() | materials,
    "modifiers": st.lists(modifiers, max_size=2),
    "extras": st.lists(extras, max_size=2),
})  # fmt: skip
added = st.builds(part, types, names, tame, sizes, tame, material=st.none() | materials)
change = st.one_of(
    st.tuples(st.just("name"), names),
    st.tuples(st.just("type"), types),
    st.tuples(st.sampled_from(["location", "vertex"]), tame),
    st.tuples(st.just("rotation"), tame),
    st.tuples(st.just("scale"), sizes),
    st.tuples(st.just("material"), materials),
    st.tuples(st.just("modifiers"), st.lists(modifiers, min_size=1, max_size=2)),
    st.tuples(st.just("extras"), st.lists(extras, min_size=1, max_size=2)),
    st.tuples(st.sampled_from(["location", "vertex", "scale", "rotation"]), triples),
)
parents = st.lists(st.tuples(st.integers(0, 7), st.integers(0, 7)), max_size=3)
no_damage = {"bytes": [], "keep": 1.0}
damages = st.one_of(
    st.builds(dict, bytes=st.lists(st.tuples(st.floats(0.0, 1.0), st.integers(0, 255)), min_size=1, max_size=40),
              keep=st.just(1.0)),
    st.builds(dict, bytes=st.just([]), keep=st.sampled_from([0.999, 0.9, 0.5, 0.01])),
)  # fmt: skip
patterns = st.sampled_from(["Turret", "Gun", "Cube*", "*", "", "mesh:*", "material:water*", "carrier", "[", "none"])
pivots = st.sampled_from(["Turret", "Hull", "none"]) | st.tuples(*[st.floats(-1e6, 1e6)] * 3)
settings = {
    "up": st.sampled_from(["z", "y", "-z", "x"]),
    "scale": st.sampled_from([0.01, 0.0254, 1e-9, 1e9]),
    "forward": st.sampled_from(["+x", "-y"]) | st.floats(-360.0, 360.0) | st.tuples(st.just(1.0), st.floats(-9.0, 9.0)),
    **dict.fromkeys(("turret", "gun"), patterns),
    **dict.fromkeys(("turret_pivot", "gun_pivot"), pivots),
    **dict.fromkeys(("keep", "drop", "exclude", "ground", "not_ground", "water"), st.tuples(patterns)),
}
options = st.sampled_from(sorted(settings)).flatmap(lambda key: st.builds(lambda value: {key: value}, settings[key]))


@st.composite
def cases(draw: st.DrawFn) -> dict:
    """A file: its content, damage, kind, reading options, and oddities."""
    odd = draw(st.sampled_from(["changed"] * 7 + ["wild", "damaged"]))
    if odd == "wild":
        kind, objects = draw(st.sampled_from(["vehicle", "scenery", None])), draw(st.lists(wild, max_size=4))
    else:
        kind, sound = draw(st.sampled_from(SOUND))
        objects = [dict(each) for each in sound]
        for at, (key, value) in draw(st.lists(st.tuples(st.integers(0, 6), change), max_size=2)):
            objects[at % len(objects)][key] = value
        objects += draw(st.lists(added, max_size=2))
        kind = draw(st.sampled_from([kind, kind, kind, None]))
    return {
        "odd": odd,
        "make": {
            "objects": objects,
            "parents": draw(st.one_of(st.just([]), st.just([]), parents)),
            "unit": draw(st.sampled_from([1.0] * 8 + [0.01, 1000.0, 1e-6])),
            "fewest": draw(st.sampled_from([1, 1000])),  # objects of which only one is evaluated
            "frame": draw(st.sampled_from([1] * 16 + [0, -5, 50, 1_000_000])),
        },
        "damage": draw(damages) if odd == "damaged" else no_damage,
        "kind": kind,
        "drawn": draw(st.sampled_from([True] + [False] * 9)),  # whether to draw what was read, which takes long
        "options": draw(st.one_of(st.just({}), st.just({}), options)),
    }
