"""Detection in rain: scores, tables, figures and drawn boxes."""

import numpy as np
import pytest

from gsrain_engine.evaluation.detection.detector import Detection
from gsrain_engine.evaluation.detection.drawing import class_color, draw_boxes, draw_truths, free_plate
from gsrain_engine.evaluation.detection.figures import (
    detection_sheet,
    object_figure,
    precision_figure,
)
from gsrain_engine.evaluation.detection.ground_truth import LabeledObject
from gsrain_engine.evaluation.detection.run import (
    Condition,
    EvaluatedFrame,
    EvaluatedImage,
    evaluate_detections,
    object_rows,
)
from gsrain_engine.evaluation.detection.summary import (
    distance_scores,
    plain,
    robustness_of,
    scores,
    scores_table,
    silent_detectors,
    write_csv,
    write_parquet,
)
from gsrain_engine.render.view import RenderView
from gsrain_engine.report.charts import series_styles, shades
from gsrain_engine.scene.camera import Camera

pytest.importorskip("pycocotools")

NEAR = LabeledObject("near", "car", (0.0, 0.0, 40.0, 40.0), distance_m=8.0)
FAR = LabeledObject("far", "car", (50.0, 0.0, 80.0, 20.0), distance_m=35.0)
FRAME = EvaluatedFrame("f", RenderView(Camera(100, 100, 50.0, 50.0, 50.0, 50.0)), (NEAR, FAR))


def found(kind, rate, seeds, near, far):
    """Evaluate an image in which the cars are found with these confidences; 0 is a miss."""
    detections = [
        Detection("car", confidence, each.box_xyxy) for each, confidence in ((NEAR, near), (FAR, far)) if confidence
    ]
    return evaluate_detections("d", FRAME, Condition(kind, rate, seeds), detections)


@pytest.fixture(scope="module")
def judgements():
    return [
        found("clear", 0.0, (0, 1), 0.9, 0.7),
        found("rainy", 8.5, (0,), 0.8, 0.4),
        found("rainy", 8.5, (1,), 0.8, 0.0),
    ]


@pytest.fixture(scope="module")
def rows(judgements):
    return [row for each in judgements for row in object_rows(each)]


def test_a_detector_is_silent_that_finds_nothing_without_rain(judgements):
    assert silent_detectors(judgements) == []
    for kind in ("clear", "original"):
        assert silent_detectors([found(kind, 0.0, (0,), 0.2, 0), *judgements[1:]]) == ["d"]
    assert silent_detectors([found("clear", 0.0, (0,), 0, 0), found("original", 0.0, (0,), 0, 0.3)]) == []
    assert silent_detectors(judgements[1:]) == []  # nothing was drawn without rain


def spread(score):
    return score.value, score.low, score.high


def test_scores_are_means_over_objects_with_the_range_of_the_seeds(rows, judgements):
    clear, rainy = scores(rows, judgements)
    assert spread(clear.confidence) == pytest.approx((0.8, 0.8, 0.8))
    assert spread(rainy.confidence) == pytest.approx((0.5, 0.4, 0.6))
    assert (clear.recall.value, rainy.recall.value) == (1.0, 0.75)
    assert clear.objects == rainy.objects == 2
    assert clear.map50.value == rainy.map50.high == pytest.approx(1.0)
    assert rainy.map50.low == pytest.approx(51 / 101)  # one of two: precision 1 up to a recall of 0.5
    assert clear.change is None and rainy.change.value == pytest.approx(-0.3)
    left = robustness_of([clear, rainy])["d"]
    assert left.mpc == left.rpc == pytest.approx((1 + 51 / 101) / 2)


def test_changes_have_an_interval_over_objects_and_seeds(judgements, rows):
    """Near and far lose 0.1 and 0.3 with one seed, 0.1 and 0.7 with the other."""
    change = scores(rows, judgements)[1].change
    assert spread(change) == pytest.approx((-0.3, -0.7, -0.1)) and (change.over, change.n) == ("objects", 2)
    scene_of_frame = scores(rows, judgements, {"f": "one"})[1].change
    assert scene_of_frame == change == scores(rows, judgements)[1].change
    table = scores_table(scores(rows, judgements))
    assert "Fewer than 10 objects (2)" in table.caption
    assert any("change: bootstrap over objects and rain seeds, 95 %, over 2 objects" in note for note in table.notes)
    assert any("confidence: lowest to highest, over 2 rain seeds" in note for note in table.notes)


def test_frames_of_several_scenes_are_clusters():
    places = [EvaluatedFrame(name, FRAME.shot, FRAME.truths) for name in "abc"]
    judged = []
    for frame, loss in zip(places, (0.0, 0.2, 0.4), strict=True):
        for kind, rate, sure in (("clear", 0.0, 0.9), ("rainy", 8.5, 0.9 - loss)):
            boxes = [Detection("car", sure, each.box_xyxy) for each in FRAME.truths]
            judged.append(evaluate_detections("d", frame, Condition(kind, rate, (0,)), boxes))
    rows = [row for each in judged for row in object_rows(each)]
    change = scores(rows, judged, {name: name for name in "abc"})[1].change
    assert spread(change) == pytest.approx((-0.2, -0.4, 0.0), abs=1e-9)
    assert (change.over, change.n) == ("objects of 3 scenes", 6)


def test_recall_by_distance_counts_clear_images_once(rows):
    bins = {(each.picture, each.recall.from_m): each.recall for each in distance_scores(rows)}
    expected = {("clear", 0): (1, 1), ("clear", 30): (1, 1), ("rainy", 0): (2, 2), ("rainy", 30): (2, 1)}
    assert {key: (each.objects, each.found) for key, each in bins.items()} == expected


def scored(*judgements):
    return scores([row for each in judgements for row in object_rows(each)], judgements)


def test_detectors_that_find_nothing_are_scored():
    clear, rainy = scored(found("clear", 0.0, (0,), 0, 0), found("rainy", 8.5, (0,), 0, 0))
    assert clear.map50.value == rainy.map50.value == 0.0
    assert np.isnan(robustness_of([clear, rainy])["d"].rpc)
    assert plain(rainy)["change"]["low"] == 0.0


def test_tables_have_the_names_of_the_contract(rows, tmp_path):
    write_csv(tmp_path / "rows.csv", rows)
    lines = (tmp_path / "rows.csv").read_text().splitlines()
    names = lines[0].split(",")
    assert {"detector", "intensity_mm_h", "seed", "frame", "object", "class", "confidence", "iou"} <= set(names)
    last = dict(zip(names, lines[-1].split(","), strict=True))
    assert (last["object"], last["confidence"], last["class_seen"]) == ("far", "0.0", "")
    parquet = pytest.importorskip("pyarrow.parquet")
    assert write_parquet(tmp_path / "rows.parquet", rows)
    assert parquet.read_table(tmp_path / "rows.parquet").to_pylist() == [row.plain() for row in rows]


def test_reconstructions_are_compared_with_their_photographs():
    both = [found("original", 0.0, (0, 1), 0.9, 0.8), found("clear", 0.0, (0, 1), 0.8, 0.7)]
    original, clear = scored(*both)
    assert original.change is None
    assert spread(clear.change) == pytest.approx((-0.1, -0.1, -0.1))
    rows = [row for each in both for row in object_rows(each)]
    marks = [line for line in object_figure(rows, "confidence").axes[0].get_lines() if line.get_marker() == "x"]
    assert sorted(line.get_ydata()[0] for line in marks) == pytest.approx([0.8, 0.9])
    assert len(precision_figure([original, clear]).axes[0].get_lines()) == 2


# Figures


def test_figures_have_means_and_bands_by_object(rows, judgements):
    figure = object_figure(rows, "confidence")
    (panel,) = figure.axes
    curves = {line.get_label(): line.get_ydata() for line in panel.get_lines()}
    np.testing.assert_allclose(curves["far: car, 35 m, 1 frame"], [0.7, 0.2])
    np.testing.assert_allclose(curves["mean of 2 objects"], [0.8, 0.5])
    _, far = panel.collections
    corners = far.get_paths()[0].vertices
    at_last = corners[corners[:, 0] == 8.5][:, 1]
    assert (at_last.min(), at_last.max()) == pytest.approx((0.0, 0.4))
    assert len(precision_figure(scores(rows, judgements)).axes) == 2
    assert len({style[:3] for style in series_styles(300)}) == 300
    lightness = [sum(color[:3]) for color in shades(5)]
    assert lightness == sorted(lightness, reverse=True) and shades(1) == shades(3)[1:2]


def test_sheets_of_many_conditions_continue_below():
    image = np.full((60, 300, 3), 90, np.uint8)
    trials = [Condition("rainy", float(rain), (0,)) for rain in range(1, 31)]
    sheet = detection_sheet([
        EvaluatedImage(FRAME, each, {"d": evaluate_detections("d", FRAME, each, [])}, lambda: image) for each in trials
    ])  # fmt: skip
    assert sheet.shape[1] <= 1920
    assert (sheet == 90).all(axis=2).sum() > 30 * 240 * 40


# Boxes on an image

PICTURE = np.full((360, 640, 3), 90, np.uint8)
BOX = (200.0, 120.0, 400.0, 280.0)
RED, WHITE = (255, 60, 60), (255, 255, 255)


def _has(picture: np.ndarray, color: tuple[int, int, int]) -> bool:
    return bool((picture == np.array(color, np.uint8)).all(axis=-1).any())


def test_detections_have_boxes_and_labels_in_the_color_of_their_class():
    found = [Detection("car", 0.9, BOX), Detection("truck", 0.5, (200, 121, 398, 279))]
    picture = draw_boxes(PICTURE, [], [*found[:1], Detection("person", 0.1, (0, 0, 50, 50))])
    assert not _has(PICTURE, class_color("car"))
    assert tuple(picture[200, 200]) == class_color("car") == tuple(picture[280, 300])
    assert tuple(picture[116, 201]) == class_color("car")  # behind the label
    assert np.array_equal(picture[125:275, 205:395], PICTURE[125:275, 205:395])
    assert not _has(picture, class_color("person"))
    both = draw_boxes(PICTURE, [], found)  # labels do not overlap
    assert np.array_equal(picture[105:118], both[105:118]) and _has(both[283:], class_color("truck"))


def test_labels_do_not_cover_each_other_and_stay_in_the_image():
    plates = []
    for number in range(40):  # as many boxes at nearly one place
        plate = free_plate((200.0 + number % 3, 5.0, 230.0, 40.0), (90, 18), plates, PICTURE.shape)
        assert plate is not None and plate[0] >= 0 and plate[2] <= 640 and plate[1] >= 0 and plate[3] <= 360
        plates.append(plate)
    covered = np.zeros(PICTURE.shape[:2], int)
    for left, top, right, bottom in plates:
        covered[top:bottom, left:right] += 1
    assert covered.max() == 1 and covered.sum() == 40 * 90 * 18
    assert plates[0][1] == 40 and abs(plates[4][1] - 40) <= 60  # below the box, and others near it
    assert free_plate(BOX, (90, 18), [(0, 0, 640, 360)], PICTURE.shape) is None


@pytest.mark.parametrize(
    ("detections", "has_red", "has_white"),
    [
        ([], True, False),
        ([Detection("truck", 0.8, BOX)], True, False),
        ([Detection("car", 0.8, (206, 120, 400, 270))], False, True),
    ],
)
def test_objects_are_red_if_missed_and_white_if_found(detections, has_red, has_white):
    picture = draw_boxes(PICTURE, [Detection("car", 1.0, BOX)], detections)
    assert (_has(picture, (255, 60, 60)), _has(picture, (255, 255, 255))) == (has_red, has_white)


def test_objects_are_dashed_along_all_four_edges():
    is_red = (draw_boxes(np.zeros_like(PICTURE), [Detection("car", 1.0, BOX)], []) == RED).all(axis=-1)
    left, top, right, bottom = map(int, BOX)
    for along in (is_red[top, left:right], is_red[bottom, left:right]):
        assert 0.35 < along.mean() < 0.65
    for along in (is_red[top:bottom, left], is_red[top:bottom, right]):
        assert 0.35 < along.mean() < 0.65


def test_ground_truth_has_boxes_and_names_in_the_color_of_their_class():
    picture = draw_truths(PICTURE, [Detection("car", 1.0, BOX)])
    assert tuple(picture[200, 200]) == tuple(picture[116, 201]) == class_color("car")
    assert not _has(picture, RED) and not _has(PICTURE, class_color("car"))


def test_a_car_that_is_taken_for_a_truck_is_marked_with_its_confidence():
    boxes = [Detection("truck", 0.6, FAR.box_xyxy), Detection("car", 0.8, NEAR.box_xyxy)]
    taken = evaluate_detections("d", FRAME, Condition("rainy", 12.0, (0,)), boxes)
    rows = [row for each in (found("clear", 0.0, (0,), 0.9, 0.7), taken) for row in object_rows(each)]
    assert [(row.object, row.class_seen, row.confidence) for row in rows if row.confidence == 0] == [
        ("far", "truck", 0)
    ]
    (panel,) = object_figure(rows, "confidence").axes
    (mark,) = (line for line in panel.get_lines() if line.get_marker() == "v")
    assert (mark.get_xdata()[0], mark.get_ydata()[0]) == (12.0, pytest.approx(0.6))
    assert [text.get_text() for text in panel.texts] == ["as truck"]
