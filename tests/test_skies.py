"""Pictures with another sky than in their records are found."""

import math

import numpy as np
import pytest

from hulldown.camera.intrinsics import Intrinsics
from hulldown.camera.projection import Camera
from hulldown.camera.response import displayed
from hulldown.camera.sensor import Sensor
from hulldown.camera.weather.kinds import Weather
from hulldown.dataset.images import Image
from hulldown.dataset.records import sound_images
from hulldown.dataset.store.reservations import Reservation
from hulldown.dataset.verification.check_skies import SkyCheck, deviation, radiance
from hulldown.scene.posed_scene import Plane, Scene

RUN = Reservation("a" * 64, 0, 0, "", 9, 9)
POSE = [[0.0, 0.0, 1.0, 0.0], [-1.0, 0.0, 0.0, 0.0], [0.0, -1.0, 0.0, 2.0], [0.0, 0.0, 0.0, 1.0]]  # looks along +x
IMAGE = {
    **{"id": 1, "file_name": "images/1.png", "width": 160, "height": 90, "scenery": "plain", "fov_x_deg": 60.0},
    **{"hdri": "east", "hdri_yaw_deg": 40.0, "strength": 1.2, "weather": None, "world_from_camera": POSE},
    **{"horizon_deg": None, "exposure_ev": 0.0, "white_balance_k": 0.0},
}


def sky(red, blue, bright_at):
    """A map that is red below, blue above, and bright around one azimuth in degrees."""
    rows, columns = np.mgrid[0:64, 0:128]
    azimuth = np.pi - (columns + 0.5) / 128 * 2 * np.pi
    glow = 0.2 + 2.0 * np.exp(3.0 * (np.cos(azimuth - math.radians(bright_at)) - 1.0))
    share = (rows + 0.5)[..., None] / 64
    return glow[..., None] * (share * np.array([red, 0.3, 0.2]) + (1 - share) * np.array([0.2, 0.4, blue]))


SKIES = {"east": sky(0.9, 0.6, 0.0), "west": sky(0.5, 0.9, 180.0)}
CHECK = SkyCheck({"plain": Scene(ground=Plane(0.0))}, SKIES, RUN)


def picture(image):
    """A camera's picture over an endless plain."""
    camera = Camera(
        Intrinsics(image["width"], image["height"], math.radians(image["fov_x_deg"])),
        np.array(image["world_from_camera"]),
    )
    x, y = np.meshgrid(np.arange(image["width"]) + 0.5, np.arange(image["height"]) + 0.5)
    along = camera.ray_directions(np.stack([x.ravel(), y.ravel()], axis=1)).reshape(*x.shape, 3)
    weather = Weather(**image["weather"]) if image["weather"] else None
    yaw = math.radians(image["hdri_yaw_deg"])
    light = Sensor(**image.get("sensor", {})).falloff(x - 80.0, y - 45.0, math.hypot(80.0, 45.0))[..., None]
    seen = displayed(
        light * radiance(SKIES[image["hdri"]], along, yaw=yaw, strength=image["strength"], weather=weather)
    )
    return np.where(along[..., 2:] < 0.0, 70.0, seen).round().astype(np.uint8)


DARK_CORNERS = {"sensor": {"vignetting_ev": 1.5}}


@pytest.mark.parametrize("more", [{}, {"weather": {"visibility_m": 900.0, "kind": "fog"}}, DARK_CORNERS])
def test_the_recorded_sky_gives_no_finding(more):
    image = {**IMAGE, **more}
    noise = np.random.default_rng(0).normal(0.0, 25.0, (90, 160, 1))
    assert list(CHECK(Image.of(image, []), (picture(image) + noise).clip(0, 255).astype(np.uint8))) == []


@pytest.mark.parametrize(
    "change",
    [
        {"hdri": "west"},
        {"hdri_yaw_deg": 130.0},
        {"strength": 0.6},
        {"weather": {"visibility_m": 200.0, "kind": "fog"}},
        DARK_CORNERS,
    ],
)
def test_another_sky_turn_strength_or_fog_is_found(change):
    (found,) = CHECK(Image.of(IMAGE, []), picture({**IMAGE, **change}))
    assert (found.severity, found.where) == ("error", "images/1.png")
    assert "its sky is " in found.problem
    assert found.figure > 3.0


@pytest.mark.parametrize(
    "change",
    [
        *({"id": 10}, {"hdri": "unknown"}, {"scenery": "other"}, {"hdri": []}, {"weather": 3}, {"horizon_deg": "x"}),
        *(
            {"weather": {"visibility_m": visibility, "kind": kind}}
            for visibility, kind in ((900.0, "hail"), (0, "fog"))
        ),
        {"world_from_camera": None},
        {"world_from_camera": [[1, 0, 0, 0], [0, -1, 0, 0], [0, 0, -1, 2], [0, 0, 0, 1]]},  # straight down
    ],
)
def test_pictures_without_a_planned_or_visible_sky_are_skipped(change):
    black = np.zeros((90, 160, 3), np.uint8)
    assert list(CHECK(Image.of(IMAGE, []), black))
    assert list(CHECK(Image.of({**IMAGE, **change}, []), black)) == []


def test_a_vehicle_in_front_of_the_sky_is_excluded():
    hidden = picture(IMAGE)
    hidden[:60, 20:140] = 0
    assert list(CHECK(Image.of(IMAGE, []), hidden))
    damaged = [{}, *({"bbox": wrong} for wrong in (None, "x", [1, 2, 3], [1e308] * 4))]
    boxes = [*damaged, {"bbox": [20.0, 0.0, 120.0, 60.0]}, {"bbox": [0, 0, 9, 9], "image_id": []}]
    labels = [{"id": k, "image_id": 1, "category_id": 1, **box} for k, box in enumerate(boxes)]
    sound = sound_images({"categories": [], "images": [IMAGE], "annotations": labels})
    assert list(CHECK(sound[1], hidden)) == []


def test_deviation_is_the_smoothed_difference():
    where = np.ones((20, 30), bool)
    noise = np.tile([[-9.0, 9.0], [9.0, -9.0]], (10, 15))[..., None]
    assert deviation(np.full((20, 30, 3), 104.0) + noise, np.full((20, 30, 3), 100.0), where) == pytest.approx(
        4, abs=0.5
    )


@pytest.mark.parametrize(
    ("horizon_deg", "rows"),
    [(None, [42, 31, 24, 14, 0]), (5.0, [30, 30, 24, 14, 0]), (20.0, [22.5, 22.5, None, 14, 0])],
)
def test_rows_of_the_map_are_elevations_and_a_horizon_covers_those_below(horizon_deg, rows):
    elevation = np.radians([-30.0, 2.0, 22.0, 50.0, 88.0])
    along = np.stack([np.cos(elevation), 0.0 * elevation, np.sin(elevation)], axis=1)
    numbered = np.broadcast_to(np.arange(64.0)[:, None, None], (64, 128, 3))
    if None in rows:  # a high horizon fades out, linearly in the sine, from 20 to 30 degrees: rows 24 to 21
        begin, end = np.sin(np.radians([20.0, 30.0]))
        rows = [24.0 - 1.5 * (end - math.sin(elevation[2])) / (end - begin) if row is None else row for row in rows]
    found = radiance(numbered, along, yaw=0.4, strength=2.0, horizon_deg=horizon_deg)
    np.testing.assert_allclose(found, 2.0 * np.repeat(np.array(rows)[:, None], 3, axis=1), rtol=1e-12)


@pytest.mark.parametrize("kind", ["fog", "rain", "snow"])
def test_snow_and_dust_keep_an_even_sky(kind):
    along = np.array([[1.0, 0.0, 0.0], [0.6, 0.0, 0.8], [0.0, 0.0, 1.0]])
    found = radiance(np.full((64, 128, 3), 0.5), along, yaw=0.0, strength=3.0, weather=Weather(150.0, kind))
    np.testing.assert_allclose(found, 1.5, rtol=1e-6)
