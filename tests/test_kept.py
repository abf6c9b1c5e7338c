"""A node's files: used where they lie if they are what is meant, otherwise copies that were held against their hash."""

import hashlib

import pytest

from geometry.errors import AssetError
from render import sent
from render.kept import Kept
from render.parcels import AssetNote, Piece
from render.sent import note, pieces, references


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
    monkeypatch.setattr(sent, "PIECE", 2)
    path, parts = tmp_path / "client" / "field.blend", list(pieces([asset.file]))
    assert len(parts) == 3
    path.write_bytes(content) if content else path.unlink()
    node = Kept(tmp_path / "sent")
    for piece in parts:
        assert node.lacking(asset) == [asset.file.sha256]
        node.keep(piece)
    assert node.lacking(asset) == []
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
    assert node.lacking(asset) == [asset.file.sha256]


@pytest.fixture
def textured(asset, tmp_path):
    """An asset in client/, its texture above it, both gone from there; and a node that was sent them."""
    texture = tmp_path / "textures" / "bark.png"
    texture.parent.mkdir()
    texture.write_bytes(b"brown")
    asset = AssetNote(asset.file, [note(texture)])
    node = Kept(tmp_path / "sent")
    parts = list(pieces(asset.files))
    assert node.place(asset) == tmp_path / "client" / "field.blend"
    texture.unlink()
    assert node.lacking(asset) == [asset.references[0].sha256]
    (tmp_path / "client" / "field.blend").unlink()
    assert node.lacking(asset) == [file.sha256 for file in asset.files]
    for piece in parts:
        node.keep(piece)
    assert node.lacking(asset) == []
    return asset, node


def test_what_an_asset_refers_to_lies_to_it_as_it_did(textured):
    asset, node = textured
    place = node.place(asset)
    assert place.read_bytes() == b"grass"
    assert (place.parent / "../textures/bark.png").read_bytes() == b"brown"
    assert place.is_relative_to(node.folder)
    assert node.readable(asset) == [node.folder]
    again = Kept(node.folder)
    assert again.place(asset) == place


def test_a_texture_that_was_changed_on_a_node_is_put_right(textured):
    asset, node = textured
    place = node.place(asset)
    texture = place.parent / "../textures/bark.png"
    texture.unlink()
    texture.write_bytes(b"black")
    assert node.place(asset).read_bytes() == b"grass"
    assert texture.read_bytes() == b"brown"


def test_tiles_and_detours_of_references_are_found(tmp_path):
    for name in ("bark.1001.png", "bark.1002.png", "bark.txt"):
        (tmp_path / name).touch()
    named = [str(tmp_path / "x" / ".." / "bark.<UDIM>.png"), str(tmp_path / "bark.1001.png"), str(tmp_path / "gone")]
    assert references(named, tmp_path / "a.blend") == [tmp_path / "bark.1001.png", tmp_path / "bark.1002.png"]
    assert references([str(tmp_path / "bark.txt")], tmp_path / "bark.txt") == []
