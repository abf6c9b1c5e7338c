"""Lens and sensor of each image."""

from __future__ import annotations

import numpy as np
from jaxtyping import Int

from hulldown.camera.sensor import LIMITS, Sensor
from hulldown.planning.config.sensor_section import SensorSection
from hulldown.planning.row import rounded
from hulldown.planning.search.draws import Purpose, RandomStreams, between


def draw_sensors(section: SensorSection, *, draws: RandomStreams, image: Int[np.ndarray, " n"]) -> list[Sensor | None]:
    """Draw lens and sensor of the images with these indices; None for a config without `[sensor]`."""
    ranges: dict[str, tuple[float, float]] = section.model_dump(exclude={"preset"})
    if section == SensorSection():
        return [None] * len(image)
    u = draws.uniform(Purpose.SENSOR, image, 0, count=len(LIMITS)).T
    table = {key: rounded("sensor", between(*ranges[key], own)) for key, own in zip(LIMITS, u, strict=True)}
    table["jpeg_quality"] = np.rint(table["jpeg_quality"]).astype(np.int64)
    columns = zip(*(values.tolist() for values in table.values()), strict=True)
    return [Sensor(**dict(zip(table, values, strict=True))) for values in columns]
