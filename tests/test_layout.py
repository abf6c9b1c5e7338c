"""Files that look as if they had been written here: read by line they say what they say to a parser of the whole."""

import pytest

import hulldown.dataset.store.document
from hulldown.dataset.store.document import read_document
from hulldown.dataset.store.record_lines import OtherLayoutError
from hulldown.geometry.errors import DatasetError

HEAD = b'{"categories":[{"id":1,"name":"tank"}],\n'
IMAGES = b'"images":[\n{"id":1,"file_name":"a.png"},\n{"id":2,"file_name":"b.png"}],\n'
ANNOTATIONS = b'"annotations":[\n{"id":1,"image_id":1,"x":[{}]}]}\n'
OURS = HEAD + IMAGES + ANNOTATIONS


def whole(folder, monkeypatch):
    """What a parser of the whole makes of it: the document's state, or what it refuses."""

    def never(file):
        raise OtherLayoutError

    with monkeypatch.context() as patch:
        patch.setattr(hulldown.dataset.store.document, "read_by_line", never)
        return outcome(folder)


def outcome(folder):
    try:
        document = read_document(folder)
    except DatasetError as error:
        return str(error)
    names = ("head", "categories", "category_ids", "images", "annotations", "file_names", "runs")
    return {name: getattr(document, name) for name in names}


@pytest.mark.parametrize(
    "content",
    [
        pytest.param(OURS + b"{}", id="something after the end"),
        pytest.param(OURS + OURS, id="the file twice"),
        pytest.param(OURS[:-1], id="no newline at the end"),
        pytest.param(OURS[:-3], id="cut off"),
        pytest.param(OURS.replace(b"]}]}\n", b"]},\n"), id="cut off after a record"),
        pytest.param(HEAD + IMAGES, id="no annotations"),
        pytest.param(HEAD + IMAGES + IMAGES + ANNOTATIONS, id="images twice"),
        pytest.param(HEAD + ANNOTATIONS.replace(b"]}\n", b"],\n") + IMAGES.replace(b"],\n", b"]}\n"), id="other order"),
        pytest.param(HEAD.replace(b'"categories"', b'"images"') + IMAGES + ANNOTATIONS, id="images in the head"),
        pytest.param(HEAD.replace(b'"categories"', b'"annot\\u0061tions"') + IMAGES + ANNOTATIONS, id="escaped key"),
        pytest.param(b'{"categories":1,\n' + IMAGES + ANNOTATIONS, id="categories are no list"),
        pytest.param(b"{,\n" + IMAGES + ANNOTATIONS, id="comma after nothing"),
        pytest.param(b"{},\n" + IMAGES + ANNOTATIONS, id="head is closed"),
        pytest.param(b'{"a":{"b":1},\n' + IMAGES + ANNOTATIONS, id="a bracket in the head"),
        pytest.param(b'{"a":1,},\n' + IMAGES + ANNOTATIONS, id="comma at the head's end"),
        pytest.param(b"\xef\xbb\xbf" + OURS, id="byte order mark"),
        pytest.param(OURS.replace(b"},\n{", b"},\n\n{"), id="an empty line"),
        pytest.param(OURS.replace(b"},\n{", b"},\nx\n{"), id="garbage between records"),
        pytest.param(OURS.replace(b"},\n{", b"}\n{"), id="no comma between records"),
        pytest.param(OURS.replace(b"},\n{", b"},,\n{"), id="two commas"),
        pytest.param(OURS.replace(b"},\n{", b"},{"), id="two records in a line"),
        pytest.param(OURS.replace(b"},\n{", b"},\n[{}],\n{"), id="a list as record"),
        pytest.param(OURS.replace(b'"b.png"}],', b'"b.png"},\n],'), id="comma after the last"),
        pytest.param(OURS.replace(b"a.png", b"a\xff.png"), id="no UTF-8"),
        pytest.param(OURS.replace(b"a.png", b"a\\ud800.png"), id="half a surrogate"),
        pytest.param(OURS.replace(b'"image_id":1', b'"image_id":NaN'), id="NaN"),
        pytest.param(OURS.replace(b'"image_id":1', b'"image_id":1e999'), id="infinity"),
        pytest.param(OURS.replace(b'"image_id":1', b'"image_id":123456789012345678901234567890'), id="a long number"),
        pytest.param(OURS.replace(b'"image_id":1', b'"image_id": 1.50, "image_id":2'), id="a key twice"),
        pytest.param(OURS.replace(b'"id":2', b'"id":"2"'), id="an id that is none"),
        pytest.param(OURS.replace(b'"id":2', b'"id":"2"').replace(b"{}]", b"{]"), id="that, and damage behind it"),
        pytest.param(OURS.replace(b"{}", b"[" * 300 + b"]" * 300), id="nested too deep to write"),
        pytest.param(OURS.replace(b"{}", b"[" * 2000 + b"]" * 2000), id="nested too deep to read"),
        pytest.param(OURS.replace(b"{", b'{"a":' + b"[" * 300 + b"]" * 300 + b",", 1), id="a head nested too deep"),
        pytest.param(b'{"info":{"hulldown_runs":[{"key":"a"}]},' + OURS[1:], id="a run that lacks what it set aside"),
        pytest.param(b'{"info":{"hulldown_runs":7},' + OURS[1:], id="runs that are none"),
        pytest.param(OURS.replace(b"\n", b"\r\n"), id="lines of another system"),
        pytest.param(b"", id="nothing"),
    ],
)
def test_by_line_says_what_the_whole_says(tmp_path, monkeypatch, content):
    (tmp_path / "annotations.json").write_bytes(content)
    assert outcome(tmp_path) == whole(tmp_path, monkeypatch)
