"""Bar charts and histograms on a sheet, drawn with Pillow: Matplotlib takes longer to start than a plan to make."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from PIL import Image, ImageDraw

from hulldown.pictures.drawing import lettering

SIZE = (400, 290)  # pixels of a chart
LEFT, TOP, RIGHT, BOTTOM = 70, 36, 16, 28  # margins
COLOR = (72, 120, 168)
INK, PAPER = (20, 20, 20), (255, 255, 255)
COLUMNS = 3
LONGEST = 170  # pixels of a bar's name


@dataclass(frozen=True, slots=True)
class Bars:
    """A bar chart of counts by name."""

    title: str
    counts: Mapping[str, int]

    def draw(self, pen: ImageDraw.ImageDraw) -> None:
        """Draw the chart."""
        font = lettering(12)
        names = {name: _shortened(name, LONGEST) for name in self.counts}
        left = max([LEFT, *(16 + math.ceil(font.getlength(name)) for name in names.values())])
        scale = _Scale(0.0, 1.05 * max([1, *self.counts.values()]), left, SIZE[0] - RIGHT)
        height = (SIZE[1] - TOP - BOTTOM) / max(1, len(self.counts))
        for i, (name, count) in enumerate(self.counts.items()):
            middle = TOP + (i + 0.5) * height
            if count:
                pen.rectangle((left, middle - 0.4 * height, scale.at(count), middle + 0.4 * height), fill=COLOR)
            pen.text((left - 8, middle), names[name], INK, font, anchor="rm")
        _frame(pen, self.title, scale, None)


@dataclass(frozen=True, eq=False, slots=True)
class Stairs:
    """A histogram: counts between b + 1 edges, by the edges' logarithms if `logarithmic`."""

    title: str
    edges: Float[np.ndarray, " b_plus_1"]
    counts: Int[np.ndarray, " b"]
    logarithmic: bool = False

    def draw(self, pen: ImageDraw.ImageDraw) -> None:
        """Draw the chart."""
        first, last = (self.edges[0], self.edges[-1]) if len(self.counts) else (1.0, 10.0)
        across = _Scale(float(first), float(last), LEFT, SIZE[0] - RIGHT, logarithmic=self.logarithmic)
        up = _Scale(0.0, 1.05 * max(1, int(self.counts.max(initial=0))), SIZE[1] - BOTTOM, TOP)
        places = [across.at(edge) for edge in self.edges.tolist()]
        for a, b, count in zip(places[:-1], places[1:], self.counts.tolist(), strict=False):
            pen.rectangle((a, up.at(count), b, SIZE[1] - BOTTOM), fill=COLOR)
        _frame(pen, self.title, across, up)


def sheet(title: str, charts: list[Bars | Stairs]) -> Image.Image:
    """Return a picture of charts, row by row, below a title."""
    width, height = SIZE
    picture = Image.new("RGB", (COLUMNS * width, 40 - (-len(charts) // COLUMNS) * height), PAPER)
    ImageDraw.Draw(picture).text((picture.width / 2, 22), title, INK, lettering(17), anchor="mm")
    for i, chart in enumerate(charts):
        part = Image.new("RGB", SIZE, PAPER)
        chart.draw(ImageDraw.Draw(part))
        picture.paste(part, (i % COLUMNS * width, 40 + i // COLUMNS * height))
    return picture


@dataclass(frozen=True, slots=True)
class _Scale:
    """An axis from `low` to `high`, between two pixels."""

    low: float
    high: float
    first: float
    last: float
    logarithmic: bool = False

    def at(self, value: float) -> float:
        low, high = self.low, self.high
        if self.logarithmic:
            low, high, value = math.log(low), math.log(high), math.log(value)
        return self.first + (self.last - self.first) * (value - low) / (high - low)

    def ticks(self) -> list[float]:
        if self.logarithmic:
            powers = range(math.floor(math.log10(self.low)), math.ceil(math.log10(self.high)) + 1)
            every = [digit * 10.0**power for power in powers for digit in (1, 2, 5)]
        else:
            rough = (self.high - self.low) / 6.0
            power = 10.0 ** math.floor(math.log10(rough))
            step = next(digit * power for digit in (1, 2, 5, 10) if digit * power >= rough)
            every = [
                i * step for i in range(math.ceil(self.low / step - 1e-9), math.floor(self.high / step + 1e-9) + 1)
            ]
        return [tick for tick in every if self.low - 1e-9 <= tick <= self.high * (1 + 1e-9) + 1e-9]


def _frame(pen: ImageDraw.ImageDraw, title: str, across: _Scale, up: _Scale | None) -> None:
    (width, height), font = SIZE, lettering(12)
    bottom = height - BOTTOM
    pen.rectangle((across.first, TOP, across.last, bottom), outline=INK)
    pen.text(
        ((across.first + across.last) / 2, TOP - 14), _shortened(title, width - 20), INK, lettering(13), anchor="mm"
    )
    for tick in across.ticks():
        pen.line((across.at(tick), bottom, across.at(tick), bottom + 4), fill=INK)
        pen.text((across.at(tick), bottom + 14), f"{tick:.4g}", INK, font, anchor="mm")
    if up is None:
        return
    for tick in up.ticks():
        pen.line((across.first - 4, up.at(tick), across.first, up.at(tick)), fill=INK)
        pen.text((across.first - 8, up.at(tick)), f"{tick:.4g}", INK, font, anchor="rm")


def _shortened(text: str, pixels: float) -> str:
    """Return a text of at most so many pixels."""
    font = lettering(12)
    kept = text
    while len(kept) > 1 and font.getlength(kept) > pixels:
        kept = kept[:-2] + "…"
    return kept
