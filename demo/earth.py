"""Materials of the open country: ground that changes with slope and place, rock, bark, leaves, road."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from hulldown.demo.materials import Color, Graph


@dataclass(frozen=True)
class Soil:
    """Colors of a landscape's ground."""

    cover: tuple[Color, Color, Color]  # lush, common, dry
    bare: tuple[Color, Color]  # earth or sand, two tones
    rock: tuple[Color, Color]
    haze: Color
    bare_share: tuple[float, float]  # noise levels between which cover gives way to bare ground
    stony: float  # how much of the pebbles shows through the cover, 0 to 1
    tufts: float  # meters of height of the finest bumps
    clumps: float  # how much tussocks stand out of the cover, 0 to 1


def ground_material(name: str, soil: Soil, *, far: bool = False) -> Any:
    """Ground with patches of every size, bare on slopes, rock where steep; far ground fades into the haze."""
    g = Graph(name)
    where = g.add("TexCoord").outputs["Object"]
    up = g.normal_z_socket()
    vast = g.noise_socket(where, 0.006, detail=2.0)
    wide = g.noise_socket(where, 0.03, detail=3.0, rough=0.6, warp=0.8)
    middle = g.noise_socket(where, 0.35, detail=4.0, rough=0.65)
    small = g.noise_socket(where, 3.0, detail=5.0, rough=0.7)
    fine = g.noise_socket(where, 24.0, detail=2.0, rough=0.7)
    clod, kind = g.cells(g.add("VectorMath", {0: where, 1: small}).outputs[0], 2.6)

    lush, common, dry = soil.cover
    cover = g.mixed_color_socket(g.ramp_socket(wide, 0.38, 0.62), lush, common)
    cover = g.mixed_color_socket(g.maths("MULTIPLY", g.ramp_socket(middle, 0.45, 0.68), 0.75), cover, dry)
    cover = g.mixed_color_socket(g.maths("MULTIPLY", g.ramp_socket(vast, 0.42, 0.6), 0.5), cover, common)
    # Tips in the light, dark gaps between tussocks, and tussocks unlike their neighbors.
    tips = g.maths("MULTIPLY", g.ramp_socket(small, 0.48, 0.66), 0.45 * soil.clumps)
    cover = g.shade(g.mixed_color_socket(tips, cover, dry), g.noise_socket(where, 1.1, detail=2.0, rough=0.8, warp=0.5), 0.22)
    cover = g.mixed_color_socket(
        g.maths("MULTIPLY", g.ramp_socket(small, 0.46, 0.30), 0.55 * soil.clumps),
        cover,
        g.mixed_color_socket(0.65, lush, "#14150d"),
    )
    cover = g.shade(g.shade(cover, small, 0.22), fine, 0.35)
    bare = g.shade(g.shade(g.mixed_color_socket(g.ramp_socket(middle, 0.35, 0.65), *soil.bare), small, 0.22), fine, 0.2)
    rock = g.shade(g.mixed_color_socket(g.ramp_socket(small, 0.3, 0.7), *soil.rock), middle, 0.3)

    # Patches of bare ground have ragged edges because fine noise decides them too.
    patch = g.maths("ADD", g.maths("MULTIPLY", wide, 0.6), g.maths("MULTIPLY", small, 0.4))
    worn = g.maths(
        "MAXIMUM",
        g.ramp_socket(patch, *soil.bare_share),
        g.ramp_socket(g.maths("ADD", up, g.maths("MULTIPLY", small, 0.12)), 0.955, 0.90),
    )
    pebble = g.maths("MULTIPLY", g.ramp_socket(clod, 0.30, 0.20), g.ramp_socket(kind, 0.52, 0.58))
    seen = g.maths("MULTIPLY", pebble, g.maths("MAXIMUM", g.maths("MULTIPLY", worn, 0.8), soil.stony))
    color = g.mixed_color_socket(seen, g.mixed_color_socket(worn, cover, bare), g.shade(soil.rock[0], fine, 0.4))
    steep = g.ramp_socket(g.maths("ADD", up, g.maths("MULTIPLY", middle, 0.16)), 0.88, 0.80)
    color = g.mixed_color_socket(steep, color, rock)
    if far:
        away = g.add("VectorMath", {0: where}, operation="LENGTH").outputs["Value"]
        woods = g.maths(
            "MULTIPLY",
            g.ramp_socket(g.noise_socket(where, 0.0045, detail=8.0, rough=0.6), 0.50, 0.53),
            g.ramp_socket(away, 600.0, 900.0),
        )
        color = g.mixed_color_socket(
            woods, color, g.shade(g.mixed_color_socket(0.55, lush, "#1c2416"), g.noise_socket(where, 0.06, detail=3.0), 0.4)
        )
        color = g.mixed_color_socket(g.maths("MULTIPLY", g.ramp_socket(away, 400.0, 4200.0), 0.75), color, soil.haze)
    height = g.maths("ADD", small, g.maths("MULTIPLY", fine, 0.35))
    return g.surface(
        {
            "Base Color": color,
            "Roughness": g.maths("ADD", 0.78, g.maths("MULTIPLY", middle, 0.3)),
            "Specular IOR Level": 0.15,
            "Normal": g.bump_normal_socket(height, soil.tufts, 0.9),
        }
    )


def road_material(name: str, tones: tuple[Color, Color], verge: Color, *, half: float) -> Any:
    """Make a dirt road by its UV map (u meters across, v along): two ruts, a grown-over middle, ragged verges."""
    g = Graph(name)
    where = g.add("TexCoord").outputs["Object"]
    across = g.maths("ABSOLUTE", g.add("SeparateXYZ", {0: g.add("TexCoord").outputs["UV"]}).outputs[0])
    middle = g.noise_socket(where, 0.5, detail=5.0, rough=0.65)
    small = g.noise_socket(where, 4.0, detail=6.0, rough=0.7)
    fine = g.noise_socket(where, 30.0, detail=3.0)
    ragged = g.maths("ADD", across, g.maths("MULTIPLY", g.maths("SUBTRACT", small, 0.5), 1.4))
    color = g.mixed_color_socket(g.ramp_socket(middle, 0.35, 0.65), *tones)
    rut = g.ramp_socket(g.maths("ABSOLUTE", g.maths("SUBTRACT", across, 0.95)), 0.42, 0.16)
    color = g.mixed_color_socket(g.maths("MULTIPLY", rut, 0.45), color, "#4f4232")
    grown = g.maths("MULTIPLY", g.ramp_socket(ragged, 0.35, 0.05), g.ramp_socket(middle, 0.4, 0.6))
    edge = g.ramp_socket(ragged, half - 1.1, half - 0.5)
    color = g.mixed_color_socket(g.maths("MAXIMUM", g.maths("MULTIPLY", grown, 0.7), edge), color, verge)
    color = g.shade(g.shade(color, small, 0.2), fine, 0.22)
    height = g.maths("SUBTRACT", g.maths("ADD", small, g.maths("MULTIPLY", fine, 0.3)), g.maths("MULTIPLY", rut, 0.6))
    return g.surface(
        {"Base Color": color, "Roughness": 0.93, "Specular IOR Level": 0.2, "Normal": g.bump_normal_socket(height, 0.05, 0.8)}
    )


def stone_material(name: str, tones: tuple[Color, Color], growth: Color) -> Any:
    """Boulders, with moss or dust on what faces up; each instance a little different."""
    g = Graph(name)
    where = g.add("TexCoord").outputs["Object"]
    coarse = g.noise_socket(where, 1.2, detail=6.0, rough=0.65)
    fine = g.noise_socket(where, 9.0, detail=5.0, rough=0.7)
    up = g.normal_z_socket()
    color = g.shade(g.mixed_color_socket(g.ramp_socket(coarse, 0.35, 0.65), *tones), fine, 0.3)
    color = g.mixed_color_socket(g.maths("MULTIPLY", g.ramp_socket(g.maths("ADD", up, coarse), 1.1, 1.5), 0.8), color, growth)
    return g.surface(
        {
            "Base Color": color,
            "Roughness": 0.9,
            "Normal": g.bump_normal_socket(g.maths("ADD", coarse, g.maths("MULTIPLY", fine, 0.3)), 0.12, 0.8),
        }
    )


def bark_material(name: str, color: Color) -> Any:
    """Furrowed bark."""
    g = Graph(name)
    where = g.add("Mapping", {0: g.add("TexCoord").outputs["Object"], "Scale": (9.0, 9.0, 1.6)}).outputs[0]
    furrows = g.noise_socket(where, 1.0, detail=4.0, rough=0.6)
    return g.surface(
        {"Base Color": g.shade(color, furrows, 0.5), "Roughness": 0.92, "Normal": g.bump_normal_socket(furrows, 0.03)}
    )


def leaf_material(name: str, colors: tuple[Color, Color]) -> Any:
    """Leaves that let some light through, each spray and each plant of its own shade."""
    g = Graph(name)
    plant = g.add("ObjectInfo").outputs["Random"]
    spray = g.add("NewGeometry").outputs["Random Per Island"]
    tone = g.maths("ADD", g.maths("MULTIPLY", spray, 0.55), g.maths("MULTIPLY", plant, 0.45))
    color = g.mixed_color_socket(tone, *colors)
    face = g.add("BsdfPrincipled", {"Base Color": color, "Roughness": 0.6, "Specular IOR Level": 0.25}).outputs[0]
    through = g.add("BsdfTranslucent", {"Color": g.mixed_color_socket(0.5, color, "#8a9a3a")}).outputs[0]
    g.out(g.add("MixShader", {0: 0.3, 1: face, 2: through}).outputs[0])
    return g.material
