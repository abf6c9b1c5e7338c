"""A node's files: used where they lie if they are what is meant, otherwise copies that were held against their hash."""

import hashlib

import pytest

from geometry.errors import AssetError
from render import kept
from render.kept import Kept, note, pieces
from render.parcels import AssetNote, Piece


@pytest.fixture
def asset(tmp_path):
    path = tmp_path / "client" / "field.blend"
    path.parent.mkdir()
    path.write_bytes(b"grass")
    return AssetNote(note(path))


def test_a_file_that_lies_where_the_client_has_it_is_used(asset, tmp_path):
    assert str(Kept(tmp_path / "sent").place(asset)) == asset.file.path
    assert not (tmp_path / "sent").exists()


@pytest.mark.parametrize("content", [None, b"stone", b"grass and more"])
def test_what_is_missing_or_another_file_is_sent_in_pieces(asset, tmp_path, monkeypatch, content):
    monkeypatch.setattr(kept, "PIECE", 2)
    path, sent = tmp_path / "client" / "field.blend", list(pieces([asset.file]))
    assert len(sent) == 3
    path.write_bytes(content) if content else path.unlink()
    node = Kept(tmp_path / "sent")
    for piece in sent:
        assert node.place(asset) is None
        node.keep(piece)
    place = node.place(asset)
    assert place == tmp_path / "sent" / hashlib.sha256(b"grass").hexdigest()
    assert place.read_bytes() == b"grass"


def test_a_file_that_is_not_the_one_of_its_hash_is_not_kept(asset, tmp_path):
    node = Kept(tmp_path / "sent")
    with pytest.raises(AssetError, match="is not the one of SHA-256"):
        node.keep(Piece(asset.file.sha256, 0, 5, b"stone"))
    assert list((tmp_path / "sent").iterdir()) == []


def test_a_copy_that_was_changed_is_sent_again(asset, tmp_path):
    node = Kept(tmp_path / "sent")
    node.keep(Piece(asset.file.sha256, 0, 5, b"grass"))
    (tmp_path / "client" / "field.blend").unlink()
    copy = node.place(asset)
    copy.write_bytes(b"gross")
    assert node.place(asset) is None


def test_a_texture_that_is_not_there_is_named(asset, tmp_path):
    texture = tmp_path / "client" / "bark.png"
    texture.write_bytes(b"brown")
    asset = AssetNote(asset.file, [note(texture)])
    assert Kept(tmp_path / "sent").place(asset) is not None
    texture.unlink()
    with pytest.raises(AssetError, match=r"lacks .*bark.png, which field.blend refers to"):
        Kept(tmp_path / "sent").place(asset)
