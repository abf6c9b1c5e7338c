"""Self-contained pages from templates, with embedded charts and thumbnails that filter.

A page's template extends ``page.html`` and imports its parts from there; Jinja escapes every text that it shows.
"""

from __future__ import annotations

import base64
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined
from matplotlib.figure import Figure

from hulldown.dataset.reports.charts import chart_svg

PAGE_TEMPLATE = "dataset/reports/page.html"


@dataclass(frozen=True, slots=True)
class Tile:
    """A thumbnail with its caption and its values by facet."""

    picture: bytes
    caption: Sequence[str]  # lines below it; the first is emphasized
    values: Mapping[str, list[str]]  # the thumbnail's values by facet; all thumbnails have the same facets


def render_page(template: str, data: Mapping[str, object]) -> str:
    """Render a page from a template."""
    return _page_environment().get_template(template).render(data, layout=PAGE_TEMPLATE)


def format_number(value: float | int | None, *, sign: str = "", digits: int = 3) -> str:
    """Format a count, or a figure with some decimals; `sign` is ``"+"`` for differences."""
    if value is None or np.isnan(value):
        return "–"
    return f"{value:,}" if isinstance(value, int) else f"{value:{sign},.{digits}f}"


def format_interval(value: float | int | None, ends: Sequence[float | None] | None, *, sign: str = "") -> str:
    """Format a figure with its interval, if it has one; `sign` is ``"+"`` for differences."""
    if ends is None or value is None:
        return format_number(value, sign=sign)
    if None in ends:
        return f"{format_number(value, sign=sign)} (too few positions to tell)"
    low, high = (format_number(end, sign=sign) for end in ends)
    return f"{format_number(value, sign=sign)} ({low} to {high})"


def facet_counts(tiles: Sequence[Tile]) -> dict[str, dict[str, int]]:
    """Return the number of tiles with each value, for facets in which tiles differ."""
    counts = {key: Counter(value for tile in tiles for value in tile.values[key]) for key in tiles[0].values}
    return {key: dict(sorted(of.items())) for key, of in counts.items() if set(of.values()) - {len(tiles)}}


def data_uri(picture: bytes | Figure) -> str:
    """Return a JPEG, a PNG, or a chart as a data URI."""
    if isinstance(picture, Figure):
        kind, content = "svg+xml", chart_svg(picture)
    else:
        kind, content = "png" if picture.startswith(b"\x89PNG") else "jpeg", picture
    return f"data:image/{kind};base64,{base64.b64encode(content).decode('ascii')}"


@cache
def _page_environment() -> Environment:
    environment = Environment(
        loader=PackageLoader("hulldown", ""), autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    environment.filters |= {"number": format_number, "ranged": format_interval, "facet_counts": facet_counts, "uri": data_uri}
    return environment
