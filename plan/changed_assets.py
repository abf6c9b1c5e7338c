"""Refuse assets that aren't those that a plan was made from."""

from __future__ import annotations

from collections.abc import Mapping

from hulldown.assets.library import Assets, GeometrySource, HdriSource, Source
from hulldown.base.code import package_version
from hulldown.base.errors import ConfigError
from hulldown.plan.lines import PlanFile


def refuse_changed(plan: PlanFile, assets: Assets) -> None:
    """Refuse assets whose files have changed since planning, or whose geometry is read differently here."""
    for kind in ("vehicles", "distractors", "sceneries", "hdris"):
        planned: Mapping[str, Source] = getattr(plan.header, kind)
        files = assets.files.get(kind, {})
        for name, was in planned.items():
            if name not in files or (was.sha256 and _source_digests(files[name]) != _source_digests(was)):
                raise ConfigError(
                    f"{kind}: {name!r} ({was.path}) is not what it was when this was planned",
                    path=plan.path,
                    remedy="plan again with `hulldown plan`, or bring the old file back",
                )
            if not _reads_the_same(was, files[name]):
                raise ConfigError(
                    f"{kind}: {name!r} ({was.path}) has another geometry here than when this was planned"
                    f" ({_blender_versions(plan)})",
                    path=plan.path,
                    remedy="plan again here, or use the Blender that it was planned with",
                )


def _source_digests(source: Source) -> tuple[str, str]:
    """Return the digests of a file and of its rendered copy."""
    return source.sha256, source.mended_sha256 if isinstance(source, HdriSource) else ""


def _reads_the_same(was: Source, now: Source) -> bool:
    """Return whether a file's geometry is that of the plan, as far as the plan tells."""
    if not (isinstance(was, GeometrySource) and isinstance(now, GeometrySource) and was.geometry and now.geometry):
        return True
    return was.geometry.agrees_with_other(now.geometry)


def _blender_versions(plan: PlanFile) -> str:
    """Return the Blenders that read the assets, for an error."""
    return f"with bpy {plan.header.versions.get('bpy', 'unknown')}; here is {package_version('bpy') or 'none'}"
