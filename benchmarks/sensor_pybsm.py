"""`python -m hulldown.benchmarks.sensor_pybsm`: blur and noise of the sensor against pyBSM's, an independent model.

Needs pyBSM, which isn't among the extras (`pip install pybsm`).
"""

from __future__ import annotations

import math
from importlib.metadata import version

import numpy as np
from pybsm.otf.functional import jitter_OTF
from pybsm.simulation.image_simulator import _apply_noise2d

from hulldown.camera.sensor import Sensor
from hulldown.render.sensor import BAND, WHITE, Lens, read_out

WELL, READ, GAIN = 20_000.0, 3.0, 4.0


def transfer_error(sigma: float, highest: float) -> float:
    """The largest difference of the MTF, up to a frequency in cycles per pixel, from that of pyBSM's `jitter_OTF`."""
    n = 2 * BAND
    impulse = np.zeros((n, n, 3), dtype=np.float32)
    impulse[n // 2, n // 2] = 1.0
    lens = Lens.of(Sensor(blur_px=sigma), n, n, (n / 2, n / 2))
    drawn = np.concatenate([lens.through(impulse, slice(top, top + BAND)) for top in range(0, n, BAND)])[..., 1]
    u, v = np.meshgrid(np.fft.fftfreq(n), np.fft.fftfreq(n))
    ours = np.abs(np.fft.fft2(drawn.astype(np.float64)))
    inside = np.maximum(np.abs(u), np.abs(v)) <= highest
    return float(np.abs(ours - jitter_OTF(u, v, sigma, sigma))[inside].max())


def noise_ratio(electrons: float) -> float:
    """Standard deviation of a read-out level over that of pyBSM's image simulator, both at a mean of electrons."""
    shape, sensor = (1000, 1000), Sensor(full_well_e=WELL, read_noise_e=READ, gain=GAIN)
    per_light = WELL / (GAIN * WHITE)
    light = np.full((*shape, 1), electrons / per_light, dtype=np.float32)
    ours = read_out(light, sensor, np.random.default_rng(0)).astype(np.float64) * per_light
    theirs = _apply_noise2d(np.full(shape, electrons), READ, np.arange(shape[0], dtype=np.uint64))
    return float(ours.std() / theirs.std())


def main() -> None:
    """Print both comparisons."""
    print("pybsm", version("pybsm"))
    for sigma in (0.2, 0.4, 0.6, 0.8, 1.0, 2.4):
        errors = [f"{transfer_error(sigma, highest):.4f} up to {highest:g}" for highest in (0.25, 0.4, 0.45, 0.5)]
        print(f"blur_px {sigma}: MTF differs by at most", ", ".join(errors))
    for electrons in (1.0, 10.0, 30.0, 100.0, 1000.0, 4000.0):
        print(f"{electrons:g} electrons: noise {noise_ratio(electrons):.4f} of pyBSM's")
    print(f"standard error of a ratio: {1.0 / math.sqrt(1e6):.4f}")


if __name__ == "__main__":
    main()
