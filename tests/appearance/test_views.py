"""Clear views: of a scene from chosen cameras, and of a capture with its lidar, boxes, sky and units."""

from dataclasses import replace

import numpy as np
import pytest

from gsrain_engine.appearance.capture_views import CaptureViews
from gsrain_engine.appearance.scene_views import (
    CACHED_VIEWS,
    DEFAULT_PIXELS,
    EYE_HEIGHT_M,
    CachedViews,
    PlacedCamera,
    chosen_cameras,
    chosen_views,
    evenly_spaced_indices,
    scene_view,
    scene_views,
)
from gsrain_engine.appearance.view_choice import ViewChoice
from gsrain_engine.datasets.capture import EGO_HEIGHT_M, Capture, CaptureFrame
from gsrain_engine.datasets.open_capture import open_capture
from gsrain_engine.scene.camera import Camera, look_at
from gsrain_engine.scene.camera_path import CameraPath
from gsrain_engine.scene.labels import Label
from gsrain_engine.scene.lens import Lens
from gsrain_engine.scene.scene import Scene
from rasterized import rasterize
from tests.training.drive_capture import HEIGHT, ROAD_Z, WIDTH, box, drive_capture, world_depth
from tests.training.small_street import FORWARD, LEFT, small_street, still_track

# Cameras in a scene

UP = np.array([0.0, 0, 1])
BELOW = Camera.from_fov(90, 60, 50, look_at(np.array([2.0, 1, 1.5]), np.array([9.0, 0, 1]), UP))


def cameras_of(scene: Scene, count: int | None = None, **options) -> list:
    return chosen_cameras(scene, ViewChoice(count=count, **options))


def forward_of(camera: Camera) -> np.ndarray:
    return camera.camera_to_world[:3, 2]


def recording(*sensors: str) -> Capture:
    image, lens = np.zeros((60, 90, 3), np.uint8), Lens("opencv", (-0.1, 0.01, 0.0, 0.0))
    views = (CaptureFrame(f"v{i}", BELOW, image, i / 2, each, lens) for i, each in enumerate(sensors))
    return Capture("drive", tuple(views))


def test_views_are_even_along_the_drive_front_and_side_in_turn():
    views = cameras_of(small_street(), 4)
    np.testing.assert_allclose(
        [view.camera.position for view in views], [[x, 0, 1.5] for x in (0.75, 2.25, 3.75, 5.25)]
    )
    assert [(view.name, view.sensor, view.time_s) for view in views] == [
        ("front_000", "front", 0.125), ("left_001", "left", 0.375), ("front_002", "front", 0.625),
        ("left_003", "left", 0.875),
    ]  # fmt: skip
    for view, mounted in zip(views, (FORWARD, LEFT, FORWARD, LEFT), strict=True):
        np.testing.assert_allclose(forward_of(view.camera), mounted[:3, 2], atol=1e-12)


def test_pictures_are_small_and_keep_their_field_of_view():
    big = [replace(each, width=960, height=640, fx=600, fy=600, cx=480, cy=320) for each in small_street().rigs["test"]]
    wide = replace(small_street(), rigs={"big": tuple(big)})
    (view,) = cameras_of(wide, 1)
    assert view.camera.width * view.camera.height == pytest.approx(DEFAULT_PIXELS, rel=0.01)
    assert view.camera.vertical_fov_deg == pytest.approx(2 * np.degrees(np.arctan(32 / 60)))
    assert cameras_of(small_street(), 1)[0].camera.width == 96  # never more than its own
    asked = cameras_of(wide, 1, width_px=100)[0].camera
    assert (asked.width, asked.height, asked.fx) == (100, 67, pytest.approx(62.5))
    (drawn,) = scene_views(wide, [view], 60)
    assert drawn.image.shape == (40, 60, 3)


def test_without_a_drive_cameras_stand_in_a_ring_and_in_its_middle():
    parked = replace(small_street(), ego=still_track((0, 0, 1.5), (0, 0, 1.5)))
    assert len({view.time_s for view in cameras_of(parked, 8)}) == 8
    assert len(cameras_of(Scene("empty"), 3)) == 3
    views = cameras_of(replace(small_street(), ego=None), 8)
    middle = views[1].camera.position
    assert middle[2] == pytest.approx(EYE_HEIGHT_M) and np.abs(middle[:2] - [12, 0]).max() < 6
    for ring, outward in zip(views[::2], views[1::2], strict=True):
        to_middle = (middle - ring.camera.position) / np.linalg.norm(middle - ring.camera.position)
        np.testing.assert_allclose(forward_of(ring.camera), to_middle, atol=1e-9)
        np.testing.assert_allclose(outward.camera.position, middle, atol=1e-9)
    assert len({tuple(np.round(forward_of(view.camera), 6)) for view in views}) == 8


def test_recorded_and_rig_cameras_can_be_chosen_by_sensor_and_are_spread():
    scene, capture = replace(small_street(), metres_per_unit=3.0), recording("front", "back", "front", "back")
    views = chosen_cameras(scene, ViewChoice(), capture)
    assert [(view.name, view.time_s) for view in views] == [("v0", 0), ("v1", 0.5), ("v2", 1), ("v3", 1.5)]
    np.testing.assert_allclose(views[0].camera.position, 3 * BELOW.position)
    only = chosen_cameras(scene, ViewChoice(sensors=("back",), count=1), capture)
    assert [view.sensor for view in only] == ["back"]
    assert {view.sensor for view in cameras_of(small_street(), 4, sensors=("left",))} == {"left"}
    for there, count, expected in ((5, None, [0, 1, 2, 3, 4]), (3, 9, [0, 1, 2]), (10, 2, [2, 7])):
        assert list(evenly_spaced_indices(there, count)) == expected


def test_several_cameras_of_a_recording_are_chosen_at_the_same_moments():
    capture = recording(*("front", "left", "back") * 6)
    names = [view.sensor for view in chosen_views(capture, ViewChoice(sensors=("left", "front"), count=5))]
    assert names == ["front", "left"] * 2
    views = chosen_views(capture, ViewChoice(sensors=("left", "front"), count=5)).views
    assert [view.name for view in views] == ["v3", "v4", "v12", "v13"]
    one_is_missing = recording("front", "left", "left", "front", "left")
    views = chosen_views(one_is_missing, ViewChoice(sensors=("left", "front"), count=2)).views
    assert [view.name for view in views] == ["v1", "v3"]


def test_views_on_a_path_are_even_in_time():
    times, straight = np.array([0.0, 3.0]), np.tile([1.0, 0, 0, 0], (2, 1))
    path = CameraPath(times, np.array([[0.0, 0, 1], [3.0, 0, 1]]), straight, np.array([50.0, 50.0]))
    views = cameras_of(replace(small_street(), path=path), 4, source="path")
    np.testing.assert_allclose([view.time_s for view in views], [0, 1, 2, 3])
    np.testing.assert_allclose([view.camera.position[0] for view in views], [0, 1, 2, 3], atol=1e-9)


@pytest.mark.parametrize(
    ("choice", "capture", "name"),
    [
        (ViewChoice(source="recorded"), None, "capture"),
        (ViewChoice(source="path"), None, "camera path"),
        (ViewChoice(source="recorded"), replace(recording("a"), has_poses=False), "cameras"),
        (ViewChoice(sensors=("b",)), recording("a"), "camera b, only a"),
        (ViewChoice(sensors=("roof",)), None, "camera roof, only front, left"),
        (ViewChoice(source="rig"), None, "camera rig"),
    ],
)
def test_cameras_that_are_not_there_are_named(choice, capture, name):
    scene = small_street() if choice.source != "rig" else replace(small_street(), rigs={})
    with pytest.raises(ValueError, match=name):
        chosen_cameras(scene, choice, capture)


# Views of a scene

AHEAD = PlacedCamera("a", Camera.from_fov(120, 80, 60, look_at(np.array([3.0, 0, 1.6]), np.array([9.0, 0, 1.4]), UP)))


def test_a_view_is_what_the_rasterizer_draws_with_depth_sky_and_vehicles():
    view = scene_view(small_street(), AHEAD)
    frame = rasterize(small_street().parts(0.0), AHEAD.camera)
    opaque = frame.rgba[..., 3] > 0.999
    assert opaque.mean() > 0.5
    np.testing.assert_allclose(view.image[opaque], np.clip(frame.rgba[opaque][:, :3], 0, 1), atol=2e-3)
    assert view.sky[2:10, 40:80].min() > 0.95 and view.depth[2:10, 40:80].max() == 0 and view.sky[-5:].max() < 0.05
    pose = AHEAD.camera.world_to_camera
    drop = -(pose[1, 2] * (77.5 - AHEAD.camera.cy) / AHEAD.camera.fy + pose[2, 2])
    assert view.depth[77, 60] == pytest.approx(1.6 / drop, rel=0.25)  # its Gaussians are balls of half a meter
    assert view.depth[77, 60] < view.depth[-10, 60] < view.depth[-20, 60]
    assert view.normals[77, 60, 2] > 0.9  # up, towards the eye
    car = view.vehicles > 0.5
    assert 0.005 < car.mean() < 0.2 and np.median(view.depth[car]) == pytest.approx(13.8 - 3, abs=0.3)
    assert (view.image[car][:, 0] > view.image[car][:, 1] + 0.2).mean() > 0.9


def test_without_a_sky_layer_what_is_empty_above_the_horizon_is_sky():
    scene = small_street()
    bare = replace(scene, layers=tuple(layer for layer in scene.layers if layer.kind != "sky"))
    view = scene_view(bare, AHEAD)
    assert view.sky[2:10, 40:80].min() > 0.95 and view.image[4, 60].min() > 0.6
    down = look_at(np.array([100.0, 0, 9]), np.array([120.0, 0, -9]), UP)  # past the end of the road
    below = scene_view(bare, PlacedCamera("b", Camera.from_fov(40, 30, 40, down)))
    empty = scene_view(Scene("empty"), AHEAD)
    assert below.sky.max() == below.depth.max() == empty.depth.max() == 0 and empty.sky[0].min() == 1


def test_views_are_made_on_demand_and_the_latest_are_cached():
    view, made = scene_view(Scene("empty"), AHEAD), list[str]()

    def make(index: int):
        made.append(str(index))
        return replace(view, name=str(index))

    views, last = CachedViews(CACHED_VIEWS + 2, make), str(CACHED_VIEWS + 1)
    assert made == []
    assert [each.name for each in (views[-1], views[0], views[0], views[1], views[2])] == [last, "0", "0", "1", "2"]
    assert made == [last, "0", "1", "2"]
    assert [each.name for each in views[:CACHED_VIEWS]] == [str(i) for i in range(CACHED_VIEWS)]
    assert views[-1].name == last and len(made) == CACHED_VIEWS + 2  # the last one had been dropped
    with pytest.raises(IndexError):
        views[CACHED_VIEWS + 2]


# Views of a capture

Y_UP = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])


def test_lidar_becomes_dense_depth_and_normals_and_the_sky_is_found():
    capture = drive_capture()
    view, truth = CaptureViews(capture, WIDTH)[2], world_depth(capture[2].camera)
    assert view.sky[:8].min() == 1 and view.sky[HEIGHT // 2 :].max() == 0 and not view.depth[view.sky > 0].any()
    rows = slice(HEIGHT // 2 + 4, HEIGHT)
    np.testing.assert_allclose(view.depth[rows], truth[rows], rtol=0.12)
    assert (view.depth[np.isfinite(truth)] > 0).mean() > 0.95
    assert np.median(view.normals[rows][..., 2]) > 0.98
    assert view.vehicles.max() == 0
    np.testing.assert_array_equal(view.image, capture[2].image.astype(np.float32) / np.float32(255))


@pytest.mark.parametrize("has_labels", [True, False])
def test_depth_sky_normals_and_vehicles_of_a_capture_are_taken_as_they_are(has_labels):
    plain = drive_capture(2)
    truth = [world_depth(view.camera) for view in plain]
    known = tuple(
        replace(
            view,
            depth_source=np.where(np.isfinite(depth), depth, 0).astype(np.float32),
            sky_source=~np.isfinite(depth),
            normals_source=np.tile(np.float32([0, 0, 1]), (HEIGHT, WIDTH, 1)),
            labels_source=np.where(depth < 5, np.uint8(Label.CAR), np.uint8(Label.ROAD)) if has_labels else None,
        )
        for view, depth in zip(plain, truth, strict=True)
    )
    car = box("car", (30.0 + 2.0, 0.0), 0.0)  # its rear is the wall
    view = CaptureViews(replace(plain, views=known, sweeps=(), boxes=(car,)), WIDTH)[1]
    np.testing.assert_array_equal(view.depth, known[1].depth)
    np.testing.assert_array_equal(view.sky > 0.5, known[1].sky)
    np.testing.assert_array_equal(view.normals[..., 2], 1)
    rows, columns = np.nonzero(view.vehicles > 0.5)
    if has_labels:
        np.testing.assert_array_equal(view.vehicles > 0.5, truth[1] < 5)
    else:  # 2 m wide and 1.5 m high on the road, 29 m away; the lowest part shows the road as well
        size = (np.ptp(columns) + 1, np.ptp(rows) + 1)
        assert size == pytest.approx((2 / 29 * 70, 1.35 / 29 * 70), abs=1)


def test_a_capture_in_other_units_and_axes_comes_into_the_world():
    metric = drive_capture(4)
    half = 0.5 * np.eye(4) + np.diag([0, 0, 0, 0.5])
    points = np.concatenate([sweep.points_m for sweep in metric.sweeps]).astype(np.float64)
    capture = Capture(
        "model",
        tuple(replace(view, camera=view.camera.moved(Y_UP @ half)) for view in metric),
        points_m=0.5 * points @ Y_UP[:3, :3].T,
        is_metric=False,
        up=tuple(Y_UP[:3, 2]),
    )
    views = CaptureViews(capture, WIDTH)
    rows = slice(HEIGHT // 2 + 6, HEIGHT)
    expected = EGO_HEIGHT_M / -ROAD_Z * world_depth(metric[1].camera)[rows]
    np.testing.assert_allclose(views[1].depth[rows], expected, rtol=0.1)
    assert np.median(views[1].normals[rows][..., 2]) > 0.98
    assert views.to_world[:3, :3] @ Y_UP[:3, 2] == pytest.approx([0, 0, 2], abs=0.15)


def test_poses_that_are_all_the_same_are_unknown_unless_something_was_measured():
    drive = drive_capture(2)
    still = replace(drive, views=tuple(replace(view, camera=drive[0].camera) for view in drive))  # a tripod and a lidar
    for capture, expected in (
        (drive, True), (still, True), (replace(drive, sweeps=()), True), (replace(still, sweeps=()), False),
        (replace(drive, has_poses=False), False),
    ):  # fmt: skip
        assert [view.has_pose for view in CaptureViews(capture, WIDTH)] == [expected] * 2


def test_only_what_the_lens_saw_is_learned_from_and_no_picture_grows():
    capture = drive_capture(1)
    bent = replace(capture, views=(replace(capture[0], lens=Lens("opencv", (0.3, 0.0, 0.0, 0.0))),))
    mask = CaptureViews(bent, WIDTH).mask("0")
    assert mask is not None and not mask.all() and mask[HEIGHT // 2, WIDTH // 2]
    assert CaptureViews(capture, WIDTH).mask("0") is None
    assert [CaptureViews(capture, width)[0].image.shape[1] for width in (48, 4800)] == [48, WIDTH]


def test_a_real_drive_has_road_sky_and_cars(test_data):
    capture = chosen_views(open_capture(test_data / "driving" / "dgp" / "scene_02"), ViewChoice(sensors=("CAMERA_09",)))
    view = CaptureViews(chosen_views(capture, ViewChoice(count=1)), 160)[0]
    assert 0.05 < view.sky.mean() < 0.4 and view.vehicles.sum() > 10
    assert 3 < np.median(view.depth[70:80, 70:90]) < 15
    assert np.median(view.normals[75:90, 40:120, 2]) > 0.9
