"""What follows from a plan's rows, to be held against the limits (`planning.limits`) and what rows say."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from planning.air import KINDS
from planning.exposure import Exposures, exposures
from planning.guests import framed_on, guests_at
from planning.labels import labels_of, pixels_shown
from planning.light import Lights, draw_lights
from planning.paint import COMPANIONS, DISTRACTORS, draw_coats
from planning.recomputed_poses import RecomputedPoses
from planning.rejections import AIMING, PLACING
from planning.row import Label, Row, rounded
from planning.search_limits import DEGREES

EV, KELVIN = 2e-4, 2e-3  # twice what rows are rounded to


class Recomputed(RecomputedPoses):
    """The same with what is drawn, what is labelled, and what the plan as a whole has."""

    # What stands there.

    @property
    def vehicle_count(self) -> Int[np.ndarray, " n"]:
        """The target and its companions; backgrounds, which are to have none, count as the fewest allowed."""
        first, fewest = self.rows[0], self.config.placement.vehicles_per_image[0]
        beside = len(first.companions)
        if first.background and not beside:
            return np.full(len(self.rows), fewest)
        # What found no room makes up for what is too few.
        return np.array([max(1 + beside, min(1 + beside + row.left_out, fewest)) for row in self.rows])

    @property
    def distractors_as_drawn(self) -> Bool[np.ndarray, " n"]:
        """Whether the distractors are those that are drawn for the position."""
        background = self.rows[0].background
        _, distractors = guests_at(self.site.name, self.source.stage, self.config, background=background)
        models, _ = distractors.drawn(self.source.draws, np.array([row.position for row in self.rows]))
        names = np.array([*(model.shape.name for model in distractors.models), ""])
        wanted = [[name for name in row if name] for row in names[models].tolist()]
        found = [[distractor.vehicle for distractor in row.distractors] for row in self.rows]
        # Of those that are drawn some may have found no room; the others are in their order.
        lacking = [row.left_out for row in self.rows]
        return np.array(
            [
                a == b or (len(b) - len(a) <= n and _is_part(a, b))
                for a, b, n in zip(found, wanted, lacking, strict=True)
            ]
        )

    @property
    def painted_as_drawn(self) -> Bool[np.ndarray, " n"]:
        """Whether the vehicle has the colours that are drawn for the position and its place in the row."""
        companions = len(self.rows[0].companions)
        place = {
            "target": 0,
            "companion": COMPANIONS + self.k - 1,
            "distractor": DISTRACTORS + self.k - 1 - companions,
        }[self.kind]
        position = np.array([row.position for row in self.rows])
        paint = self.config.paint_of(self.placed.model.shape.name)
        drawn = draw_coats(paint, self.source.draws, position=position, place=place)
        said = [row.planned[self.k].paint for row in self.rows]
        return np.array([one == other for one, other in zip(said, drawn, strict=True)])

    @property
    def label_follows(self) -> Bool[np.ndarray, " n"]:
        """Whether the label is the one of the boxes, shares and pixels."""
        said = [row.planned[self.k].label for row in self.rows]
        wanted: list[Label]
        if not self.k:
            wanted = ["none" if row.background else "full" for row in self.rows]
        elif self.placed.model.category is None:
            wanted = ["none"] * len(said)
        else:
            wanted = labels_of(
                self.config,
                bbox=self.boxes.xywh,
                visible=self.visible_fraction,
                truncated=self.boxes.truncated_fraction,
                contrast=self.air_contrast,
                pixels=self.pixels_shown,
            )
        return np.array([label == follows for label, follows in zip(said, wanted, strict=True)])

    @property
    def pixels_shown(self) -> Bool[np.ndarray, " n"]:
        """Whether the vehicle is at the centre of any pixel."""
        return pixels_shown(
            self.site,
            self.placed,
            self.in_the_way,
            world_from_camera=self.cameras,
            fov_x=self.fov_x,
            bbox=rounded("bbox", self.boxes.xywh),
            config=self.config,
        )

    @property
    def tries_add_up(self) -> Bool[np.ndarray, " n"]:
        """Whether a position was tried as often as it was rejected, and once more."""
        rejected = np.array([_count(row, PLACING) for row in self.first_shots])
        return self.said("tries") == rejected + 1

    @property
    def cameras_tried(self) -> Float[np.ndarray, " n"]:
        """Cameras tried for the image at the place that took most of them, at least."""
        rejected = np.array([_count(row, AIMING) for row in self.rows])
        blind = np.array([row.rejected.get("no_view", 0) for row in self.first_shots])
        return np.ceil((rejected + 1) / (blind + 1))

    # Light, and the plan as a whole.

    @cached_property
    def lights(self) -> Lights:
        """What is drawn for images with these indices."""
        index = np.array([row.index for row in self.rows])
        weights = np.array(list(self.source.hdri_weights.values())).T
        return draw_lights(self.config.light, self.config.weather, weights, draws=self.source.draws, image=index)

    @property
    def hdri_has_weight(self) -> Bool[np.ndarray, " n"]:
        """Whether the HDRI is one that may be drawn."""
        cloudy = self.lights.air.overcast.tolist()
        pairs = zip(self.rows, cloudy, strict=True)
        return np.array([self.source.hdri_weights[row.hdri][under] > 0.0 for row, under in pairs])

    @property
    def scenery_has_weight(self) -> Bool[np.ndarray, " n"]:
        """Whether the scenery is one that may be drawn."""
        return np.full(len(self.rows), self.source.scenery_weights.get(self.site.name, 1.0) > 0.0)

    @property
    def scenery_is_for_vehicle(self) -> Bool[np.ndarray, " n"]:
        """Whether the config lets the vehicle be placed on the scenery."""
        vehicle = self.placed.model.shape.name
        entry = next((entry for entry in self.config.assets.vehicles if entry.name == vehicle), None)
        return np.full(len(self.rows), entry is None or entry.is_for(self.site.name))

    @property
    def weather_as_drawn(self) -> Bool[np.ndarray, " n"]:
        """Whether the weather is of the kind that was drawn."""
        drawn = [(*KINDS, None)[kind] for kind in self.lights.air.kind.tolist()]
        said = [row.weather.kind if row.weather else None for row in self.rows]
        return np.array([one == other for one, other in zip(said, drawn, strict=True)])

    @property
    def seed_as_drawn(self) -> Bool[np.ndarray, " n"]:
        """Whether Cycles' seed is the one drawn."""
        return np.array([row.sample_seed for row in self.rows]) == self.lights.sample_seed

    @cached_property
    def exposures(self) -> Exposures:
        """What is planned for the light of these rows."""
        rows, source = self.rows, self.source
        return exposures(
            np.array([row.index for row in rows]),
            [row.hdri for row in rows],
            self.said("strength", of_image=True),
            light=self.config.light,
            assets=source.assets,
            draws=source.draws,
        )

    @property
    def exposed_as_metered(self) -> Bool[np.ndarray, " n"]:
        """Whether the exposure is that of the row's light and the drawn error."""
        said = self.said("exposure_ev", of_image=True)
        return np.abs(said - self.exposures.ev) <= EV

    @property
    def balanced_as_drawn(self) -> Bool[np.ndarray, " n"]:
        """Whether the white balance is the one drawn."""
        return np.abs(self.said("white_balance_k", of_image=True) - self.exposures.white_balance_k) <= KELVIN

    @property
    def backdrop_follows(self) -> Bool[np.ndarray, " n"]:
        """Whether of the HDRI is seen what the config says."""
        said, wanted = self.said("horizon_deg", of_image=True), self.exposures.horizon_deg
        return (np.abs(said - wanted) <= DEGREES) | (np.isnan(said) & np.isnan(wanted))

    @property
    def image_size_is_the_configs(self) -> Bool[np.ndarray, " n"]:
        """Whether pictures are as large as the config wants them."""
        render = self.config.render
        return np.array([(row.width, row.height) == (render.width, render.height) for row in self.rows])

    @property
    def in_budget(self) -> Bool[np.ndarray, " n"]:
        """Whether the budget gives this image to this shot of this position, with this vehicle."""
        budget = self.source.budget
        position = np.array([row.position for row in self.rows])
        known = (position >= 0) & (position < budget.n_positions)
        held = budget.positions(np.where(known, position, 0))
        shot, index = (np.array([getattr(row, key) for row in self.rows]) for key in ("shot", "index"))
        vehicle = framed_on(
            budget,
            self.source.stage,
            self.config,
            self.source.draws,
            position=np.where(known, position, 0),
            held=held,
            sites=[row.scenery for row in self.rows],
        )
        mine = np.array([row.vehicle == name for row, name in zip(self.rows, vehicle, strict=True)])
        mine &= np.array([row.background for row in self.rows]) == held.background
        return known & (shot < held.shots) & (index == held.first_image + shot) & mine

    @property
    def shares_with_first_shot(self) -> Bool[np.ndarray, " n"]:
        """Whether the shots of one position share everything but the camera and the light."""
        return np.array(
            [_shared(row) == _shared(first) for row, first in zip(self.rows, self.first_shots, strict=True)]
        )


def _count(row: Row, kinds: tuple[Any, ...]) -> int:
    return sum(row.rejected.get(kind.key, 0) for kind in kinds)


def _shared(row: Row) -> list[Any]:
    """What the shots of a position have in common, poses as lists."""
    keys = ("vehicle", "articulation", "slope_deg", "gap", "penetration", "tries", "paint")
    poses = [vehicle.world_from_vehicle.tolist() for vehicle in row.planned]
    return [row.scenery, row.position, poses, [[getattr(vehicle, key) for key in keys] for vehicle in row.planned]]


def _is_part(some: list[str], all_: list[str]) -> bool:
    """Whether these are some of all, in their order."""
    rest = iter(all_)
    return all(name in rest for name in some)
