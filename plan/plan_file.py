"""A plan opened for reading, with its config, a summary, a table, and previews."""

from __future__ import annotations

import os
from collections.abc import Sequence
from functools import cached_property
from typing import TYPE_CHECKING

import orjson

from hulldown.base.errors import HulldownError
from hulldown.base.indices import even_sample
from hulldown.pictures.notebooks import ShownInNotebooks
from hulldown.plan.config.schema import Config
from hulldown.plan.library import load_planned_library
from hulldown.plan.lines import PlanFile
from hulldown.plan.row import encode_line

if TYPE_CHECKING:
    import pandas
    from PIL import Image

    from hulldown.plan.pictures.preview import Artist
    from hulldown.plan.summary import Summary


class Plan(PlanFile, ShownInNotebooks):
    """A plan file opened for reading: `len(plan)`, `plan[i]`, `plan[:10]`, `for row in plan`; also a path.

    Parameters
    ----------
    path
        The file.
    header
        Its first line: config, seed, assets, versions.
    """

    @cached_property
    def config(self) -> Config:
        """The config of the plan, with its folder."""
        return Config.of_plan(self)

    @cached_property
    def summary(self) -> Summary:
        """Counts, rejections, and histograms of all rows."""
        from hulldown.plan.summary import summarize_plan

        return summarize_plan(self, left_out=self.header.left_out, overcast=bool(self.config.light.overcast))

    def to_pandas(self) -> pandas.DataFrame:
        """Return a table with a row per image and the keys of docs/plan-file.md as columns, its target's too.

        Raises
        ------
        HulldownError
            If pandas isn't installed.
        ConfigError
            If a row is damaged.
        """
        try:
            import pandas
        except ModuleNotFoundError:
            raise HulldownError("pandas: not installed", remedy="pip install pandas") from None
        lines = [orjson.loads(encode_line(row)) for row in self]
        return pandas.json_normalize([line["planned"][0] | line for line in lines])

    def preview(self, indices: Sequence[int] | None = None, *, columns: int = 3, width: int = 480) -> Image.Image:
        """Shade images without Blender and draw their boxes, on one sheet.

        Parameters
        ----------
        indices
            Images to show; None for up to six, evenly spread over the plan.
        columns, width
            Images side by side, and the width of each in pixels.

        Raises
        ------
        HulldownError
            If an asset can't be read, or a row is damaged.
        """
        chosen = even_sample(len(self), 6).tolist() if indices is None else indices
        return self._artist.draw_sheet(chosen, columns=min(columns, max(len(chosen), 1)), tile_width=width)

    @cached_property
    def _artist(self) -> Artist:
        from hulldown.plan.pictures.preview import Artist

        return Artist(self, load_planned_library(self).assets)

    def _table_facts(self) -> dict[str, object]:
        header = self.header
        return {
            "images": f"{len(self):,}",
            "classes": ", ".join(header.categories),
            "vehicles": ", ".join(header.vehicles),
            "sceneries": ", ".join(header.sceneries),
            "HDRIs": ", ".join(header.hdris),
            "seed": header.seed,
        }

    def _notebook_picture(self) -> Image.Image:
        return self.preview(width=320)


def read_plan(path: str | os.PathLike[str]) -> Plan:
    """Open a plan; rows are read on access.

    Raises
    ------
    ConfigError
        If the file is missing, isn't a plan, or has another format.

    Examples
    --------
    >>> plan = read_plan("plan.jsonl")
    >>> len(plan), plan.header.seed
    (22, 0)
    >>> plan[3].target.bbox._fields, plan[3].world_from_camera.shape
    (('x', 'y', 'width', 'height'), (4, 4))
    """
    return Plan.read(path)
