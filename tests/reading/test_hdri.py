"""Checks of HDRIs: repaired where that is sound, refused otherwise, and reported where they show no open land."""

import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from hulldown.base.errors import AssetError
from hulldown.reading.hdri import MAX_RADIANCE, mean_sky_luminance, mended_radiance_and_repairs, read_hdris
from hulldown.reading.pieces.doubt import DoubtKind
from hulldown.reading.surroundings import backdrop_elevation_and_misfits, shrink_sky_map

SCRIPT = "hdri_files.py"


def sky(height: int = 32) -> np.ndarray:
    return np.random.default_rng(0).uniform(0.2, 0.8, (height, 2 * height, 3)).astype(np.float32)


def with_pixels(value: float, count: int = 1) -> np.ndarray:
    pixels = sky()
    pixels.reshape(-1, 3)[:count] = value
    return pixels


@pytest.mark.parametrize("value", [np.inf, 2 * MAX_RADIANCE])
@pytest.mark.parametrize("count", [0, 1, 4])
def test_infinite_suns_get_the_brightness_of_the_brightest_finite_one(value: float, count: int) -> None:
    pixels = with_pixels(value, count)
    pixels[9, 9] = 1234.0
    mended, notes = mended_radiance_and_repairs(pixels)
    assert notes == ((f"{count} pixels without end are as bright as its brightest finite one, 1234",) if count else ())
    assert (mended.reshape(-1, 3)[:count] == 1234.0).all()
    assert np.array_equal(mended.reshape(-1, 3)[count:], pixels.reshape(-1, 3)[count:])


def test_a_sky_with_ringing_around_its_sun_is_repaired() -> None:
    # Lanczos windows of three lobes. Of 18 skies in a software package, 14 ring by more than 0.1 % of their light.
    at = np.arange(-3, 4)[:, None] - np.array([0.5, 0.3])
    rows, columns = (np.sinc(at) * np.sinc(at / 3.0) * (abs(at) < 3.0)).T
    pixels = sky()
    pixels[9:16, 20:27] += 600.0 * np.outer(rows, columns)[..., None].astype(np.float32)
    share = -100.0 * pixels.clip(max=0).sum() / pixels.clip(min=0).sum()
    assert share > 8.0
    mended, (note,) = mended_radiance_and_repairs(pixels)
    assert note.endswith(f"they took {share:.1f} % of all light")
    assert np.array_equal(mended, pixels.clip(min=0))


@pytest.mark.parametrize(
    ("pixels", "problem"),
    [
        (with_pixels(np.nan), "has 1 pixels that are NaN"),
        (with_pixels(np.inf, 100), "has 100 of 2048 pixels without end"),
        (np.full((8, 16, 3), 3e38, np.float32), "has 128 of 128 pixels without end"),
        (with_pixels(-np.inf), "is negative"),
        (with_pixels(-5.0, 60), "is negative"),
        (np.full((8, 16, 3), 0.5, np.float32), "has one color everywhere"),
        (sky() * 1e-5, "has a mean luminance of 4.95e-06, expected 0.0001 to 100000"),
        (sky() * 1e6, "has a mean luminance"),
        (sky()[:, :63], "is 63 x 32 pixels"),
    ],
)
def test_a_picture_that_is_not_a_sky_is_refused(pixels: np.ndarray, problem: str) -> None:
    with pytest.raises(AssetError, match=problem):
        mended_radiance_and_repairs(pixels)


def test_mean_luminance_weighs_pixels_by_solid_angle() -> None:
    cap = np.zeros((512, 1024, 3), np.float32)
    cap[:128] = (0.0, 1.0, 0.0)  # 45 degrees around a pole
    assert mean_sky_luminance(cap) == pytest.approx(0.7152 * (1 - np.cos(np.pi / 4)) / 2, rel=1e-4)


def open_sky() -> np.ndarray:
    """An even blue sky, brighter at the horizon, over dark earth; the zenith in the first row."""
    elevation = np.radians(90.0 - (np.arange(128) + 0.5) / 128 * 180.0)[:, None, None]
    sky = (0.6 + 0.6 * np.exp(-4.0 * np.maximum(elevation, 0.0))) * np.array([0.4, 0.6, 1.0])
    return np.where(elevation > 0.0, sky, [0.12, 0.1, 0.08]) * np.ones((128, 256, 1))


def standing(degrees: float, columns: Sequence[int], level: float = 0.1) -> np.ndarray:
    """The same sky with something dark in front."""
    sky = open_sky()
    elevation = 90.0 - (np.arange(128) + 0.5) / 128 * 180.0
    sky[np.ix_((elevation > 0.0) & (elevation < degrees), columns)] *= level
    return sky


def test_an_open_sky_fits_and_ends_at_the_horizon() -> None:
    assert backdrop_elevation_and_misfits(open_sky()) == (0.703, ())


@pytest.mark.parametrize(
    ("degrees", "columns", "open_land"),
    [
        pytest.param(8.0, range(256), True, id="low wood"),
        pytest.param(30.0, range(40), False, id="facades"),
        pytest.param(40.0, [7, 8], True, id="lamp post"),
    ],
)
def test_surroundings_are_measured_and_reported_if_wide_and_high(
    degrees: float, columns: Sequence[int], open_land: bool
) -> None:
    horizon_deg, misfits = backdrop_elevation_and_misfits(standing(degrees, columns))
    assert horizon_deg == pytest.approx(degrees, abs=1.5)
    assert ["above its horizon" in misfit for misfit in misfits] == [True] * (not open_land)


def test_a_ceiling_and_a_roof_are_reported() -> None:
    warm = open_sky()[..., ::-1]
    assert backdrop_elevation_and_misfits(warm)[1] == ("overhead, it is as warm as a ceiling",)
    beams = open_sky()
    beams[:, ::4] *= 0.6
    assert any("has edges" in misfit for misfit in backdrop_elevation_and_misfits(beams)[1])


def test_brightness_and_yaw_of_a_sky_do_not_matter() -> None:
    sky = standing(20.0, range(40))
    assert (
        backdrop_elevation_and_misfits(sky * 2.0**-12)
        == backdrop_elevation_and_misfits(sky)
        == backdrop_elevation_and_misfits(np.roll(sky, 77, axis=1))
    )


def test_a_sky_of_few_rows_is_not_judged() -> None:
    assert backdrop_elevation_and_misfits(shrink_sky_map(np.ones((4, 8, 3)))) == (22.5, ())


def test_a_downsampled_map_has_means_with_the_zenith_first() -> None:
    pixels = np.zeros((256, 512, 3))
    pixels[255, 0] = 4.0
    assert shrink_sky_map(pixels)[0, 0].tolist() == [1.0, 1.0, 1.0]


@pytest.mark.blender
def test_every_compression_of_blender_and_radiance_is_read(written: Path, tmp_path: Path) -> None:
    paths = sorted(written.glob("sky*"))
    assert len(paths) > 15
    lines: list[str] = []
    read = read_hdris(paths, tmp_path / "cache", progress=lines.append)
    assert [hdri.path for hdri in read] == paths
    assert all(hdri.notes == () for hdri in read)
    assert lines == [str(path) for path in paths]
    assert read_hdris(paths, tmp_path / "cache", progress=lines.append) == read
    assert len(lines) == len(paths), "read once"


@pytest.mark.blender
def test_a_sky_is_read_in_the_color_space_of_its_file(written: Path, tmp_path: Path) -> None:
    one, two = read_hdris([written / "rec709.exr", written / "acescg.exr"], tmp_path)
    assert one.sha256 != two.sha256
    assert two.light.irradiance == pytest.approx(one.light.irradiance, rel=1e-4)


@pytest.mark.blender
def test_a_repaired_sky_is_rendered_and_has_its_own_hash(written: Path, tmp_path: Path) -> None:
    sun, again = (read_hdris([written / "sun.exr"], tmp_path / "cache")[0] for _ in range(2))
    assert sun == again
    assert sun.notes == ("2 pixels without end are as bright as its brightest finite one, 5000",)
    assert [doubt.kind for doubt in sun.repair_doubts] == [DoubtKind.REPAIRED]
    assert sun.path != written / "sun.exr"
    assert sun.sha256 != sun.mended_sha256
    sound = read_hdris([sun.path], tmp_path / "cache")[0]
    assert (sound.path, sound.notes) == (sun.path, ())
    assert sound.light.irradiance == pytest.approx(sun.light.irradiance, rel=2e-3)  # half floats
    elsewhere = read_hdris([written / "sun.exr"], tmp_path / "another")[0]
    assert elsewhere.mended_sha256 == sun.mended_sha256, "the same bytes wherever it is repaired"
    sun.path.write_bytes(b"\x76\x2f\x31\x01")
    assert read_hdris([written / "sun.exr"], tmp_path / "cache")[0] == sun, "repaired again if the copy is damaged"


@pytest.mark.blender
@pytest.mark.parametrize(
    ("name", "problem"),
    [
        ("nan", "has 2 pixels that are NaN"),
        ("half", "(crashed reading it|cannot read this picture|not a number|the same everywhere)"),
        ("start", "(crashed reading it|cannot read this picture)"),
        ("zero", "is a device, not a file"),
    ],
)
def test_an_unusable_sky_is_a_one_line_error(written: Path, tmp_path: Path, name: str, problem: str) -> None:
    whole = (written / "sky.exr").read_bytes()
    (tmp_path / "half.exr").write_bytes(whole[: len(whole) // 2])
    (tmp_path / "start.exr").write_bytes(whole[:100])
    (tmp_path / "zero.exr").symlink_to("/dev/zero")
    path = next(p for p in (tmp_path / f"{name}.exr", written / f"{name}.exr") if os.path.lexists(p))
    with pytest.raises(AssetError, match=rf"{name}\.exr: .*{problem}") as caught:
        read_hdris([written / "sky.exr", path], tmp_path / "cache")
    assert "\n" not in str(caught.value)
    assert not list((tmp_path / "cache").glob(".new-*"))
