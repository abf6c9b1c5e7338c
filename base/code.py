"""Versions and a hash of the running code, to compare two machines."""

from __future__ import annotations

import hashlib
import importlib.metadata
from collections.abc import Mapping
from functools import cache
from pathlib import Path

PACKAGE_FOLDER = Path(__file__).resolve().parents[1]
NOT_INSTALLED = "not installed"


@cache
def code_sha256() -> str:
    """Return the SHA-256 of all modules."""
    digest = hashlib.sha256()
    folders = [path.parent for path in PACKAGE_FOLDER.glob("*/__init__.py")]  # the product's, in a checkout too
    for path in sorted(path for folder in folders for path in folder.rglob("*.py")):
        digest.update(f"{path.relative_to(PACKAGE_FOLDER)} {hashlib.sha256(path.read_bytes()).hexdigest()}\n".encode())
    return digest.hexdigest()


def package_versions(*packages: str) -> dict[str, str]:
    """Return the versions of hulldown, with a hash of its code, and of packages; `NOT_INSTALLED` for missing ones."""
    by_package = {"hulldown": f"{importlib.metadata.version('hulldown')} ({code_sha256()[:8]})"}
    return by_package | {package: (package_version(package) or NOT_INSTALLED).split("+")[0] for package in packages}


def package_version(package: str) -> str | None:
    """Return the version of a package; None if it isn't installed."""
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return None


def describe_version_difference(client: Mapping[str, str]) -> str:
    """Describe the first version in which this process differs from a client; empty if there is none."""
    own_versions = package_versions(*client.keys() - {"hulldown"})
    for name, version in client.items():
        if own_versions[name] != version:
            return f"has {name} {own_versions[name]}, and the client {version}"
    return ""
