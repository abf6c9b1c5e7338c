"""Any config is accepted, or refused in one line that names the key."""

from __future__ import annotations

import copy
import tempfile
from itertools import pairwise
from pathlib import Path
from typing import Any, get_args, get_origin

from hypothesis import given
from hypothesis import strategies as st
from pydantic import BaseModel

from hulldown.plan.config.schema import Config
from hulldown.property_tests.any_values import MANY, refusal

SOUND: dict[str, Any] = {
    "seed": 3,
    "assets": {
        "hdris": ["*.exr"],
        "vehicles": [{"path": "a.blend", "category": "tank"}],
        "distractors": [{"path": "c.blend"}],
        "sceneries": [{"path": "b.blend"}],
    },
    "budget": {"images_per_class": 1},
    "light": {"hdris": [{"name": "a"}]},
}


def all_places(model: type[BaseModel] = Config, path: tuple[str | int, ...] = ()) -> list[tuple[str | int, ...]]:
    """Places for values in a config: the keys of all tables, and of tables in lists."""
    found: list[tuple[str | int, ...]] = []
    for name, field in model.model_fields.items():
        found.append((*path, name))
        listed = get_origin(field.annotation) is tuple
        for inner in [field.annotation, *get_args(field.annotation), *map(_bare, get_args(field.annotation))]:
            if isinstance(inner, type) and issubclass(inner, BaseModel):
                found += all_places(inner, (*path, name, 0) if listed else (*path, name))
    return list(dict.fromkeys(found))


def _bare(annotation: Any) -> Any:
    """An annotation without metadata."""
    return next(iter(get_args(annotation)), None)


def put(data: Any, place: tuple[str | int, ...], value: Any) -> None:
    """Set a key, unless another change has replaced a table around it."""
    for step, following in pairwise(place):
        if isinstance(data, dict):
            data = data.setdefault(step, [{}] if following == 0 else {})
        elif isinstance(data, list) and data:
            data = data[0]
    if isinstance(data, dict):
        data[place[-1]] = value


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
    leaves, lambda some: st.lists(some, max_size=3) | st.dictionaries(st.text(max_size=4), some, max_size=2), max_leaves=5
)
places = st.sampled_from(all_places())


@MANY
@given(st.lists(st.tuples(places, values), min_size=1, max_size=3))
def test_any_value_of_any_key_is_accepted_or_refused(changes: list[tuple[tuple[str | int, ...], Any]]) -> None:
    data = copy.deepcopy(SOUND)
    for place, value in changes:
        put(data, place, copy.deepcopy(value))
    message = refusal(lambda: Config.of(data, path=Path("hulldown.toml")))
    assert not message or ("hulldown.toml" in message and len(message) < 5000)


numerals = st.sampled_from([b"9" * 5000, b"0x" + b"f" * 5000, b"[" * 1000, b"[" * 300 + b"]" * 300, b"1e999", b"-nan"])
numerals = st.tuples(st.sampled_from([b"seed", b"budget.images_per_class", b"x"]), numerals).map(b" = ".join)


@MANY
@given(st.binary(max_size=60) | numerals | st.text(max_size=60).map(lambda text: text.encode("utf-8", "surrogatepass")))
def test_any_file_is_accepted_or_refused(content: bytes) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "hulldown.toml"
        path.write_bytes(content)
        message = refusal(Config.read, path)
        assert not message or "hulldown.toml" in message
