"""Self-contained HTML pages from blocks, with embedded pictures and thumbnails that filter.

The HTML is in ``templates/``; Jinja escapes every text that it shows.
"""

from __future__ import annotations

import base64
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from importlib.resources import files
from typing import TypeAlias

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

GENERATOR = "hulldown"


@dataclass(frozen=True, slots=True)
class Words:
    """A paragraph."""

    text: str
    warning: bool = False


@dataclass(frozen=True, slots=True)
class Items:
    """A list of sentences."""

    texts: Sequence[str]


@dataclass(frozen=True, slots=True)
class Table:
    """A table whose first column names the rows.

    Parameters
    ----------
    header, rows
        The cells.
    title
        Title to click for the table; empty: the table is always shown.
    shades
        Darkness from 0 to 1 of each cell but the first of its row.
    choose
        Values of each row by which a click on its name filters the thumbnails.
    """

    header: Sequence[str]
    rows: Sequence[Sequence[str]]
    title: str = ""
    shades: Sequence[Sequence[float]] | None = None
    choose: Sequence[Mapping[str, str]] | None = None


@dataclass(frozen=True, slots=True)
class Chart:
    """A chart with a description; `name` is its file's, if it has one next to the page."""

    svg: bytes
    words: str
    name: str = ""

    @property
    def uri(self) -> Markup:
        """The picture as a data URI."""
        return data_uri(self.svg, "image/svg+xml")


@dataclass(frozen=True, slots=True)
class Charts:
    """Charts side by side, as far as there is room."""

    charts: Sequence[Chart]


@dataclass(frozen=True, slots=True)
class PageLink:
    """A paragraph with a link to a file next to the page."""

    text: str
    to: str


@dataclass(frozen=True, slots=True)
class Overlay:
    """Labels drawn over a picture.

    Parameters
    ----------
    size
        Width and height of the picture in pixels, the unit of the drawing.
    boxes
        xywh, color, class, and whether it's to be ignored, of each label.
    masks
        Corners and color of each polygon.
    lines
        Points and color of each thin line.
    """

    size: tuple[int, int]
    boxes: Sequence[tuple[tuple[float, float, float, float], str, str, bool]]
    masks: Sequence[tuple[Sequence[tuple[float, float]], str]]
    lines: Sequence[tuple[Sequence[tuple[float, float]], str]] = ()


@dataclass(frozen=True, slots=True)
class Tile:
    """A thumbnail.

    Parameters
    ----------
    picture
        JPEG or PNG.
    caption
        Lines below it; the first is emphasized.
    values
        The thumbnail's value, or several, for each facet by key; unknown facets
        are left out.
    numbers
        Sort values by key; unknown ones come last.
    overlay
        Boxes and masks over the picture, which can be hidden.
    """

    picture: bytes
    caption: Sequence[str]
    values: Mapping[str, str | Sequence[str]]
    numbers: Mapping[str, float] = field(default_factory=dict)
    overlay: Overlay | None = None


@dataclass(frozen=True, slots=True)
class Facet:
    """A property by which thumbnails are filtered.

    Parameters
    ----------
    key, title
        Its key in `Tile.values`, and its title for readers.
    values
        Its choices, in order.
    """

    key: str
    title: str
    values: Sequence[str]


@dataclass(frozen=True, slots=True)
class Gallery:
    """Thumbnails that filter by facets; a click on one shows it large.

    Parameters
    ----------
    tiles
        Thumbnails in their initial order.
    facets
        Facets of the filter; those with the same value in all tiles are left out.
    orders
        Other orders: keys of `Tile.numbers`, with titles.
    """

    tiles: Sequence[Tile]
    facets: Sequence[Facet]
    orders: Mapping[str, str] = field(default_factory=dict)

    def choices(self) -> list[tuple[Facet, list[tuple[str, int]]]]:
        """Return the facets with several values, and the number of tiles of each value."""
        facets = []
        for facet in self.facets:
            counts = Counter(value for tile in self.tiles for value in several(tile.values.get(facet.key)))
            known = [(value, counts[value]) for value in facet.values if counts[value]]
            if len(known) > 1 or (known and sum(n for _, n in known) < len(self.tiles)):
                facets.append((facet, known))
        return facets


@dataclass(frozen=True, slots=True)
class PageSection:
    """Blocks below a heading."""

    heading: str
    blocks: Sequence[Block]


Block: TypeAlias = Words | Items | Table | Chart | Charts | PageLink | Gallery


def page(title: str, sections: Sequence[PageSection], *, above: Sequence[Block] = ()) -> str:
    """Return a whole page; `above` is shown before the first section."""
    return _environment().get_template("page.html").render(title=title, above=above, sections=sections)


def several(values: str | Sequence[str] | None) -> Sequence[str]:
    """Return a tile's values of a facet, one or several, as a sequence."""
    return () if values is None else (values,) if isinstance(values, str) else values


def data_uri(content: bytes, kind: str = "") -> Markup:
    """Return a picture as a data URI; `kind` is its media type, PNG or JPEG if empty."""
    kind = kind or ("image/png" if content.startswith(b"\x89PNG") else "image/jpeg")
    return Markup(f"data:{kind};base64,{base64.b64encode(content).decode('ascii')}")


@cache
def _environment() -> Environment:
    environment = Environment(
        loader=PackageLoader(__name__.rpartition(".")[0]),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {"several": several, "uri": data_uri}
    folder = files(__name__.rpartition(".")[0])
    for name in ("page.css", "page.js"):  # ours, so it's safe
        environment.globals[name.replace(".", "_")] = Markup(folder.joinpath(name).read_text(encoding="utf-8"))
    environment.globals["generator"] = GENERATOR
    return environment
