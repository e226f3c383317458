"""Remaining detection quality at each intensity: scores, tables, figures and drawn boxes."""

import numpy as np
import pytest

from gsrain_engine.evaluation.detection.detector import Detection
from gsrain_engine.evaluation.detection.drawing import class_color, draw_boxes
from gsrain_engine.evaluation.detection.figures import (
    detection_sheet,
    figure_pixels,
    legend_columns,
    legend_width_in,
    object_figure,
    plotted_objects,
    precision_figure,
)
from gsrain_engine.evaluation.detection.ground_truth import LabeledObject
from gsrain_engine.evaluation.detection.run import (
    Condition,
    EvaluatedFrame,
    EvaluatedImage,
    ObjectRow,
    evaluate_detections,
    object_rows,
)
from gsrain_engine.evaluation.detection.summary import (
    SeedChange,
    distance_scores,
    plain,
    robustness_of,
    scores,
    write_csv,
    write_parquet,
)
from gsrain_engine.evaluation.report_charts import series_styles, shades
from gsrain_engine.render.draw import RenderView
from gsrain_engine.scene.camera import Camera

pytest.importorskip("pycocotools")

NEAR = LabeledObject("near", "car", (0.0, 0.0, 40.0, 40.0), distance_m=8.0)
FAR = LabeledObject("far", "car", (50.0, 0.0, 80.0, 20.0), distance_m=35.0)
FRAME = EvaluatedFrame("f", RenderView(Camera(100, 100, 50.0, 50.0, 50.0, 50.0)), (NEAR, FAR))


def found(kind, rate, seeds, near, far):
    """Judge a picture in which the cars are found with these confidences; 0 is a miss."""
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


def test_scores_are_means_over_objects_with_the_range_of_the_seeds(rows, judgements):
    clear, rainy = scores(rows, judgements)
    assert (clear.confidence.mean, clear.confidence.low, clear.confidence.high) == pytest.approx((0.8, 0.8, 0.8))
    assert (rainy.confidence.mean, rainy.confidence.low, rainy.confidence.high) == pytest.approx((0.5, 0.4, 0.6))
    assert (clear.recall.mean, rainy.recall.mean) == (1.0, 0.75)
    assert clear.objects == rainy.objects == 2
    assert clear.map50.mean == pytest.approx(1.0)
    assert rainy.map50.high == pytest.approx(1.0)
    assert rainy.map50.low == pytest.approx(51 / 101)  # one of two: precision 1 up to a recall of 0.5
    assert clear.change is None
    assert rainy.change.mean == pytest.approx(-0.3)


def test_changes_are_paired_by_seed():
    change = SeedChange.of([-0.1, -0.2, -0.3])
    half = 4.302652729911275 * 0.1 / np.sqrt(3)  # Student's t with two degrees of freedom
    assert (change.mean, change.low, change.high) == pytest.approx((-0.2, -0.2 - half, -0.2 + half))
    alone = SeedChange.of([-0.1])
    assert alone.mean == -0.1
    assert np.isnan([alone.low, alone.high]).all()


def test_mpc_rpc_and_recall_by_distance(rows, judgements):
    left = robustness_of(scores(rows, judgements))["d"]
    assert left.mpc == left.rpc == pytest.approx((1 + 51 / 101) / 2)
    bins = {(each.picture, each.recall.from_m): each.recall for each in distance_scores(rows)}
    assert (bins["clear", 0].objects, bins["clear", 0].found) == (1, 1)  # once, not once a seed
    assert (bins["rainy", 0].objects, bins["rainy", 0].found) == (2, 2)
    assert (bins["rainy", 30].objects, bins["rainy", 30].found) == (2, 1)
    assert ("rainy", 10) not in bins


def test_a_detector_that_finds_nothing_can_be_scored_and_written():
    blind = [found("clear", 0.0, (0,), 0, 0), found("rainy", 8.5, (0,), 0, 0)]
    blind_rows = [row for each in blind for row in object_rows(each)]
    scored = scores(blind_rows, blind)
    assert [each.map50.mean for each in scored] == [0.0, 0.0]
    assert np.isnan(robustness_of(scored)["d"].rpc)
    assert plain(scored[1])["change"]["low"] is None


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


def test_only_what_is_believed_is_a_flip():
    faint, sure = (Detection("truck", confidence, NEAR.box_xyxy) for confidence in (0.1, 0.6))
    trial = Condition("clear", 0.0, (0,))
    for each, share in ((faint, 0.0), (sure, 0.5)):
        one = evaluate_detections("d", FRAME, trial, [each])
        assert scores(list(object_rows(one)), [one])[0].flips.mean == share


def test_a_reconstruction_is_compared_with_its_pictures():
    both = [found("original", 0.0, (0, 1), 0.9, 0.8), found("clear", 0.0, (0, 1), 0.8, 0.7)]
    rows = [row for each in both for row in object_rows(each)]
    original, clear = scores(rows, both)
    assert original.change is None
    assert clear.change.mean == pytest.approx(-0.1)
    assert np.isnan(clear.change.low)  # no rain, no drops that could differ
    marks = [line for line in object_figure(rows, "confidence").axes[0].get_lines() if line.get_marker() == "x"]
    assert sorted(line.get_ydata()[0] for line in marks) == pytest.approx([0.8, 0.9])


def test_styles_of_curves_differ_and_shades_go_from_light_to_dark():
    assert len({style[:3] for style in series_styles(300)}) == 300
    lightness = [sum(color[:3]) for color in shades(5)]
    assert lightness == sorted(lightness, reverse=True)
    assert shades(2) == shades(3)[::2] and shades(1) == shades(3)[1:2]
    for entries, height_in, columns in ((0, 3, 1), (16, 3, 1), (17, 3, 2), (33, 3, 3), (4, 0.1, 4)):
        assert legend_columns(entries, height_in) == columns  # 5.4 lines an inch: 16 on three inches
        assert legend_width_in(entries, height_in) == pytest.approx(2.1 * columns)


def test_figures_show_means_and_bands_by_object(rows, judgements):
    assert list(plotted_objects(rows)) == ["near", "far"]
    figure = object_figure(rows, "confidence")
    (panel,) = figure.axes
    curves = {line.get_label(): line.get_ydata() for line in panel.get_lines()}
    np.testing.assert_allclose(curves["far: car, 35 m, 1 frame"], [0.7, 0.2])
    np.testing.assert_allclose(curves["mean of 2 objects"], [0.8, 0.5])
    _, far = panel.collections
    corners = far.get_paths()[0].vertices
    at_last = corners[corners[:, 0] == 8.5][:, 1]
    assert (at_last.min(), at_last.max()) == pytest.approx((0.0, 0.4))
    np.testing.assert_array_equal(figure_pixels(object_figure(rows, "iou")), figure_pixels(object_figure(rows, "iou")))
    assert len(precision_figure(scores(rows, judgements)).axes) == 2


def row_of(detector, rain, seed, number):
    return ObjectRow(
        detector=detector, picture="rainy" if rain else "clear", intensity_mm_h=rain, seed=seed, frame="f",
        object=f"o{number}", class_name=f"class {number}", confidence=0.9 - 0.01 * number, iou=0.8,
        confidence_any_class=0.9, iou_any_class=0.8, class_seen=None, visibility=1.0, distance_m=10.0 + number,
        height_px=50.0,
    )  # fmt: skip


@pytest.mark.parametrize(("classes", "detectors"), [(1, 6), (3, 1), (30, 2)])
def test_figures_take_any_number_of_classes_and_detectors(classes, detectors):
    names = [f"d{number}" for number in range(detectors)]
    rows = [row_of(name, rain, 0, number) for name in names for rain in (0.0, 8.5) for number in range(classes)]
    figure = object_figure(rows, "confidence")
    assert figure_pixels(figure).shape[1] < 4000
    panels = [panel for panel in figure.axes if panel.axison]
    assert len(panels) == detectors * (1 if classes == 1 else 2)
    assert len(panels[-1].get_lines()) == classes + 1  # and the mean of all
    looks = {(line.get_color(), line.get_linestyle(), line.get_marker()) for line in panels[-1].get_lines()}
    assert len(looks) > min(classes, 10)
    entries = [text.get_text() for part in figure.subfigs for legend in part.legends for text in legend.get_texts()]
    assert {f"class {number}, mean of 1 object" for number in range(classes if classes > 1 else 0)} <= set(entries)


def test_a_sheet_of_many_weathers_goes_on_below():
    image = np.full((60, 300, 3), 90, np.uint8)
    trials = [Condition("rainy", float(rain), (0,)) for rain in range(1, 31)]
    pictures = [
        EvaluatedImage(FRAME, each, {"d": evaluate_detections("d", FRAME, each, [])}, lambda: image) for each in trials
    ]
    sheet = detection_sheet(pictures)
    assert sheet.shape[1] <= 1920
    assert (sheet == 90).all(axis=2).sum() > 30 * 240 * 40  # all of them are there


# Boxes on an image

PICTURE = np.full((360, 640, 3), 90, np.uint8)
BOX = (200.0, 120.0, 400.0, 280.0)
RED = (255, 60, 60)


def _has(picture: np.ndarray, color: tuple[int, int, int]) -> bool:
    return bool((picture == np.array(color, np.uint8)).all(axis=-1).any())


def test_a_detection_has_its_box_and_tag_in_the_color_of_its_class():
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
