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
from hulldown.reading.pieces.wording import MOST_NAMES, quote_names

BACKGROUND_LEVEL = 250.0  # gray around vehicles, of 255
MIN_MAGENTA_SHARE = 0.02  # of the pixels that have Blender's color of missing pictures
MAX_BLACK_BRIGHTNESS = 0.003  # linear light; soot has 0.02, and only what no light reaches has less
MIN_BLACK_SHARE = 0.15  # of the pixels; between wheels and in hatches it's 0.04
NEARLY_BLACK, COLORLESS = 0.1, 0.01  # linear light: the lines around drawings, whose gloss has 0.05
MIN_WHITE_BRIGHTNESS = 0.5  # linear light; 0.588 and 0.8 are what exporters and importers give where there is no color
MAX_WHITE_TINT = 0.05
MIN_WHITE_SHARE = 0.9  # of the pixels
MIN_OPAQUE_ALPHA = 0.95  # alpha that lets nothing through that one sees
MIN_GHOSTLY_SHARE = 0.3  # of the pixels; windows have less


def color_doubts(
    picture: Float[np.ndarray, "h w 4"], report: FileReport, *, beside: Callable[[], Sequence[str]]
) -> list[Doubt]:
    """Return doubts about the colors of a vehicle."""
    inside = minimum_filter(picture[..., 3], 3) > 0.0  # without the pixels of its outline
    if not inside.any():
        return []
    alpha = picture[inside, 3]
    light = picture[inside, :3] / alpha[:, None]
    low, high, (red, green, blue) = light.min(axis=1), light.max(axis=1), light.T
    magenta = np.mean((green < 0.1 * red) & (np.abs(red - blue) < 0.1 * red) & (red > MIN_WHITE_BRIGHTNESS))
    black = np.mean((high < MAX_BLACK_BRIGHTNESS) & (alpha >= MIN_OPAQUE_ALPHA))
    nearly_black = np.mean((high < NEARLY_BLACK) & (high - low < COLORLESS))
    white, ghostly = (
        np.mean((low > MIN_WHITE_BRIGHTNESS) & (high - low < MAX_WHITE_TINT)),
        np.mean(alpha < MIN_OPAQUE_ALPHA),
    )
    clear = [row for row in report.materials if row.clear]
    doubts = []

    def doubt(kind: DoubtKind, share: np.floating, text: str) -> None:
        doubts.append(Doubt(kind, f"{100.0 * share:.0f} % of its picture is {text}"))

    if magenta > MIN_MAGENTA_SHARE and not report.missing:
        doubt(DoubtKind.MAGENTA, magenta, "magenta, Blender's color of missing pictures; look for them in Blender")
    if black > MIN_BLACK_SHARE or nearly_black > MIN_WHITE_SHARE:
        text = (
            "black in light from everywhere: faces on top of each other (merge them by distance in Blender) or a shell "
            "for an outline (name it in `drop`), since Cycles draws both sides of faces"
        )
        doubt(DoubtKind.BLACK, max(black, nearly_black), text)
    if sum(row.share for row in clear) > 0.5:
        text = f"most of its surface is transparent ({quote_names(row.name for row in clear)}), like glass"
        doubts.append(Doubt(DoubtKind.TRANSPARENT, text))
    elif ghostly > MIN_GHOSTLY_SHARE:
        thin = [f"{row.name!r} has alpha {row.alpha:.3g}" for row in report.materials if row.alpha < MIN_OPAQUE_ALPHA]
        why = ", ".join(thin[:MOST_NAMES]) or "its textures have alpha"
        text = f"see-through: {why} (`d` in an .mtl, BLEND in glTF); set alpha to 1 if it's no ghost"
        doubt(DoubtKind.TRANSPARENT, ghostly, text)
    elif white > MIN_WHITE_SHARE:
        named, unused = quote_names(row.name for row in report.materials), beside()
        hint = f"; pictures beside it aren't used: {quote_names(unused, most=4)}" if unused else ""
        which = f" ({named})" if named else ""
        text = f"white or light gray{which}, as if without its textures{hint}; put them on its materials in Blender"
        doubt(DoubtKind.PALE, white, text)
    return doubts


def save_color_picture(picture: Float[np.ndarray, "h w 4"], path: Path) -> None:
    """Write a picture, see `reading.blender.vehicle_picture`, on `BACKGROUND_LEVEL` as PNG."""
    light, alpha = picture[..., :3], picture[..., 3:].clip(0.0, 1.0)
    color = srgb_from_linear((light / np.maximum(alpha, 1e-6)).clip(0.0, 1.0))
    pixels = 255.0 * alpha * color + BACKGROUND_LEVEL * (1.0 - alpha)
    Image.fromarray(np.rint(pixels).astype(np.uint8)).save(path)
