"""`hulldown predict` with the small network on random weights."""

import json
import os

import cv2
import numpy as np
import pytest
import torch
from PIL import Image

from hulldown.base.errors import DatasetError, HulldownError
from hulldown.cli import main
from hulldown.tests.builders.editing import edit, write_dataset
from hulldown.tests.builders.networks import RUN, write_small_weights
from hulldown.training.detectors.detector import Detections, find_weights
from hulldown.training.detectors.tiled import TiledDetector
from hulldown.training.evaluation.labels import read_labels
from hulldown.training.evaluation.predictions import read_predictions
from hulldown.training.input_pictures import find_pictures
from hulldown.training.predict import UNFINISHED_SUFFIX, predict_detections


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A finished run whose untrained network finds something almost everywhere."""
    folder = tmp_path_factory.mktemp("run")
    torch.manual_seed(0)
    write_small_weights(folder / "weights")
    (folder / "run.json").write_text(json.dumps(RUN))
    return folder


@pytest.fixture
def data(tmp_path):
    """Five pictures of two sizes; the last one is black."""
    rng = np.random.default_rng(0)
    images = [{"file_name": f"images/{k + 1}.png", "width": 96 - 16 * (k % 2), "height": 54} for k in range(5)]
    folder = write_dataset(tmp_path / "data", images, names=("tank", "truck"))
    for image in images[:4]:
        pixels = rng.integers(0, 255, (54, image["width"], 3), dtype=np.uint8)
        Image.fromarray(pixels).save(folder / image["file_name"])
    Image.new("RGB", (96, 54)).save(folder / images[4]["file_name"])
    return folder


def test_results_are_cocos_with_classes_by_name(run, data, tmp_path):
    output = tmp_path / "found.json"
    done = predict_detections(run, data, output, batch=2)
    found = json.loads(output.read_text())
    assert (done.images, done.detections, done.already, done.unknown) == (5, len(found), 0, ())
    assert len(found) > 5
    assert {tuple(one) for one in found} == {("image_id", "category_id", "bbox", "score")}
    assert {one["category_id"] for one in found} <= {1, 2}
    assert json.loads((tmp_path / "found.json.info.json").read_text())["images"] == [1, 2, 3, 4, 5]
    assert len(read_predictions(output, read_labels(data)).score) == len(found)
    assert not (tmp_path / f"found.json{UNFINISHED_SUFFIX}").exists()


def test_an_interrupted_prediction_continues_to_the_same_results(run, data, tmp_path):
    predict_detections(run, data, tmp_path / "whole.json", batch=1)
    picture = data / "images" / "4.png"
    kept = picture.read_bytes()
    picture.write_bytes(kept[:50])
    output = tmp_path / "parts.json"
    with pytest.raises(DatasetError, match=r"4\.png: cannot be read as a picture"):
        predict_detections(run, data, output, batch=1)
    assert not output.exists()
    unfinished = tmp_path / f"parts.json{UNFINISHED_SUFFIX}"
    with unfinished.open("ab") as file:
        file.write(b'[4,[{"image_id":4')  # as after a crash of the machine
    picture.write_bytes(kept)
    assert predict_detections(run, data, output, batch=1).already == 3
    assert output.read_bytes() == (tmp_path / "whole.json").read_bytes()
    unfinished.write_text('"other weights"\n[1,null,[]]\n')
    assert predict_detections(run, data, output).already == 0


def test_a_class_that_the_dataset_lacks_gets_an_id_and_keeps_its_name(run, data, tmp_path):
    edit(data, lambda coco: coco.update(categories=[{"id": 1, "name": "tank"}]))
    output = tmp_path / "found.json"
    assert predict_detections(run, data, output).unknown == ("truck",)
    assert read_predictions(output, read_labels(data)).class_names[:2] == ("tank", "truck")


def test_a_dataset_with_other_classes_is_refused_with_both_lists(run, data, tmp_path):
    edit(data, lambda coco: coco.update(categories=[{"id": 1, "name": "Tank"}]))
    with pytest.raises(HulldownError, match="it has Tank; the detector knows truck, tank"):
        predict_detections(run, data, tmp_path / "found.json")
    assert list(tmp_path.iterdir()) == [data]


@pytest.mark.parametrize(
    ("command", "named"),
    [
        ("train --data real=none -o run --model small", "none"),
        ("train --data real=none -o run --model huge", "huge"),
        ("predict . data -o found.json", "is a folder, not a run"),
    ],
)
def test_a_mistake_is_a_one_line_error(data, tmp_path, monkeypatch, capsys, command, named):
    monkeypatch.chdir(tmp_path)
    assert main(command.split()) == 2
    shown = capsys.readouterr()
    assert (shown.out, shown.err.count("\n"), list(tmp_path.iterdir())) == ("", 1, [data])
    assert named in shown.err


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"status": "done"}, r"'done' - at `\$\.status`"),
        ({"steps": 0.5}, r"\$\.steps"),
        ({"figures": {"seconds": "long"}}, r"\$\.figures\.seconds"),
        ({"sources": {"real": {}}}, r"missing required field `folder` - at `\$\.sources"),
    ],
)
def test_a_wrong_run_json_is_refused_with_file_and_key(tmp_path, changes, named):
    (tmp_path / "run.json").write_text(json.dumps(RUN | changes))
    with pytest.raises(HulldownError, match=rf"run\.json: isn't a hulldown run \(.*{named}.*; name a folder of"):
        find_weights(tmp_path)


@pytest.fixture
def video(tmp_path):
    """A video of five frames, each darker than the previous one."""
    path = tmp_path / "clip.mp4"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"mp4v"), 10.0, (96, 54))
    for k in range(5):
        writer.write(np.full((54, 96, 3), 200 - 40 * k, dtype=np.uint8))
    writer.release()
    return path


@pytest.mark.parametrize("what", ["folder", "pattern", "one", "several", "video"])
def test_pictures_need_no_records(run, data, video, tmp_path, what):
    (data / "annotations.json").unlink()
    names = sorted((data / "images").iterdir())
    given = {"folder": data, "pattern": f"{data}/**/*.png", "one": names[0], "several": names[:2], "video": video}[what]
    done = predict_detections(run / "weights", given, tmp_path / "found.json", drawn=tmp_path / "drawn", threshold=0.1)
    found = json.loads((tmp_path / "found.json").read_text())
    info = json.loads((tmp_path / "found.json.info.json").read_text())
    count = {"one": 1, "several": 2}.get(what, 5)
    assert (done.images, info["images"]) == (count, list(range(1, count + 1)))
    assert {one["image_id"] for one in found} <= set(info["images"])
    assert info["categories"] == [{"id": 1, "name": "truck"}, {"id": 2, "name": "tank"}]
    assert done.counts["truck"] == sum(one["score"] >= 0.1 and one["category_id"] == 1 for one in found)
    drawn = sorted(path.name for path in (tmp_path / "drawn").rglob("[!.]*.*"))
    assert drawn == ["clip.mp4"] if what == "video" else drawn == [path.name for path in names[:count]]
    assert [record["file_name"].rpartition("/")[2] for record in info["pictures"]] == (
        ["clip.mp4"] * 5 if what == "video" else drawn
    )


def test_a_video_is_read_by_frame_and_drawn_as_a_video(run, video, tmp_path):
    frames = list(find_pictures([video]).read([0, 2, 4]))
    assert [round(float(frame.mean()), -1) for frame in frames] == [200, 120, 40]
    predict_detections(run, video, tmp_path / "found.json", drawn=tmp_path / "drawn", threshold=0.0)
    drawn = list(find_pictures([tmp_path / "drawn" / "clip.mp4"]).read(range(5)))
    assert len(drawn) == 5
    assert all(picture.std() > 5 for picture in drawn)  # boxes on frames of one gray


def test_a_damaged_video_names_its_lost_frames_and_a_playlist_is_refused(video, tmp_path, capfd):
    content = bytearray(video.read_bytes())
    frames = [at for at in range(len(content)) if content.startswith(b"\0\0\1\xb6", at)]
    content[frames[2] : frames[3]] = bytes(frames[3] - frames[2])
    video.write_bytes(content)
    with pytest.warns(UserWarning, match=r"is damaged: \d frames were read, \d of 5 are lost"):
        assert len(find_pictures([video]).images) < 5
    assert capfd.readouterr() == ("", "")  # FFmpeg's messages
    (tmp_path / "list.mp4").write_text(f"#EXTM3U\n#EXT-X-TARGETDURATION:1\n#EXTINF:1,\nfile://{video}\n#EXT-X-ENDLIST\n")
    with pytest.raises(DatasetError, match="isn't a video"):
        find_pictures([tmp_path / "list.mp4"])


@pytest.mark.parametrize(
    ("name", "content", "kind"),
    [
        ("a.pt", b"\x89PNG\r\n\x1a\n", "a PNG picture"), ("b.pt", b'{"a": 1}', "a JSON file"), ("c.pth", b"", "empty"),
        ("d.onnx", b"\x08\x07", ".onnx"), ("e.ckpt", b"hello", "unknown"), ("f.pt", b"PK\x03\x04", "PyTorch"),
        ("g.pth", b"PK\x03\x04 no archive", "not the weights"), ("h.pth", os.urandom(300), "not the weights"),
        ("i.pth", b"\x80\xba" + bytes(300), "not the weights"),
    ],
)  # fmt: skip
def test_a_file_without_weights_is_named_with_its_type(data, tmp_path, name, content, kind):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(HulldownError, match=kind) as caught:
        predict_detections(tmp_path / name, data, tmp_path / "found.json")
    assert "weights_only" not in str(caught.value)


@pytest.mark.parametrize("given", ["nothing/*.jpg", "text.txt", "empty"])
def test_files_that_are_not_pictures_are_refused(run, tmp_path, monkeypatch, given):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "text.txt").write_text("no picture")
    (tmp_path / "empty").mkdir()
    with pytest.raises(HulldownError, match="picture"):
        predict_detections(run, given, tmp_path / "found.json")


def test_the_command_counts_and_draws_detections(run, data, tmp_path, capsys):
    arguments = [str(data / "images"), "-o", str(tmp_path / "f.json"), "--draw", str(tmp_path / "drawn")]
    assert main(["predict", str(run), *arguments, "--threshold", "0.1", "--device", "cpu", "--json"]) == 0
    answer = capsys.readouterr()
    assert json.loads(answer.out)["images"] == 5
    assert "truck" in answer.err
    assert len(list((tmp_path / "drawn").glob("[!.]*"))) == 5


class BrightSquares:
    """Finds the bright pixels of a picture as one object, as a network that sees small pictures alone."""

    classes = ("lamp",)

    def detect(self, images):
        found = []
        for image in images:
            assert image.shape[:2] == (48, 64)
            rows, columns = np.nonzero(image[..., 0] > 200)
            box = [[columns.min(), rows.min(), np.ptp(columns) + 1, np.ptp(rows) + 1]] if len(rows) else []
            score = np.minimum(1.0, np.array([len(rows) / 100] if len(rows) else []))
            found.append(Detections(np.array(box, dtype=float).reshape(-1, 4), score, np.zeros(len(box), dtype=int)))
        return found


def test_tiles_find_an_object_once_and_whole_although_edges_cut_it():
    picture = np.zeros((150, 201, 3), dtype=np.uint8)
    boxes = [[180, 140, 10, 10], [44, 30, 10, 10], [5, 100, 8, 8]]  # the second is cut by two tiles' edges
    for x, y, width, height in boxes:
        picture[y : y + height, x : x + width] = 255
    found, nothing = TiledDetector(BrightSquares(), (64, 48), batch=4).detect([picture, 0 * picture])
    assert sorted(found.xywh.tolist()) == sorted(boxes)
    assert (np.diff(found.score) <= 0).all()
    assert nothing.xywh.shape == (0, 4)


def test_tiles_are_part_of_the_key_of_results(run, data, tmp_path):
    words = ["predict", str(run), str(data), "-o", str(tmp_path / "tiles.json"), "--device", "cpu"]
    assert main([*words, "--tile", "64x48"]) == 0
    assert json.loads((tmp_path / "tiles.json").read_text())
