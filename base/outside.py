"""Read files from outside: opened once, regular, of limited size, and parsed into values of declared types.

Nothing else opens or parses them; `tests/base/test_outside.py` lists the exceptions with their reasons.
"""

from __future__ import annotations

import hashlib
import json
import os
import threading
import tomllib
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, TypeAlias, TypeVar
from xml.etree.ElementTree import Element, TreeBuilder
from xml.parsers import expat

import msgspec
import orjson
import yaml

from hulldown.base.files import open_regular_file

# Largest files by kind, in bytes: texts that people write, documents, and labels or pictures.
MAX_TEXT_BYTES, MAX_DOCUMENT_BYTES, MAX_DATA_BYTES = 1 << 20, 1 << 28, 1 << 32
MISSING_FILE = "no such file"
MAX_NESTING_DEPTH = 64  # of lists and objects
MAX_NUMBER_LENGTH = 300  # characters; float64 ends at 308
MAX_YAML_CHARACTERS = 1 << 18  # the parser reads some 50,000 a second
MAX_LINE_DOTS = 500  # TOML's parser takes quadratic time for keys of many parts
# What folders with these files are, and files that begin like this, or are named like this.
FOLDER_KINDS = {
    "annotations.json": "a dataset", "journal.jsonl": "a dataset", "run.json": "a run of `train`",
    "study.json": "a study", ".hulldown-done": "an export",
}  # fmt: skip
FILE_BEGINNINGS = {
    b'{"hulldown_plan"': "a plan", b"BLENDER": "a .blend file",
    b"\x89PNG": "a picture", b"\xff\xd8\xff": "a picture", b"\x76\x2f\x31\x01": "an HDRI",
}  # fmt: skip
FILE_KINDS = {".toml": "a config", ".json": "a JSON file", ".blend": "a .blend file"}
T = TypeVar("T")
_ONE_THREAD = threading.RLock()
MakeError: TypeAlias = Callable[[str], Exception]  # makes an error of a problem, such as partial(ConfigError, path=path)


def read_file(path: Path, refuse: MakeError, *, most: int = MAX_DOCUMENT_BYTES) -> bytes:
    """Return a file's content.

    `refuse`: makes the error that is raised if it isn't a regular file, is larger than `most` bytes, or can't be read.

    >>> from functools import partial
    >>> from hulldown.base.errors import HulldownError
    >>> read_file(Path("nothing.toml"), partial(HulldownError, path="nothing.toml"))
    Traceback (most recent call last):
    hulldown.base.errors.HulldownError: nothing.toml: no such file
    """
    try:
        with open_regular_file(path) as file:
            # One more byte than it has, since it may grow.
            content = file.read(min(os.fstat(file.fileno()).st_size, most) + 1)
    except FileNotFoundError:
        raise refuse(MISSING_FILE) from None
    except OSError as error:
        raise refuse(f"cannot be read ({error.strerror})") from None
    except ValueError:  # a zero byte in its name
        raise refuse("isn't a valid file name") from None
    if len(content) > most:
        raise refuse(f"is larger than {most >> 20:,} MiB")
    return content


def describe_path(path: Path) -> str:
    """Return what is at a path, as far as its beginning shows, for errors about what it isn't."""
    if path.is_dir():
        return next((kind for name, kind in FOLDER_KINDS.items() if (path / name).exists()), "a folder")
    try:
        with open_regular_file(path) as file:
            start = file.read(16)
    except OSError:
        return "another file"
    kind = FILE_KINDS.get(path.suffix.lower(), "another file")
    kind = "a JSON list" if kind == "a JSON file" and start.startswith(b"[") else kind
    return next((known for mark, known in FILE_BEGINNINGS.items() if start.startswith(mark)), kind if start else "empty")


def file_sha256(path: Path) -> str:
    """Return the SHA-256 of a regular file's content, in hexadecimal digits."""
    digest = hashlib.sha256()
    with open_regular_file(path) as file:
        while part := file.read(1 << 20):
            digest.update(part)
    return digest.hexdigest()


def read_text(path: Path, refuse: MakeError, *, most: int = MAX_TEXT_BYTES) -> str:
    """Return a file's text, which is UTF-8 with or without a mark; see `read_file`."""
    try:
        return read_file(path, refuse, most=most).decode("utf-8-sig")
    except UnicodeDecodeError:
        raise refuse("isn't UTF-8 text") from None


def read_json(path: Path, kind: type[T], refuse: MakeError, *, what: str, most: int = MAX_DOCUMENT_BYTES) -> T:
    """Return the value of a JSON file as a `kind`; `what` names it in errors, see `read_file`."""
    content = read_file(path, refuse, most=most)
    try:
        return parse_json(content, kind)
    except ValueError as error:
        raise refuse(f"isn't {what} ({error})") from None


def parse_json(content: bytes | memoryview, kind: type[T]) -> T:
    """Return a JSON value as a `kind`."""
    return convert_parsed_value(orjson.loads(content), kind)


def convert_value(
    value: object, kind: type[T], *, strict: bool = True, dec_hook: Callable[[type, Any], Any] | None = None
) -> T:
    """`msgspec.convert`, one thread at a time: it crashes where two threads meet a new type at once."""
    with _ONE_THREAD:
        return msgspec.convert(value, kind, strict=strict, dec_hook=dec_hook)


def convert_parsed_value(value: object, kind: type[T], *, strict: bool = True) -> T:
    """Return parsed JSON, YAML, or TOML as a `kind`; if not `strict`, also from texts. Errors of `parse_json`."""
    try:
        found = convert_value(value, kind, strict=strict)
    except RecursionError:
        raise ValueError("it is nested too deeply") from None
    except msgspec.ValidationError as error:
        raise ValueError(str(error)) from None
    level: list[object] = [found]
    for _ in range(MAX_NESTING_DEPTH):
        inner = (each.values() if isinstance(each, dict) else each for each in level if isinstance(each, dict | list))
        level = [value for values in inner for value in values if isinstance(value, dict | list)]
        if not level:
            return found
    raise ValueError("it is nested too deeply")


def parse_toml(text: str) -> dict[str, Any]:
    """Return a TOML document; ValueError as for `parse_json`."""
    if any(line.count(".") > MAX_LINE_DOTS for line in text.splitlines()):
        raise ValueError("a line has hundreds of points")
    try:
        return convert_parsed_value(tomllib.loads(text), dict[str, Any])
    except RecursionError:
        raise ValueError("it is nested too deeply") from None


class _PlainYamlLoader(yaml.SafeLoader):
    """A loader without aliases that reads unknown tags, such as OpenCV's for a matrix, as tables."""

    depth = 0

    def compose_node(self, parent: object, index: object) -> object:
        if self.check_event(yaml.AliasEvent):  # some hundred bytes of aliases fill any memory
            raise ValueError("it has an alias; write the value out")
        self.depth += 1
        if self.depth > MAX_NESTING_DEPTH:
            raise ValueError("it is nested too deeply")
        node = super().compose_node(parent, index)
        self.depth -= 1
        if isinstance(node, yaml.ScalarNode) and ":" in node.value and node.tag.endswith((":int", ":float")):
            node.tag = "tag:yaml.org,2002:str"  # 1:36 is 96 in YAML 1.1, where 60 is a base
        if isinstance(node, yaml.ScalarNode) and len(node.value) > MAX_NUMBER_LENGTH and not node.tag.endswith(":str"):
            raise ValueError(f"it has a number of {len(node.value):,} characters")
        return node


_PlainYamlLoader.add_multi_constructor("", lambda loader, _, node: loader.construct_mapping(node, deep=True))


def parse_yaml(text: str) -> object:
    """Return a YAML document, of plain values; ValueError as for `parse_json`."""
    if len(text) > MAX_YAML_CHARACTERS:
        raise ValueError(f"it has more than {MAX_YAML_CHARACTERS >> 10} KiB")
    try:
        return yaml.load(text, Loader=_PlainYamlLoader)
    except yaml.YAMLError as error:
        raise ValueError(" ".join(str(error).split())) from None
    except (ArithmeticError, AttributeError, LookupError, TypeError) as error:  # a tag's value may not fit it
        raise ValueError(f"a tag doesn't fit its value: {error}") from None


def parse_xml(content: bytes) -> Element:
    """Return the root of an XML document without a document type, where entities would be declared."""
    tree, depth, parser = TreeBuilder(), 0, expat.ParserCreate()

    def start(name: str, attributes: dict[str, str]) -> None:
        nonlocal depth
        depth += 1
        if depth > MAX_NESTING_DEPTH:
            raise ValueError("it is nested too deeply")
        tree.start(name, attributes)

    def end(name: str) -> None:
        nonlocal depth
        depth -= 1
        tree.end(name)

    def declared(*_: object) -> None:
        raise ValueError("it declares a document type")

    parser.StartElementHandler, parser.EndElementHandler, parser.CharacterDataHandler = start, end, tree.data
    parser.StartDoctypeDeclHandler = declared
    try:
        parser.Parse(content, True)
        return tree.close()
    except (expat.ExpatError, LookupError) as error:  # an unknown encoding
        raise ValueError(str(error)) from None


def json_and_repeated_keys(content: bytes) -> tuple[object, Counter[str]]:
    """Return a JSON value, and how many objects have a key more than once; ValueError as for `parse_json`."""
    repeated: Counter[str] = Counter()

    def once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        record = dict(pairs)
        if len(record) < len(pairs):
            repeated.update({key for key, times in Counter(key for key, _ in pairs).items() if times > 1})
        return record

    try:
        return json.loads(content, object_pairs_hook=once), repeated
    except RecursionError:
        raise ValueError("it is nested too deeply") from None


def raw_json_values(content: bytes) -> dict[str, msgspec.Raw]:
    """Return the values of a JSON object, not parsed, which takes little memory; ValueError as for `parse_json`."""
    return _decode_json(content, dict[str, msgspec.Raw])


def parse_json_records(content: bytes | msgspec.Raw, key: str) -> Iterator[dict[str, Any]]:
    """Yield the objects of a JSON list one at a time; ValueError, which names its `key`, if it's something else."""
    try:
        parts = _decode_json(content, list[msgspec.Raw])
    except ValueError as error:
        raise ValueError(f"{key!r} is not a list of objects: {error}") from None
    for part in parts:
        record = orjson.loads(memoryview(part))
        if not isinstance(record, dict):
            raise ValueError(f"{key!r} is not a list of objects")
        yield record


def _decode_json(content: bytes | msgspec.Raw, kind: type[T]) -> T:
    try:
        return msgspec.json.decode(content, type=kind)
    except RecursionError:
        raise ValueError("it is nested too deeply") from None
    except msgspec.MsgspecError as error:
        raise ValueError(str(error)) from None
