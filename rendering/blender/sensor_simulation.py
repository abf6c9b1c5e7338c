"""Simulate a camera from scene-linear light to 8 bits: lens, noise, view transform, sharpening.

Runs in Blender too, so it needs numpy only. The caller passes the view transform.

References
----------
J. Janesick, Photon Transfer, SPIE 2007: shot and read noise.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from hulldown.camera.sensor import Sensor

WHITE = 0.18 * 2.0**6.5  # linear light at which a sensor clips, AgX's own white: 6.5 stops above middle gray
BAND = 64  # rows computed at a time, which fit a processor's cache and share a random stream
_TAPER = 4.0  # pixels over which an interpolation kernel falls to 0
_FREQUENCIES, _STEPS = 128, 256  # terms of the kernel's sum, and entries per pixel of its table

Pixels = np.ndarray


def develop(
    radiance: Pixels,
    sensor: Sensor,
    *,
    axis: tuple[float, float],
    exposure_ev: float,
    seed: int,
    view: Callable[[Pixels], Pixels],
    threads: int,
) -> np.ndarray:
    """Return a camera's picture of light.

    `axis`: the lens's axis in the picture, in pixels.
    `view`: view transform from exposed linear light to levels from 0 to 1, white balance included.
    """
    height, width = radiance.shape[:2]
    lens, shown = Lens.of(sensor, width, height, axis), np.empty_like(radiance)
    picture = np.empty(radiance.shape, dtype=np.uint8)
    bands = [slice(top, min(top + BAND, height)) for top in range(0, height, BAND)]

    def expose(band: slice) -> None:
        exposed = lens.through(radiance, band)
        exposed *= np.float32(2.0**exposure_ev)
        shown[band] = view(read_out(exposed, sensor, np.random.default_rng([seed, band.start])))

    def finish(band: slice) -> None:
        levels = sharpened(shown, band, sensor.sharpening) * np.float32(255.0)
        levels += np.float32(0.5)
        picture[band] = np.clip(levels, 0.0, 255.0, out=levels)

    with ThreadPoolExecutor(threads) as pool:
        for step in (expose, finish):
            list(pool.map(step, bands))
    return picture


def read_out(light: Pixels, sensor: Sensor, rng: np.random.Generator) -> Pixels:
    """Return exposed light as a sensor measures it: with shot and read noise, clipped.

    Shot noise is normal with the variance of the Poisson distribution, a good approximation from 10 electrons on;
    below, read noise dominates.
    """
    if not sensor.full_well_e:
        return light
    electrons = light * np.float32(sensor.full_well_e / (sensor.gain * WHITE))
    noise = rng.standard_normal(light.shape, dtype=np.float32)
    noise *= np.sqrt(np.maximum(electrons, 0.0) + np.float32(sensor.read_noise_e**2))
    electrons += noise
    np.clip(electrons, 0.0, sensor.full_well_e / sensor.gain, out=electrons)
    electrons *= np.float32(sensor.gain * WHITE / sensor.full_well_e)
    return electrons


def sharpened(shown: Pixels, band: slice, amount: float) -> np.ndarray:
    """Return a band of a picture with its difference from a blurred copy added: an unsharp mask of 3 x 3 pixels."""
    here = shown[band]
    if not amount:
        return here
    rows = np.clip(np.arange(band.start - 1, band.stop + 1), 0, len(shown) - 1)
    near = np.pad(shown[rows], ((0, 0), (1, 1), (0, 0)), mode="edge")
    blurred = near[:-2] + 2.0 * near[1:-1] + near[2:]
    blurred = blurred[:, :-2] + 2.0 * blurred[:, 1:-1] + blurred[:, 2:]
    return here + np.float32(amount) * (here - blurred / 16.0)


@dataclass(frozen=True, eq=False, slots=True)
class Lens:
    """A lens: a separable kernel per color channel, and vignetting."""

    sensor: Sensor
    # rows, columns: for red, green, and blue, blocks of weights along an axis: outputs, inputs, weights. Empty for a
    # sharp lens.
    rows: list[list[AxisWeights]]
    columns: list[list[AxisWeights]]
    y: np.ndarray  # y, x: pixels from the axis
    x: np.ndarray

    @classmethod
    def of(cls, sensor: Sensor, width: int, height: int, axis: tuple[float, float]) -> Lens:
        """Return the lens of a camera, whose axis meets a picture at (x, y)."""
        corner = math.hypot(width, height) / 2.0
        scales = [1.0 + sensor.aberration_px / corner, 1.0, 1.0 - sensor.aberration_px / corner]
        rows: list[list[AxisWeights]] = []
        columns: list[list[AxisWeights]] = []
        if sensor.blur_px or sensor.aberration_px:
            spread = _point_spread(sensor.blur_px)
            rows = [_blocks(height, axis[1], scale, spread) for scale in scales]
            columns = [_blocks(width, axis[0], scale, spread) for scale in scales]
        x, y = (
            (np.arange(n) + 0.5 - middle).astype(np.float32) for n, middle in zip((width, height), axis, strict=True)
        )
        return cls(sensor, rows, columns, y, x)

    def through(self, radiance: Pixels, band: slice) -> np.ndarray:
        """Return a band of rows behind the lens: blurred, with color aberration and cos^4 vignetting."""
        light = self.sensor.falloff(self.x, self.y[band, None], math.hypot(len(self.x), len(self.y)) / 2.0)
        if not self.rows:
            return radiance[band] * light[..., None]
        band_light = np.empty((band.stop - band.start, *radiance.shape[1:]), dtype=np.float32)
        for channel, (rows, columns) in enumerate(zip(self.rows, self.columns, strict=True)):
            block = rows[band.start // BAND]
            upright = block.weights @ np.ascontiguousarray(radiance[block.inputs, :, channel])
            for block in columns:
                np.multiply(
                    upright[:, block.inputs] @ block.weights.T, light[:, block.outputs],
                    out=band_light[:, block.outputs, channel],
                )  # fmt: skip
        return band_light


@dataclass(frozen=True, eq=False, slots=True)
class AxisWeights:
    """Weights (o, i) from input to output pixels along an axis."""

    outputs: slice
    inputs: slice
    weights: np.ndarray


def _point_spread(sigma: float) -> np.ndarray:
    """Return a Gaussian of a deviation in pixels, band-limited to pixels: weights at each 1/`_STEPS` pixel from 0 on.

    A narrow Gaussian, simply sampled, would blur too little. Without blur it interpolates.
    """
    flat = 3.0 * sigma
    x = np.arange(math.ceil(flat + _TAPER) * _STEPS + 1) / _STEPS
    frequency = (np.arange(_FREQUENCIES) + 0.5) / (2.0 * _FREQUENCIES)
    table = np.cos(2.0 * np.pi * np.outer(x, frequency)) @ np.exp(-2.0 * (np.pi * sigma * frequency) ** 2)
    taper = np.cos(np.pi / 2.0 * np.clip((x - flat) / _TAPER, 0.0, 1.0)) ** 2
    return table * taper / _FREQUENCIES


def _blocks(n: int, middle: float, scale: float, spread: np.ndarray) -> list[AxisWeights]:
    """Weights that magnify n pixels about a point; the end pixels are repeated beyond the ends."""
    blocks = []
    reach, x = len(spread) // _STEPS, np.arange(len(spread)) / _STEPS
    for start in range(0, n, BAND):
        outputs = np.arange(start, min(start + BAND, n))
        place = (outputs + 0.5 - middle) / scale + middle - 0.5
        taps = np.floor(place).astype(np.int64)[:, None] + np.arange(1 - reach, reach + 1)
        weights = np.interp(np.abs(place[:, None] - taps), x, spread)
        taps = np.clip(taps, 0, n - 1)
        low, high = int(taps.min()), int(taps.max()) + 1
        dense = np.zeros((len(outputs), high - low))
        np.add.at(dense, (np.arange(len(outputs))[:, None], taps - low), weights)
        dense /= dense.sum(axis=1, keepdims=True)
        blocks.append(AxisWeights(slice(start, start + len(outputs)), slice(low, high), dense.astype(np.float32)))
    return blocks
