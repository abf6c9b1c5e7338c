"""Configs that anybody may have written: understood, or refused in one line that names the key."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

from hypothesis import given, settings
from hypothesis import strategies as st

from geometry.errors import ConfigError
from planning.config import load_config, parse_config
from planning.schema import Config

# 20,000 inputs in the thorough profile.
MANY = settings(max_examples=settings.default.max_examples * (10 if settings.default.max_examples >= 2000 else 1))
SOUND: dict[str, Any] = {
    "seed": 3,
    "assets": {
        "hdris": ["*.exr"],
        "vehicles": [{"path": "a.blend", "category": "tank"}],
        "sceneries": [{"path": "b.blend"}],
    },
    "budget": {"images_per_class": 1},
}
SECTIONS = {
    name: list(getattr(field.annotation, "model_fields", {})) or [name] for name, field in Config.model_fields.items()
}
leaves = (
    st.none()
    | st.booleans()
    | st.integers()
    | st.integers().map(lambda n: n * 10**400)
    | st.floats()
    | st.text(max_size=6)
    | st.sampled_from(["../x", "/x", "\x00", "a" * 9999, "[", "**", ""])
)
values = st.recursive(
    leaves,
    lambda some: st.lists(some, max_size=3) | st.dictionaries(st.text(max_size=4), some, max_size=2),
    max_leaves=5,
)
places = st.sampled_from([(section, key) for section, keys in SECTIONS.items() for key in keys])


def refusal(use: Callable[[], object]) -> str | None:
    """What a user is told of a mistake in a config; any other error is one of the program, and not caught."""
    try:
        use()
    except ConfigError as error:
        return str(error)
    return None


@MANY
@given(st.lists(st.tuples(places, values), min_size=1, max_size=3))
def test_any_value_in_any_key_is_understood_or_refused(changes: list[tuple[tuple[str, str], Any]]) -> None:
    data: dict[str, Any] = {key: dict(value) if isinstance(value, dict) else value for key, value in SOUND.items()}
    for (section, key), value in changes:
        if section == key:
            data[section] = value
        elif isinstance(data.setdefault(section, {}), dict):
            data[section][key] = value
    said = refusal(lambda: parse_config(data, path=Path("hulldown.toml")))
    assert said is None or ("hulldown.toml" in said and len(said) < 5000)


@MANY
@given(st.binary(max_size=60) | st.text(max_size=60).map(lambda text: text.encode("utf-8", "surrogatepass")))
def test_any_file_is_understood_or_refused(content: bytes) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "hulldown.toml"
        path.write_bytes(content)
        said = refusal(lambda: load_config(path))
        assert said is None or "hulldown.toml" in said
