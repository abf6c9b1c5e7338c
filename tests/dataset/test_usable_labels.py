"""Lower limits of labels in a finished dataset, and images that must have no labels."""

import pytest

from hulldown.annotate.records import Label
from hulldown.dataset.record_checks import find_label_problems, sound_images_by_id
from hulldown.dataset.usable_labels import LabelFloors

OF = {"image_id": 7, "category_id": 1}
LABELS = [
    {**OF, "id": 1, "bbox": [0, 0, 40, 20], "visible_fraction": 0.9, "truncated_fraction": 0.0, "iscrowd": 0},
    {**OF, "id": 2, "bbox": [0, 0, 0.8, 2.4], "visible_fraction": 1.0, "truncated_fraction": 0.95, "iscrowd": 0},
    {**OF, "id": 3, "bbox": [0, 0, 40, 20], "visible_fraction": 0.1, "iscrowd": 0},
    {**OF, "id": 4, "bbox": [0, 0, 40, 20]},  # for a photograph
    {**OF, "id": 5, "bbox": [0, 0, 40, 20], "iscrowd": 1},
]


@pytest.mark.parametrize(
    ("floors", "crowds", "left"),
    [
        ({}, [5], [1, 2, 3, 4, 5]),
        ({"min_box_px": 0.8}, [5], [1, 2, 3, 4, 5]),
        ({"min_box_px": 1.0}, [2, 5], [1, 2, 3, 4, 5]),
        ({"min_visible_fraction": 0.3}, [3, 5], [1, 2, 3, 4, 5]),
        ({"max_truncated_fraction": 0.5}, [2, 5], [1, 2, 3, 4, 5]),
        ({"min_box_px": 21.0}, [1, 2, 3, 4, 5], [1, 2, 3, 4, 5]),
        ({"min_visible_fraction": 0.3, "max_truncated_fraction": 0.5, "below": "left_out"}, [], [1, 4]),
    ],
)
def test_labels_below_the_limits_are_ignored_or_left_out(floors, crowds, left):
    kept = LabelFloors(**floors).kept_labels(Label.from_record(label, {}) for label in LABELS)
    assert [label.id for label in kept] == left
    assert [label.id for label in kept if label.crowd] == crowds
    assert floors or [label.record for label in kept] == LABELS


def test_a_label_on_a_background_is_found():
    image = {"id": 7, "file_name": "images/7.png", "width": 64, "height": 64, "background": True}
    coco = {"images": [image], "categories": [{"id": 1, "name": "tank"}], "annotations": LABELS[3:]}
    findings = [str(finding) for finding in find_label_problems(coco["categories"], sound_images_by_id(coco).values())]
    assert findings[0] == "error: images/7.png: annotation 4: is a label on a background, an image without targets"
    assert not any("annotation 5: is a label" in finding for finding in findings)
