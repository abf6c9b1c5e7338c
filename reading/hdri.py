"""Read HDRIs once with Blender, check them, and repair or refuse them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from hulldown.assets.skylight import SkyLight
from hulldown.base.color import LUMINANCE_WEIGHTS
from hulldown.base.errors import AssetError
from hulldown.base.outside import file_sha256
from hulldown.camera.response import distance_from_daylight
from hulldown.reading.cache import (
    cache_entry_name,
    make_cache_folder,
    read_sealed_note,
    store_sealed_entry,
    temporary_entry_folder,
)
from hulldown.reading.confinement.watch import DEFAULT_LIMITS, ReadLimits
from hulldown.reading.pieces.doubt import Doubt, DoubtKind
from hulldown.reading.pieces.formats import first_bytes
from hulldown.reading.reader_process import Job, read_job_answer, run_reader_jobs

HDRI_MAGIC = (b"\x76\x2f\x31\x01", b"#?")  # OpenEXR, Radiance
MENDED_NAME = "mended.exr"
CHECKS_VERSION = 8  # raised when the checks or repairs of a file change
MAX_RADIANCE = 1e10  # the sun's disc has 1.6e9 cd/m2, and what is brighter is as good as infinite
MAX_INFINITE_SHARE = 1e-3  # of the pixels: suns and their glare
ALLOWED_INFINITE_PIXELS = 4  # even in a small picture
MAX_NEGATIVE_SHARE = 0.25  # of all light: resampling a small sun leaves up to 0.11 in files that are in use
MEAN_RADIANCE_RANGE = (
    1e-4,
    1e5,
)  # of the mean over the sphere: darker is a black picture at any strength, brighter a white one
MAX_TINT_UV = 0.035  # CIE 1976 u'v': a card in the shade of a clear sky's darkest blue is 0.031 off daylight
BACKDROP_REMEDY = '`light.backdrop` other than "hdri" hides it and keeps its light'
PICTURES_PER_PROCESS = 16  # which reads one after the other


@dataclass(frozen=True, slots=True)
class FoundSky:
    """What reading found in an HDRI, as the cache keeps it; its fields are those of `Hdri`."""

    light: SkyLight
    notes: tuple[str, ...]
    mended_sha256: str = ""


@dataclass(frozen=True, slots=True)
class Hdri:
    """A usable HDRI."""

    path: Path  # the rendered file: the original, or its repaired copy in the cache
    sha256: str  # digest of the file's bytes
    light: SkyLight  # its light on open land, and whether it shows open land
    mended_sha256: str = ""  # digest of the repaired pixels; empty if the file is rendered unchanged
    notes: tuple[str, ...] = ()

    @property
    def repair_doubts(self) -> tuple[Doubt, ...]:
        """The notes as doubts."""
        return tuple(Doubt(DoubtKind.REPAIRED, note) for note in self.notes)

    @property
    def misfit_doubts(self) -> tuple[Doubt, ...]:
        """Doubts about whether it fits open land, with a remedy."""
        return tuple(Doubt(DoubtKind.NO_OPEN_LAND, f"{misfit}; {BACKDROP_REMEDY}") for misfit in self.light.misfits)

    @property
    def doubts(self) -> tuple[Doubt, ...]:
        """A doubt about light far from daylight's color."""
        light = np.array(self.light.irradiance)
        if not light.any() or distance_from_daylight(light) <= MAX_TINT_UV:
            return ()
        red, green, blue = (light / light.max()).tolist()
        card = f"a gray card in it is ({red:.2f}, {green:.2f}, {blue:.2f})"
        text = f"its light is tinted: {card}, and so is every image; leave it out unless that's meant"
        return (Doubt(DoubtKind.TINTED, text),)


def mended_radiance_and_repairs(pixels: Float[np.ndarray, "h w 3"]) -> tuple[Float[np.ndarray, "h w 3"], tuple[str, ...]]:
    """Return a sky's usable radiance in linear Rec. 709, and a sentence about each repair."""
    height, width = pixels.shape[:2]
    if width != 2 * height:
        raise AssetError(f"is {width} x {height} pixels, but an HDRI of a whole sky is twice as wide as high")
    if unsaid := int(np.isnan(pixels).any(axis=2).sum()):
        raise AssetError(f"has {unsaid} pixels that are NaN", remedy="paint over them, or leave it out")
    notes = []
    endless = pixels > MAX_RADIANCE
    if suns := int(endless.any(axis=2).sum()):
        if suns > max(ALLOWED_INFINITE_PIXELS, MAX_INFINITE_SHARE * height * width):
            raise AssetError(f"has {suns} of {height * width} pixels without end, above {MAX_RADIANCE:g}")
        largest = float(pixels[~endless].max(initial=0.0))
        pixels = np.where(endless, np.float32(largest), pixels)
        notes.append(f"{suns} pixels without end are as bright as its brightest finite one, {largest:g}")
    light, taken = float(pixels.clip(min=0).sum(dtype=np.float64)), -float(pixels.clip(max=0).sum(dtype=np.float64))
    if taken > 0.0:
        if not taken <= MAX_NEGATIVE_SHARE * light:
            raise AssetError(f"is negative: {-taken:g} in all beside {light:g} of light")
        count, percent = int((pixels < 0).any(axis=2).sum()), 100.0 * taken / light
        notes.append(f"{count} pixels that are negative are black: they took {percent:.1f} % of all light")
        pixels = pixels.clip(min=0)
    if np.ptp(pixels, axis=(0, 1)).max() == 0.0:
        raise AssetError("has one color everywhere, so it isn't a sky")
    mean = mean_sky_luminance(pixels)
    if not MEAN_RADIANCE_RANGE[0] <= mean <= MEAN_RADIANCE_RANGE[1]:
        allowed = f"{MEAN_RADIANCE_RANGE[0]:g} to {MEAN_RADIANCE_RANGE[1]:g}"
        raise AssetError(f"has a mean luminance of {mean:.3g}, expected {allowed}", remedy="scale it, or leave it out")
    return pixels, tuple(notes)


def mean_sky_luminance(pixels: Float[np.ndarray, "h w 3"]) -> float:
    """Return the mean luminance over the sphere of an equirectangular sky in linear Rec. 709."""
    height = len(pixels)
    rows = pixels.mean(axis=1, dtype=np.float64) @ LUMINANCE_WEIGHTS
    weight = np.cos((np.arange(height) + 0.5) / height * np.pi - np.pi / 2)
    return float(rows @ weight / weight.sum())


def read_hdris(
    paths: Sequence[Path], cache: Path, *, limits: ReadLimits = DEFAULT_LIMITS, progress: Callable[[str], None] | None = None
) -> list[Hdri]:
    """Read and check HDRIs, from `cache` if possible."""
    for path in paths:
        require_hdri_file(path)
    make_cache_folder(cache)
    digests = [file_sha256(path) for path in paths]
    named = dict(zip(digests, paths, strict=True))
    todo = [(digest, path) for digest, path in named.items() if _cached_hdri(path, digest, cache) is None]
    for start in range(0, len(todo), PICTURES_PER_PROCESS):
        batch = todo[start : start + PICTURES_PER_PROCESS]
        with temporary_entry_folder(cache) as folder:
            jobs = [Job(str(path), str(Path(folder, digest)), "hdri") for digest, path in batch]
            for job in jobs:
                if progress:
                    progress(job.path)
                Path(job.folder).mkdir()
            run_reader_jobs(jobs, limits=limits)
            for (digest, _), job in zip(batch, jobs, strict=True):
                store_sealed_entry(
                    Path(job.folder), cache / cache_entry_name("hdri", CHECKS_VERSION, digest), read_job_answer(job, FoundSky)
                )
    read = []
    for path, digest in zip(paths, digests, strict=True):
        hdri = _cached_hdri(path, digest, cache)
        assert hdri is not None, f"{path}: what was just read cannot be read back"
        read.append(hdri)
    return read


def require_hdri_file(path: Path) -> None:
    """Refuse a file that doesn't begin like an HDRI."""
    if not first_bytes(path).startswith(HDRI_MAGIC):
        raise AssetError("isn't an OpenEXR or Radiance picture", path=path, remedy="copy it again, or leave it out")


def _cached_hdri(path: Path, digest: str, cache: Path) -> Hdri | None:
    entry = cache / cache_entry_name("hdri", CHECKS_VERSION, digest)
    found = read_sealed_note(entry, FoundSky)
    if found is None:
        return None
    rendered = entry / MENDED_NAME if found.mended_sha256 else path
    return Hdri(rendered, digest, found.light, found.mended_sha256, found.notes)
