"""The keys of a config that no limit recomputes from a plan's rows, and why."""

from __future__ import annotations

from collections.abc import Mapping

_READ = "read into the assets, which are read again by the header's config; their hashes are in the header"
_RENDERED = "a setting of Cycles: no row holds it, and only a picture shows it"
NOT_RECOMPUTED: Mapping[str, str] = {
    "assets.cache": "where files are kept; a plan does not depend on it",
    "assets.texture_size": _READ,
    "assets.hdris": "patterns of files; the names that they give are those of the header",
    **{f"assets.{kind}.{key}": _READ for kind in ("vehicles", "distractors") for key in (
        "path", "category", "name", "forward", "yaw_deg", "up", "scale", "keep", "drop", "turret", "gun",
        "turret_pivot", "gun_pivot", "turret_limits_deg", "gun_limits_deg",
    )},
    **{f"assets.sceneries.{key}": _READ for key in (
        "path", "name", "up", "scale", "ground", "not_ground", "water", "drop",
    )},
    "ground.include": _READ,
    "ground.exclude": _READ,
    "camera.elevation_sampling": "a distribution: any one elevation within its bounds may come of it",
    "camera.framing": "how far off the middle cameras are aimed; within a vehicle's length the aim may miss",
    "light.hdris.weight": "how often an HDRI is drawn, a distribution; that a weight of 0 is never drawn is checked",
    "render.profile": _RENDERED,
    "render.samples": _RENDERED,
    "render.denoise": _RENDERED,
    "render.adaptive_threshold": _RENDERED,
    "render.bounces": _RENDERED,
}  # fmt: skip
