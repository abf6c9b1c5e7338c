"""A distorting lens in Cycles: a camera written in Open Shading Language, which gives each sample its own ray."""

from __future__ import annotations

import hashlib
import tempfile
from functools import lru_cache
from pathlib import Path
from typing import Any

import _cycles

from hulldown.camera.distortion import max_seen_radius
from hulldown.camera.intrinsics import Intrinsics
from hulldown.render.blender.cycles import Unusable

LENS_DEVICES = ("CPU", "OPTIX")  # Cycles runs such cameras on these
# Newton's method, as in `camera.distortion.undistort_points`; a sample that has no ray stays black.
SHADER_SOURCE = """shader hulldown_lens(
    output point position = 0.0, output vector direction = vector(0.0, 0.0, 1.0), output color throughput = 1.0)
{{
  point raster = camera_shader_raster_position();
  float across = (raster.x * {width} - ({cx})) / {fx};
  float down = ((1.0 - raster.y) * {height} - ({cy})) / {fy};
  float x = across;
  float y = down;
  float miss = 1.0;
  for (int i = 0; i < 40 && miss > 1e-7; i++) {{
    float r2 = x * x + y * y;
    if (r2 > {limit}) {{
      x *= sqrt({limit} / r2);
      y *= sqrt({limit} / r2);
      r2 = {limit};
    }}
    float radial = 1.0 + r2 * (({k1}) + r2 * (({k2}) + r2 * ({k3})));
    float slope = 2.0 * (({k1}) + r2 * (2.0 * ({k2}) + r2 * 3.0 * ({k3})));
    float a = x * radial + 2.0 * ({p1}) * x * y + ({p2}) * (r2 + 2.0 * x * x) - across;
    float b = y * radial + ({p1}) * (r2 + 2.0 * y * y) + 2.0 * ({p2}) * x * y - down;
    float xx = radial + slope * x * x + 2.0 * ({p1}) * y + 6.0 * ({p2}) * x;
    float xy = slope * x * y + 2.0 * ({p1}) * x + 2.0 * ({p2}) * y;
    float yy = radial + slope * y * y + 6.0 * ({p1}) * y + 2.0 * ({p2}) * x;
    float scale = 1.0 / (xx * yy - xy * xy);
    float step_x = (yy * a - xy * b) * scale;
    float step_y = (xx * b - xy * a) * scale;
    x -= step_x;
    y -= step_y;
    miss = fabs(step_x) + fabs(step_y);
  }}
  if (miss > 1e-5)
    throughput = 0.0;
  direction = normalize(vector(x, -y, 1.0));
  position = {near} * vector(x, -y, 1.0);
}}
"""


def set_distorting_lens(camera: Any, intrinsics: Intrinsics, near: float) -> None:
    """Give a camera of Blender a distorting lens."""
    assert intrinsics.pinhole is not None
    values = dict(zip(("fx", "fy", "cx", "cy"), intrinsics.pinhole, strict=True))
    values |= dict(zip(("k1", "k2", "p1", "p2", "k3"), intrinsics.distortion, strict=True))
    limit = min(max_seen_radius(intrinsics.distortion) ** 2, 1e6)
    values |= {"width": intrinsics.width, "height": intrinsics.height, "limit": limit, "near": near}
    code = _compile_shader(SHADER_SOURCE.format(**{name: f"{value:.9e}" for name, value in values.items()}))
    if camera.type != "CUSTOM" or camera.custom_bytecode != code:
        camera.type, camera.custom_mode = "CUSTOM", "INTERNAL"
        camera.custom_bytecode = code
        camera.custom_bytecode_hash = hashlib.md5(code.encode(), usedforsecurity=False).hexdigest()


@lru_cache(maxsize=8)
def _compile_shader(source: str) -> str:
    with tempfile.TemporaryDirectory() as name:
        path = Path(name) / "lens.osl"
        path.write_text(source, encoding="ascii")
        made = path.with_suffix(".oso")
        if not getattr(_cycles, "with_osl", False) or not _cycles.osl_compile(str(path), str(made)):
            raise Unusable(
                "this Blender can't render `camera.distortion`: it was built without Open Shading Language",
                "use the bpy module or a Blender from blender.org",
            )
        return made.read_text(encoding="ascii")
