"""Write a gray card on open land as card.blend, and the skies in a folder's .npy files as .exr; run as a script."""

import sys
from pathlib import Path

import numpy as np

from hulldown.camera.response import CARD_ALBEDO
from hulldown.reading.blender.hdri_picture import _write_radiance_exr
from hulldown.tests.builders.blend_parts import cuboid, fresh, gather, save
from hulldown.tests.builders.render_worlds import diffuse

FOLDER = Path(sys.argv[1])
fresh()
cuboid("card", (2.0, 2.0, 1.0), (0.0, 0.0, -0.5), diffuse("card", (CARD_ALBEDO,) * 3))
gather()
save(FOLDER / "card.blend")
for sky in FOLDER.glob("*.npy"):
    _write_radiance_exr(np.load(sky), str(sky.with_suffix(".exr")))
