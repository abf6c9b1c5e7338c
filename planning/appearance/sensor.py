"""Lens and sensor of each image, as a function of the seed and the image alone."""

from __future__ import annotations

import numpy as np
from jaxtyping import Int

from hulldown.camera.sensor import LIMITS, Sensor
from hulldown.planning.config.sensor_section import SensorSection
from hulldown.planning.row import rounded
from hulldown.planning.search.draws import Purpose, RandomStreams, between


def draw_sensors(section: SensorSection, *, draws: RandomStreams, image: Int[np.ndarray, " n"]) -> list[Sensor | None]:
    """Return what lens and sensor do to the images with these indices; None if that is nothing in all images."""
    ranges: dict[str, tuple[float, float]] = section.model_dump(exclude={"preset"})
    if section == SensorSection():
        return [None] * len(image)
    u = draws.uniform(Purpose.SENSOR, image, 0, count=len(LIMITS)).T
    drawn = {key: rounded("sensor", between(*ranges[key], own)) for key, own in zip(LIMITS, u, strict=True)}
    drawn["jpeg_quality"] = np.rint(drawn["jpeg_quality"]).astype(np.int64)
    columns = zip(*(values.tolist() for values in drawn.values()), strict=True)
    return [Sensor(**dict(zip(drawn, values, strict=True))) for values in columns]
