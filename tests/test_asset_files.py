"""Asset files on a cluster's workers: used in place if equal to the client's, otherwise copied; only readable files."""

import hashlib
from dataclasses import replace
from pathlib import Path

import pytest

from hulldown.base.errors import AssetError
from hulldown.base.outside import sha256_of
from hulldown.rendering.asset_files import AssetCache, ClientFiles, FileNote, references
from hulldown.tests.render_plans import cube_library


def note(path):
    return FileNote(str(path), sha256_of(path), path.stat().st_size)


@pytest.fixture
def textured(tmp_path):
    """An asset, its texture above it, and a worker's cache."""
    blend, texture = tmp_path / "client" / "field.blend", tmp_path / "textures" / "bark.png"
    for path, content in ((blend, b"grass"), (texture, b"brown")):
        path.parent.mkdir()
        path.write_bytes(content)
    return (note(blend), note(texture)), AssetCache(tmp_path / "sent", "plan")


def send(cache, asset):
    """Overwrite the client's files, and send the worker what it lacks."""
    contents = {file.sha256: Path(file.path).read_bytes() for file in asset}
    for file in asset:
        Path(file.path).write_bytes(b"another")
    for digest in cache.lacking(asset):
        assert cache.keep(contents[digest]) == digest
    assert cache.lacking(asset) == []


def test_files_at_the_clients_paths_are_used(textured):
    asset, cache = textured
    assert cache.lacking(asset) == []
    assert str(cache.place(asset)) == asset[0].path
    assert list(cache.tree.iterdir()) == []


def test_copies_have_the_clients_relative_paths(textured):
    asset, cache = textured
    send(cache, asset)
    place = cache.place(asset)
    assert place.read_bytes() == b"grass"
    assert (place.parent / "../textures/bark.png").read_bytes() == b"brown"
    assert place.is_relative_to(cache.tree)
    assert AssetCache(cache.contents, "plan").place(asset) == place


@pytest.mark.parametrize("what", ["the link", "the content"])
def test_a_changed_copy_is_replaced(textured, what):
    asset, cache = textured
    send(cache, asset)
    texture = cache.place(asset).parent / "../textures/bark.png"
    if what == "the link":
        texture.unlink()
        texture.write_bytes(b"black")
    else:
        texture.write_bytes(b"black")
        assert cache.lacking(asset) == [hashlib.sha256(b"brown").hexdigest()]
        cache.keep(b"brown")
    cache.place(asset)
    assert texture.read_bytes() == b"brown"


def test_a_path_with_detours_is_refused(textured):
    asset, cache = textured
    send(cache, asset)
    with pytest.raises(ValueError, match="without detours"):
        cache.place((replace(asset[0], path="/client/../../field.blend"), asset[1]))


def test_tiles_and_detours_of_references_are_found(tmp_path):
    for name in ("bark.1001.png", "bark.1002.png", "bark.txt"):
        (tmp_path / name).touch()
    named = [str(tmp_path / "x" / ".." / "bark.<UDIM>.png"), str(tmp_path / "bark.1001.png"), str(tmp_path / "gone")]
    found = [tmp_path / "bark.1001.png", tmp_path / "bark.1002.png"]
    assert references(named, tmp_path / "a.blend", [tmp_path]) == found
    assert references([str(tmp_path / "bark.txt")], tmp_path / "bark.txt", [tmp_path]) == []


@pytest.fixture
def curious(tmp_path):
    """A scenery that refers to its texture, to a secret elsewhere, and to a link to that."""
    folder, secret = tmp_path / "pack" / "worlds" / "a", tmp_path / "secrets" / "passwords"
    for path in (secret, folder / "void.blend", folder / "bark.png", folder / "cube.blend", folder / "sky.exr"):
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(path.name)
    (folder / "link.png").symlink_to(secret)
    named = (folder / "bark.png", secret, folder / "link.png", folder / "../../../secrets/passwords")
    library = cube_library(folder)
    void = replace(library.sceneries["void"], files=tuple(map(str, named)))
    return replace(library, sceneries={"void": void}), folder, secret


@pytest.mark.parametrize("added", [False, True])
def test_a_blend_cannot_choose_what_is_sent_and_read_unless_the_user_adds_its_folder(curious, monkeypatch, added):
    """It could name a password file, which was sent to the workers, and whose folder its Blender could read."""
    library, folder, secret = curious
    if added:
        monkeypatch.setenv("HULLDOWN_READ", str(secret.parent))
    files = ClientFiles(library)
    sent = {file.path for file in files.assets[str(folder / "void.blend")][1:]}
    assert sent == {str(folder / "bark.png"), *([str(secret), str(folder / "link.png")] if added else [])}
    assert folder in files.readable
    assert any(secret.is_relative_to(path) for path in files.readable) == added


@pytest.mark.parametrize("change", [lambda sky: sky.write_bytes(b"other light"), lambda sky: sky.unlink()])
def test_a_file_changed_or_deleted_before_it_is_sent_is_named(curious, change):
    library, folder, _ = curious
    files, sky = ClientFiles(library), folder / "sky.exr"
    digest = sha256_of(sky)
    assert files.content(digest) == b"sky.exr"
    change(sky)
    with pytest.raises(AssetError, match=r"sky\.exr.*restore it"):
        files.content(digest)
