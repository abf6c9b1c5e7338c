"""Parts of self-contained HTML pages: nothing is fetched, pictures are in the file, thumbnails filter by clicks."""

from __future__ import annotations

import base64
import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from html import escape
from importlib.resources import files

GENERATOR = "hulldown"
# Nothing may be fetched from anywhere: what the page shows is in it.
POLICY = "default-src 'none'; img-src data:; style-src 'unsafe-inline'; script-src 'unsafe-inline'"


@dataclass(frozen=True, slots=True)
class Tile:
    """A thumbnail.

    Parameters
    ----------
    picture
        JPEG or PNG.
    caption
        Lines below it; the first stands out.
    values
        Of each facet by key what the thumbnail is, or several such; a facet that says nothing of it
        is left out.
    numbers
        Of each key of an `Order` what it is put in order by; what is not known comes last.
    overlay
        SVG that is drawn over the picture, and can be hidden.
    """

    picture: bytes
    caption: Sequence[str]
    values: Mapping[str, str | Sequence[str]]
    numbers: Mapping[str, float] = field(default_factory=dict)
    overlay: str = ""


@dataclass(frozen=True, slots=True)
class Facet:
    """Something thumbnails are filtered by.

    Parameters
    ----------
    key, title
        What it is called in `Tile.values`, and for readers.
    values
        What can be chosen, in order.
    """

    key: str
    title: str
    values: Sequence[str]


@dataclass(frozen=True, slots=True)
class Order:
    """Something thumbnails can be put in order by.

    Parameters
    ----------
    key, title
        What it is called in `Tile.numbers`, and for readers.
    """

    key: str
    title: str


def page(title: str, *parts: str) -> str:
    """A whole page from parts that the functions here have made."""
    style, script = (files("dataset").joinpath(name).read_text(encoding="utf-8") for name in ("page.css", "page.js"))
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        f'<meta http-equiv="Content-Security-Policy" content="{POLICY}">'
        f'<meta name="generator" content="{GENERATOR}">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{escape(title)}</title>\n<style>{style}</style></head>\n<body><main>\n<h1>{escape(title)}</h1>\n"
        + "\n".join(parts)
        + "\n</main>\n<dialog><span class=frame></span><p></p><button autofocus>Close</button></dialog>\n"
        f"<script>{script}</script></body></html>\n"
    )


def section(heading: str, *parts: str) -> str:
    """Parts below a heading."""
    return f"<section><h2>{escape(heading)}</h2>\n" + "\n".join(parts) + "\n</section>"


def words(text: str, *, warning: bool = False) -> str:
    """A paragraph."""
    return f"<p{' class=warning' if warning else ''}>{escape(text)}</p>"


def items(texts: Sequence[str]) -> str:
    """A list of sentences."""
    return "<ul>" + "".join(f"<li>{escape(text)}</li>" for text in texts) + "</ul>"


def table(
    header: Sequence[str],
    rows: Sequence[Sequence[str]],
    *,
    shades: Sequence[Sequence[float]] | None = None,
    choose: Sequence[Mapping[str, str]] | None = None,
) -> str:
    """A table whose first column names the rows.

    Parameters
    ----------
    header
        One cell a column.
    rows
        The cells.
    shades
        From 0 to 1 how dark each cell but the first of its row is.
    choose
        Of each row the values that a click on its name filters the thumbnails by.
    """
    lines = ["<tr>" + "".join(f"<th scope=col>{escape(cell)}</th>" for cell in header) + "</tr>"]
    for r, (first, *cells) in enumerate(rows):
        name = escape(first)
        if choose is not None:
            pairs = " ".join(f'data-set-{key}="{escape(value)}"' for key, value in choose[r].items())
            name = f"<button class=choose {pairs}>{name}</button>"
        shaded = [f' style="--shade:{shades[r][c]:.3f}"' if shades else "" for c in range(len(cells))]
        body = "".join(f"<td{shade}>{escape(cell)}</td>" for cell, shade in zip(cells, shaded, strict=True))
        lines.append(f"<tr><th scope=row>{name}</th>{body}</tr>")
    return f"<div class=scroll><table{' class=shaded' if shades else ''}>" + "\n".join(lines) + "</table></div>"


def folded(summary: str, *parts: str) -> str:
    """Parts that a click on their summary shows."""
    return f"<details><summary>{escape(summary)}</summary>\n" + "\n".join(parts) + "\n</details>"


def chart(svg: bytes, says: str) -> str:
    """A chart; `says` is for those who cannot see it."""
    return f'<img class=chart src="{data_uri(svg, "image/svg+xml")}" alt="{escape(says)}">'


def charts(*parts: str) -> str:
    """Charts side by side where there is room."""
    return "<div class=charts>" + "\n".join(parts) + "</div>"


def link(text: str, to: str) -> str:
    """A paragraph that leads to a file beside the page."""
    return f'<p><a href="{escape(to)}">{escape(text)}</a></p>'


def gallery(tiles: Sequence[Tile], facets: Sequence[Facet], orders: Sequence[Order] = ()) -> str:
    """Thumbnails, with a choice for each facet; a click on one shows it large. Facets that tell no two apart go.

    Parameters
    ----------
    tiles
        In the order in which they stand first.
    facets
        What they are filtered by.
    orders
        What else they can be put in order by.
    """
    bars = []
    for facet in facets:
        found = Counter(value for tile in tiles for value in _several(tile.values.get(facet.key)))
        counts = {value: found[value] for value in facet.values}
        options = [
            f'<option value="{escape(value)}">{escape(value)} ({n})</option>' for value, n in counts.items() if n
        ]
        if len(options) > 1 or (options and sum(counts.values()) < len(tiles)):
            title, key = escape(facet.title), escape(facet.key)
            all_of_them = f"<option value=''>all</option>{''.join(options)}"
            bars.append(f"<label>{title}<select data-facet='{key}'>{all_of_them}</select></label>")
    if orders:
        ways = [
            f'<option value="{sign}{escape(order.key)}">{escape(order.title)}, {way}</option>'
            for order in orders
            for sign, way in (("+", "lowest first"), ("-", "highest first"))
        ]
        bars.append(
            f"<label>order<select class=order><option value=''>as it is</option>{''.join(ways)}</select></label>"
        )
    if any(tile.overlay for tile in tiles):
        bars.append("<label class=switch><input type=checkbox class=overlays checked>labels</label>")
    shown = []
    for tile in tiles:
        kind = "image/png" if tile.picture.startswith(b"\x89PNG") else "image/jpeg"
        first, *others = [escape(line) for line in tile.caption] or [""]
        values = [f'data-{key}="{escape(chr(10).join(_several(value)))}"' for key, value in tile.values.items()]
        values += [f'data-by-{key}="{value:.9g}"' for key, value in tile.numbers.items() if math.isfinite(value)]
        shown.append(
            f"<button class=tile {' '.join(values)}><span class=frame>"
            f'<img loading=lazy src="{data_uri(tile.picture, kind)}" alt="{first}">{tile.overlay}</span>'
            f"<strong>{first}</strong>{''.join(f'<span class=line>{line}</span>' for line in others)}</button>"
        )
    return (
        f"<div class=gallery><div class=filters>{''.join(bars)}<button class=clear>show all</button></div>"
        f"<p role=status class=shown>{len(tiles)} of {len(tiles)} shown</p>\n<div class=tiles>"
        + "\n".join(shown)
        + "</div></div>"
    )


def _several(values: str | Sequence[str] | None) -> Sequence[str]:
    return () if values is None else (values,) if isinstance(values, str) else values


def data_uri(content: bytes, kind: str) -> str:
    """A file as an address that holds it."""
    return f"data:{kind};base64,{base64.b64encode(content).decode('ascii')}"
