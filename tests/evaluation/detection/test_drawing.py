import numpy as np
import pytest

from gsrain_engine.evaluation.detection.detector import Detection
from gsrain_engine.evaluation.detection.drawing import class_color, draw_boxes

PICTURE = np.full((360, 640, 3), 90, np.uint8)
BOX = (200.0, 120.0, 400.0, 280.0)
RED = (255, 60, 60)


def _has(picture: np.ndarray, color: tuple[int, int, int]) -> bool:
    return bool((picture == np.array(color, np.uint8)).all(axis=-1).any())


def test_a_detection_has_its_box_and_tag_in_the_colour_of_its_class():
    before = PICTURE.copy()
    picture = draw_boxes(PICTURE, [], [Detection("car", 0.9, BOX), Detection("person", 0.1, (0, 0, 50, 50))])
    assert np.array_equal(PICTURE, before)
    assert tuple(picture[200, 200]) == class_color("car") == tuple(picture[280, 300])
    assert tuple(picture[116, 201]) == class_color("car")  # the plate of the tag
    assert np.array_equal(picture[125:275, 205:395], PICTURE[125:275, 205:395])
    assert not _has(picture, class_color("person"))


def test_a_label_is_red_where_it_was_missed_and_white_where_found():
    label = Detection("car", 1.0, BOX)
    missed = draw_boxes(PICTURE, [label], [])
    flipped = draw_boxes(PICTURE, [label], [Detection("truck", 0.8, BOX)])
    found = draw_boxes(PICTURE, [label], [Detection("car", 0.8, (206, 120, 400, 270))])
    assert _has(missed, RED) and _has(flipped, RED) and not _has(found, RED)
    assert _has(found, (255, 255, 255)) and not _has(missed, (255, 255, 255))
    assert not np.array_equal(missed, flipped)


@pytest.mark.parametrize("box", [(-50.0, -40.0, 700.0, 400.0), (630.0, 0.0, 640.0, 8.0), (600.0, 350.0, 640.0, 360.0)])
def test_tags_stay_in_the_picture(box: tuple[float, float, float, float]):
    picture = draw_boxes(PICTURE, [], [Detection("traffic light", 0.9, box)])
    plate = (picture == np.array(class_color("traffic light"), np.uint8)).all(axis=-1)
    assert plate.any(axis=0).sum() > 60  # as wide as its words
    assert picture.shape == PICTURE.shape


def test_tags_do_not_cover_each_other():
    alone = draw_boxes(PICTURE, [], [Detection("car", 0.9, BOX)])
    both = draw_boxes(PICTURE, [], [Detection("car", 0.9, BOX), Detection("truck", 0.5, (200, 121, 398, 279))])
    assert np.array_equal(alone[105:118], both[105:118])
    assert _has(both[283:], class_color("truck"))
