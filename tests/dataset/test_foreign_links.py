"""Links in other people's datasets: followed inside, and outside only where the user allows it."""

import os

import pytest
from PIL import Image

from hulldown.base.errors import DatasetError
from hulldown.dataset.exports.export import export_dataset
from hulldown.dataset.join import join_datasets
from hulldown.render.verify import verify_dataset
from hulldown.tests.builders.editing import write_dataset


@pytest.fixture
def foreign(tmp_path):
    """Somebody's dataset, with a file of the user next to it."""
    folder = tmp_path / "theirs"
    write_dataset(folder, [{"file_name": "images/1.png"}])
    (folder / "images/1.png").rename(folder / "images/0.png")
    (tmp_path / "mine").mkdir()
    Image.new("RGB", (32, 24), (9, 9, 9)).save(tmp_path / "mine/secret.png")
    return folder


def exported(folder, out, **options):
    export_dataset(folder, out, fractions=(1.0, 0.0, 0.0), **options)
    return out / "train/1.png"


def joined(folder, out, **options):
    join_datasets([folder], out, **options)
    return out / "images/1.png"


def a_link(folder):
    (folder / "images/1.png").symlink_to("../../mine/secret.png")


def a_link_to_a_link(folder):
    (folder / "2.png").symlink_to("../mine/secret.png")
    (folder / "images/1.png").symlink_to("../2.png")


def a_linked_folder(folder):
    (folder / "images").rename(folder / "was")
    os.link(folder / "../mine/secret.png", folder / "../mine/1.png")
    (folder / "images").symlink_to("../mine")


@pytest.mark.parametrize("made", [exported, joined])
@pytest.mark.parametrize("lead_out", [a_link, a_link_to_a_link, a_linked_folder])
def test_a_link_out_of_a_dataset_is_followed_only_where_allowed(foreign, tmp_path, made, lead_out):
    lead_out(foreign)
    with pytest.raises(DatasetError, match=r"1\.png: is a link that leads out of its dataset, to .*mine") as refused:
        made(foreign, tmp_path / "out")
    assert f"--allow-links {tmp_path.resolve() / 'mine'}" in str(refused.value)
    assert not (tmp_path / "out").exists()
    picture = made(foreign, tmp_path / "out", allow_links=[tmp_path / "mine"])
    assert not picture.is_symlink()
    assert picture.read_bytes() == (tmp_path / "mine/secret.png").read_bytes()


@pytest.mark.parametrize("made", [exported, joined])
def test_a_link_inside_a_dataset_is_followed(foreign, tmp_path, made):
    (foreign / "images/1.png").symlink_to("0.png")
    assert made(foreign, tmp_path / "out").samefile(foreign / "images/0.png")


@pytest.mark.parametrize("made", [exported, joined])
def test_circular_links_and_pipes_are_one_line_errors(foreign, tmp_path, made):
    (foreign / "images/1.png").symlink_to("1.png")
    with pytest.raises(DatasetError, match=r"1\.png(:| cannot be) .*(symbolic links|loop)"):
        made(foreign, tmp_path / "out")
    (foreign / "images/1.png").unlink()
    os.mkfifo(foreign / "images/1.png")
    with pytest.raises(DatasetError, match=r"1\.png(:| cannot be) .*isn't a regular file"):
        made(foreign, tmp_path / "out")
    assert "isn't a regular file" in verify_dataset(foreign)[0].problem
