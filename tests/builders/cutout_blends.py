"""Make a row of cards, each cut out in another way, and Cycles' picture of them in front of a white world.

Run as a script with a folder to write into: cards.blend, shown.npy with the picture, and cards.json with their names.
"""

import json
import sys
from pathlib import Path

import bpy
import numpy as np

from hulldown.blender.add_nodes import add_node
from hulldown.blender.light_pictures import render_light, set_light_at_pixel_centers
from hulldown.reading.blender.surfaces.bake import bake_opacity_by_material
from hulldown.reading.blender.surfaces.opacity import is_opaque
from hulldown.render.blender import cycles
from hulldown.render.blender.object_index import ONE_RAY
from hulldown.tests.builders.blend_parts import fresh, mesh, place, save
from hulldown.tests.builders.node_trees import material_of, node_group, write_picture

TEXELS = 24
STEP, PIXELS = 1.2, 50  # meters between cards, pixels per meter
QUAD = ((0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0))
WIDE = ((-0.5, -0.7), (1.8, -0.7), (1.8, 1.6), (-0.5, 1.6))
RNG = np.random.default_rng(0)
FOLDER = Path(sys.argv[1])
CARDS = []


def waves():
    """Smooth, periodic values from 0 to 1."""
    u, v = np.meshgrid(*[(np.arange(TEXELS) + 0.5) / TEXELS] * 2)
    sums = sum(np.cos(2 * np.pi * (i * u + j * v) + RNG.uniform(0, 6)) for i in range(4) for j in range(-3, 4))
    return (sums - sums.min()) / np.ptp(sums)


def image(name, rgba, *, data=False, suffix="png"):
    path = write_picture(FOLDER / f"{name}.{suffix}", np.dstack(rgba))
    found = bpy.data.images.load(str(path))
    if data:
        found.colorspace_settings.name = "Non-Color"
    if name == "packed":
        found.pack()
        path.unlink()
    return found


class Tree:
    """Node tree of a material that is black where it's opaque; nodes by short names."""

    def __init__(self, tree):
        self.tree = tree
        self.black = self.add("Emission", None, 0.0).outputs[0]

    def add(self, kind, *inputs, **settings):
        given = {i: value for i, value in enumerate(inputs) if value is not None}
        return add_node(self.tree, kind, given, **settings)

    def texture(self, name, coordinates=None, **settings):
        return self.add("TexImage", coordinates, image=IMAGES[name], **settings)

    def alpha(self, name="soft", coordinates=None, **settings):
        return self.texture(name, coordinates, **settings).outputs["Alpha"]

    def color(self, name, **settings):
        return self.texture(name, **settings).outputs["Color"]

    def maths(self, operation, *inputs):
        return self.add("Math", *inputs, operation=operation).outputs[0]

    def principled(self, alpha):
        black = {"Base Color": (0.0, 0.0, 0.0, 1.0)}
        return add_node(self.tree, "BsdfPrincipled", {**black, "Alpha": alpha}).outputs[0]

    def through(self, share, first=None):
        return self.add("MixShader", share, first or self.add("BsdfTransparent").outputs[0], self.black).outputs[0]


def card(name, build, uv=QUAD, layer="UVMap"):
    x = STEP * len(CARDS)
    square = mesh(name, [(x, 0, 0), (x + 1, 0, 0), (x + 1, 0, 1), (x, 0, 1)], [(0, 1, 2, 3)])
    square.uv_layers.new(name=layer).uv.foreach_set("vector", np.array(uv, np.float32).ravel())
    square.materials.append(material_of(name, lambda tree: build(Tree(tree))))
    place(name, square)
    CARDS.append(name)


def mapped(tree, **settings):
    where = tree.add("Mapping", tree.add("TexCoord").outputs["UV"], (0.3, 0.1, 0.0), (0.0, 0.0, 0.4), (2.0, 3.0, 1.0))
    return tree.alpha("soft", where.outputs[0], **settings)


def grouped(tree):
    group, given, result = node_group("Shader", {"Share": "Float", "Shader": "Shader"}, {"Shader": "Shader"})
    through = add_node(group, "BsdfTransparent").outputs[0]
    mix = add_node(group, "MixShader", {0: given[0], 1: through, 2: given[1]})
    group.links.new(mix.outputs[0], result[0])
    bend = tree.tree.nodes.new("NodeReroute")
    tree.tree.links.new(tree.alpha(), bend.inputs[0])
    return tree.add("Group", bend.outputs[0], tree.black, node_tree=group).outputs[0]


def muted(tree):
    node = tree.add("Math", tree.alpha(), 0.9, operation="GREATER_THAN")
    node.mute = True
    return tree.through(node.outputs[0])


def named(tree, layer):
    return tree.through(tree.alpha("soft", tree.add("UVMap", uv_map=layer).outputs[0]))


def glow_added(tree):
    return tree.add("AddShader", tree.black, tree.add("BsdfTransparent").outputs[0]).outputs[0]


def both_ways(tree):
    alpha = tree.alpha()
    return tree.through(tree.maths("MULTIPLY", alpha, tree.maths("SUBTRACT", 1.0, alpha)))


def squared(tree):
    alpha = tree.alpha()
    return tree.through(tree.maths("MULTIPLY", alpha, alpha))


def ramp(tree):
    node = tree.add("ValToRGB", tree.alpha())
    node.color_ramp.elements[0].position, node.color_ramp.elements[1].position = 0.4, 0.5
    return tree.through(node.outputs[0])


def noise(tree):
    value = tree.add("TexNoise", tree.add("TexCoord").outputs["UV"], None, 3.0).outputs[0]
    return tree.through(tree.maths("MULTIPLY", value, 0.8))


def cards():
    card("principled alpha", lambda t: t.principled(t.alpha("hard")))
    card("mix by alpha", lambda t: t.through(t.alpha()))
    card("packed", lambda t: t.through(t.alpha("packed")))
    card("floats", lambda t: t.through(t.color("floats")))
    card("bright floats", lambda t: t.through(t.maths("GREATER_THAN", t.color("bright"), 2.0)))
    card("greater", lambda t: t.principled(t.maths("GREATER_THAN", t.alpha(), 0.4)))
    card("mask of glTF", lambda t: t.principled(t.maths("SUBTRACT", 1.0, t.maths("LESS_THAN", t.alpha(), 0.6))))
    card("round", lambda t: t.principled(t.maths("ROUND", t.alpha())))
    card("multiply", lambda t: t.through(t.maths("MULTIPLY", t.alpha(), 0.6)))
    card("opacity map", lambda t: t.through(t.color("gray")))
    card("opacity map as data", lambda t: t.through(t.color("data")))
    card("colored", lambda t: t.through(t.color("colored")))
    card("red", lambda t: t.through(t.add("SeparateColor", t.color("colored")).outputs[0]))
    card("mapping", lambda t: t.through(mapped(t)))
    for extension in ("REPEAT", "EXTEND", "CLIP", "MIRROR"):
        card(extension.lower(), lambda t, to=extension: t.through(t.alpha(extension=to)), uv=WIDE)
    card("clip of the inverse", lambda t: t.through(t.maths("SUBTRACT", 1.0, t.alpha(extension="CLIP"))), uv=WIDE)
    card("closest", lambda t: t.through(t.alpha(interpolation="Closest")), uv=WIDE)
    card("group", grouped)
    card("muted", muted)
    card("map range", lambda t: t.through(t.add("MapRange", t.alpha(), 0.3, 0.6, 0.0, 1.0).outputs[0]))
    card("invert", lambda t: t.through(t.add("Invert", 1.0, t.color("data")).outputs[0]))
    card("constant", lambda t: t.through(0.3))
    card("colored glass", lambda t: t.through(0.5, t.add("BsdfTransparent", (0.5, 0.5, 0.5, 1.0)).outputs[0]))
    card("glow added", glow_added)
    card("camera rays", lambda t: t.through(t.maths("MULTIPLY", t.add("LightPath").outputs[0], t.alpha())))
    card("layer by name", lambda t: named(t, "other"), layer="other")
    card("layer that is not there", lambda t: named(t, "lost"))
    card("flipped", lambda t: t.through(t.alpha()), uv=(QUAD[1], QUAD[0], QUAD[3], QUAD[2]))
    card("degenerate", lambda t: t.through(t.alpha()), uv=((0.3, 0.2),) * 4)
    card("two textures", lambda t: t.through(t.maths("MULTIPLY", t.alpha(), t.color("data"))))
    card("both ways", both_ways)
    card("squared", squared)
    card("ramp", ramp)
    card("noise", noise)
    card("lost image", lambda t: t.through(t.alpha("lost")))
    card("by angle", lambda t: t.through(t.add("LayerWeight").outputs["Facing"]))


def show():
    scene = bpy.context.scene
    cycles.configure_scene(scene, ONE_RAY, device="CPU")
    scene.world = bpy.data.worlds.new("white for the camera only")
    nodes, link = scene.world.node_tree.nodes, scene.world.node_tree.links.new
    nodes["Background"].inputs[0].default_value = (1.0, 1.0, 1.0, 1.0)
    link(nodes.new("ShaderNodeLightPath").outputs["Is Camera Ray"], nodes["Background"].inputs[1])
    lens = bpy.data.cameras.new("camera")
    lens.type, lens.ortho_scale = "ORTHO", STEP * len(CARDS)
    scene.camera = place("camera", lens, (lens.ortho_scale / 2, -5.0, 0.5), rot=(np.pi / 2, 0.0, 0.0))
    scene.render.resolution_x, scene.render.resolution_y = round(lens.ortho_scale * PIXELS), PIXELS
    set_light_at_pixel_centers(scene)
    return render_light(scene)[..., 0]


fresh()
SOFT = waves()
GRAY, OTHER, ONE = SOFT * 0.5 + 0.2, waves(), np.ones_like(SOFT)
LEAF = [0.2 * ONE, 0.5 * ONE, 0.1 * ONE]
IMAGES = {
    "soft": image("soft", [*LEAF, SOFT]),
    "hard": image("hard", [*LEAF, SOFT > 0.5]),
    "packed": image("packed", [*LEAF, SOFT]),
    "gray": image("gray", [SOFT, SOFT, SOFT, ONE]),
    "data": image("data", [GRAY, GRAY, GRAY, ONE], data=True),
    "colored": image("colored", [SOFT, 1 - SOFT, OTHER, ONE]),
    "lost": image("lost", [*LEAF, SOFT]),
    "floats": image("floats", [OTHER, OTHER, OTHER, ONE], suffix="exr"),
    "bright": image("bright", [4 * OTHER, 4 * OTHER, 4 * OTHER, ONE], suffix="exr"),
}
cards()
(FOLDER / "lost.png").unlink()
save(FOLDER / "cards.blend")
every = bake_opacity_by_material([material for material in bpy.data.materials if not is_opaque(material)])
for name in ("multiply", "invert"):
    key = bpy.data.materials[name].as_pointer()
    (alone,) = bake_opacity_by_material([bpy.data.materials[name]]).values()
    assert np.array_equal(alone.curve, every[key].curve), "one material is baked like many"
np.save(FOLDER / "shown.npy", show())
(FOLDER / "cards.json").write_text(json.dumps(CARDS))
