"""What is wrong with the colors of a vehicle's picture: magenta, black, white, or see-through."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float
from PIL import Image
from scipy.ndimage import minimum_filter

from hulldown.base.color import srgb_from_linear
from hulldown.reading.pieces.asset_report import FileReport
from hulldown.reading.pieces.doubt import Doubt, DoubtKind
from hulldown.reading.pieces.wording import MAX_SENTENCE_NAMES, quote_names

BACKGROUND_LEVEL = 250.0  # of 255: gray around vehicles
MIN_MAGENTA_SHARE = 0.02  # of the pixels, in Blender's color of missing pictures
MAX_BLACK_BRIGHTNESS = 0.003  # linear light; soot has 0.02, and only what no light reaches has less
MIN_BLACK_SHARE = 0.15  # of the pixels; between wheels and in hatches it's 0.04
MAX_LINE_BRIGHTNESS, MAX_LINE_COLOR = 0.1, 0.01  # linear light; in lines around drawings, whose gloss has 0.05
MIN_WHITE_BRIGHTNESS = 0.5  # linear light; 0.588 and 0.8 are what exporters and importers give where there is no color
MAX_WHITE_TINT = 0.05
MIN_WHITE_SHARE = 0.9  # of the pixels
MIN_OPAQUE_ALPHA = 0.95  # nobody sees through more
MIN_GHOSTLY_SHARE = 0.3  # of the pixels; windows have less
MIN_METAL_SHARE = 0.5  # of the surface
MAX_DARK_METAL, MIN_WHITE_METAL = 0.4, 0.99  # linear light: bare metals are between these
MIN_GLASS_SHARE = 0.1  # of the surface: with less, glass isn't what is black


def color_doubts(
    picture: Float[np.ndarray, "h w 4"], report: FileReport, *, beside: Callable[[], Sequence[str]], mapped: bool = False
) -> list[Doubt]:
    """Return doubts about the colors of a vehicle; `mapped` tells whether it has texture coordinates."""
    inside = minimum_filter(picture[..., 3], 3) > 0.0  # without the pixels of its outline
    if not inside.any():
        return []
    alpha = picture[inside, 3]
    light = picture[inside, :3] / alpha[:, None]
    low, high, (red, green, blue) = light.min(axis=1), light.max(axis=1), light.T
    magenta = np.mean((green < 0.1 * red) & (np.abs(red - blue) < 0.1 * red) & (red > MIN_WHITE_BRIGHTNESS))
    black = np.mean((high < MAX_BLACK_BRIGHTNESS) & (alpha >= MIN_OPAQUE_ALPHA))
    nearly_black = np.mean((high < MAX_LINE_BRIGHTNESS) & (high - low < MAX_LINE_COLOR))
    white, ghostly = (np.mean((low > MIN_WHITE_BRIGHTNESS) & (high - low < MAX_WHITE_TINT)), np.mean(alpha < MIN_OPAQUE_ALPHA))
    clear = [row for row in report.materials if row.clear]
    metals = [(row, row.color) for row in report.materials if row.metal and row.color]
    dark = [row for row, color in metals if max(color) < MAX_DARK_METAL]
    bare = [row for row, color in metals if min(color) >= MIN_WHITE_METAL]
    plain = {row.color for row in report.materials}
    doubts = []

    def doubt(kind: DoubtKind, share: np.floating, text: str) -> None:
        doubts.append(Doubt(kind, f"{100.0 * share:.0f} % of its picture is {text}"))

    if magenta > MIN_MAGENTA_SHARE and not report.missing:
        doubt(DoubtKind.MAGENTA, magenta, "magenta, Blender's color of missing pictures; look for them in Blender")
    if sum(row.share for row in dark) > MIN_METAL_SHARE:
        named = quote_names(row.name for row in dark)
        text = f"{named}: a dark metal, as glTF takes what has no metallicFactor; if it's paint, set Metallic to 0"
        doubts.append(Doubt(DoubtKind.BLACK, f"{text} in Blender, since it's rendered darker than paint"))
    elif black > MIN_BLACK_SHARE or nearly_black > MIN_WHITE_SHARE:
        cause = "faces on top of each other (merge them by distance in Blender) or a shell for an outline (name it in "
        cause += "`drop`), since Cycles draws both sides of faces"
        if sum(row.share for row in clear) > MIN_GLASS_SHARE:
            cause = f"the glass {quote_names(row.name for row in clear)}, unless faces are on top of each other"
        doubt(DoubtKind.BLACK, max(black, nearly_black), f"black in light from everywhere: {cause}")
    if sum(row.share for row in clear) > 0.5:
        text = f"most of its surface is transparent ({quote_names(row.name for row in clear)}), like glass"
        doubts.append(Doubt(DoubtKind.TRANSPARENT, text))
    elif ghostly > MIN_GHOSTLY_SHARE:
        thin = [f"{row.name!r} has alpha {row.alpha:.3g}" for row in report.materials if row.alpha < MIN_OPAQUE_ALPHA]
        why = ", ".join(thin[:MAX_SENTENCE_NAMES]) or "its textures have alpha"
        text = f"see-through: {why} (`d` in an .mtl, BLEND in glTF); set alpha to 1 if it's no ghost"
        doubt(DoubtKind.TRANSPARENT, ghostly, text)
    elif sum(row.share for row in bare) > MIN_METAL_SHARE:
        named = quote_names(row.name for row in bare)
        text = f"{named}: white metal, as glTF takes materials without values; give them colors in Blender"
        doubts.append(Doubt(DoubtKind.PALE, text))
    elif white > MIN_WHITE_SHARE and report.materials:
        named, unused = quote_names(row.name for row in report.materials), beside()
        hint = f"; pictures beside it aren't used: {quote_names(unused, most=4)}" if unused else ""
        which = f" ({named})" if named else ""
        text = f"white or light gray{which}, as if without its textures{hint}; put them on its materials in Blender"
        doubt(DoubtKind.PALE, white, text)
    elif mapped and len(plain) == 1 and None not in plain and not doubts:
        text = "all of it has one color, tires and windows too, as if its texture were lost; put that on its material"
        doubts.append(Doubt(DoubtKind.PALE, f"{text} in Blender, or give its parts colors"))
    return doubts


def save_picture_on_gray(picture: Float[np.ndarray, "h w 4"], path: Path) -> None:
    """Write a picture by `reading.blender.vehicle_picture` on `BACKGROUND_LEVEL` as PNG."""
    light, alpha = picture[..., :3], picture[..., 3:].clip(0.0, 1.0)
    color = srgb_from_linear((light / np.maximum(alpha, 1e-6)).clip(0.0, 1.0))
    pixels = 255.0 * alpha * color + BACKGROUND_LEVEL * (1.0 - alpha)
    Image.fromarray(np.rint(pixels).astype(np.uint8)).save(path)
