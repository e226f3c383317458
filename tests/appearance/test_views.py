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
    ViewChoice,
    chosen_cameras,
    chosen_views,
    evenly_spaced_indices,
    scene_view,
    scene_views,
)
from gsrain_engine.datasets.capture import EGO_HEIGHT_M, Capture, CaptureFrame, Lens
from gsrain_engine.datasets.open_capture import open_capture
from gsrain_engine.scene.camera import Camera, look_at
from gsrain_engine.scene.scene import Scene
from gsrain_engine.scene.street.layout import Label
from rasterized import rasterize
from tests.training.drive_capture import HEIGHT, ROAD_Z, WIDTH, drive_capture, world_depth
from tests.training.small_street import FORWARD, LEFT, small_street, still_track

# Cameras in a scene

BELOW = Camera.from_fov(90, 60, 50, look_at(np.array([2.0, 1, 1.5]), np.array([9.0, 0, 1]), np.array([0.0, 0, 1])))


LENS = Lens("opencv", (-0.1, 0.01, 0.0, 0.0))


def cameras_of(scene: Scene, count: int | None = None, **options) -> list:
    return chosen_cameras(scene, ViewChoice(count=count, **options))


def forward_of(camera: Camera) -> np.ndarray:
    return camera.camera_to_world[:3, 2]


def recording(*sensors: str) -> Capture:
    image = np.zeros((60, 90, 3), np.uint8)
    return Capture(
        "drive", tuple(CaptureFrame(f"v{i}", BELOW, image, i / 2, each, LENS) for i, each in enumerate(sensors))
    )


def test_views_lie_evenly_on_the_way_driven_front_and_side_in_turn():
    views = cameras_of(small_street(), 4)
    np.testing.assert_allclose([view.camera.position[0] for view in views], [0.75, 2.25, 3.75, 5.25])
    np.testing.assert_allclose([view.time_s for view in views], [0.125, 0.375, 0.625, 0.875])
    assert [view.name for view in views] == ["front_000", "left_001", "front_002", "left_003"]
    assert [view.sensor for view in views] == ["front", "left", "front", "left"]
    assert all(view.camera.position[2] == pytest.approx(1.5) for view in views)
    for view, mounted in zip(views, (FORWARD, LEFT, FORWARD, LEFT), strict=True):
        np.testing.assert_allclose(forward_of(view.camera), mounted[:3, 2], atol=1e-12)


def test_pictures_are_small_and_keep_their_field_of_view():
    big = [replace(each, width=960, height=640, fx=600, fy=600, cx=480, cy=320) for each in small_street().rigs["test"]]
    wide = replace(small_street(), rigs={"big": tuple(big)})
    for view in cameras_of(wide, 2):
        assert view.camera.width * view.camera.height == pytest.approx(DEFAULT_PIXELS, rel=0.01)
        assert view.camera.vertical_fov_deg == pytest.approx(2 * np.degrees(np.arctan(32 / 60)))
    assert cameras_of(small_street(), 1)[0].camera.width == 96  # never more than its own
    asked = cameras_of(wide, 1, width_px=100)[0].camera
    assert (asked.width, asked.height, asked.fx) == (100, 67, pytest.approx(62.5))
    views = scene_views(wide, chosen_cameras(wide, ViewChoice(count=2)), 60)
    assert [view.image.shape for view in views] == [(40, 60, 3)] * 2


def test_without_a_track_views_surround_the_middle():
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


def test_recorded_and_rig_cameras_can_be_chosen_by_sensor_and_indices_are_spread():
    scene, capture = replace(small_street(), metres_per_unit=3.0), recording("front", "back", "front", "back")
    views = chosen_cameras(scene, ViewChoice(), capture)
    assert [(view.name, view.time_s) for view in views] == [("v0", 0), ("v1", 0.5), ("v2", 1), ("v3", 1.5)]
    np.testing.assert_allclose(views[0].camera.position, 3 * BELOW.position)
    only = chosen_cameras(scene, ViewChoice(sensors=("back",), count=1), capture)
    assert [view.sensor for view in only] == ["back"]
    assert {view.sensor for view in cameras_of(small_street(), 4, sensors=("left",))} == {"left"}
    assert [list(evenly_spaced_indices(*each)) for each in ((5, None), (3, 9), (10, 2))] == [
        [0, 1, 2, 3, 4], [0, 1, 2], [2, 7],
    ]  # fmt: skip
    assert [view.name for view in chosen_views(recording(*"aaaaaa"), ViewChoice(count=3))] == ["v1", "v3", "v5"]


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

UP = np.array([0.0, 0, 1])


AHEAD = PlacedCamera("a", Camera.from_fov(120, 80, 60, look_at(np.array([3.0, 0, 1.6]), np.array([9.0, 0, 1.4]), UP)))


def test_a_view_of_the_street_is_what_the_rasterizer_draws():
    scene = small_street()
    view = scene_view(scene, AHEAD)
    frame = rasterize(scene.parts(0.0), AHEAD.camera)
    opaque = frame.rgba[..., 3] > 0.999
    assert opaque.mean() > 0.5
    np.testing.assert_allclose(view.image[opaque], np.clip(frame.rgba[opaque][:, :3], 0, 1), atol=2e-3)


def test_road_sky_and_car_are_separated():
    view = scene_view(small_street(), AHEAD)
    assert view.sky[2:10, 40:80].min() > 0.95
    assert view.depth[2:10, 40:80].max() == 0
    road = view.depth[-3, 60]
    rows = (np.arange(80) + 0.5 - AHEAD.camera.cy) / AHEAD.camera.fy
    drop = -(AHEAD.camera.world_to_camera[1, 2] * rows[-3] + AHEAD.camera.world_to_camera[2, 2])
    assert road == pytest.approx(1.6 / drop, rel=0.25)  # its Gaussians are balls of half a metre
    assert road < view.depth[-10, 60] < view.depth[-20, 60]
    assert view.sky[-5:].max() < 0.05
    assert view.normals[-3, 60, 2] > 0.9  # up, towards the eye
    car = view.vehicles > 0.5
    assert 0.005 < car.mean() < 0.2
    inside = np.median(view.depth[car])
    assert inside == pytest.approx(13.8 - 3, abs=0.3)
    reds = view.image[car]
    assert (reds[:, 0] > reds[:, 1] + 0.2).mean() > 0.9


def test_without_a_sky_layer_nothing_above_the_horizon_is_sky_and_nothing_below_is():
    scene = small_street()
    bare = replace(scene, layers=tuple(layer for layer in scene.layers if layer.kind != "sky"))
    view = scene_view(bare, AHEAD)
    assert view.sky[2:10, 40:80].min() > 0.95 and view.image[4, 60].min() > 0.6
    down = look_at(np.array([100.0, 0, 9]), np.array([120.0, 0, -9]), UP)  # past the end of the road
    below = scene_view(bare, PlacedCamera("b", Camera.from_fov(40, 30, 40, down)))
    empty = scene_view(Scene("empty"), AHEAD)
    assert below.sky.max() == below.depth.max() == empty.depth.max() == 0 and empty.sky[0].min() == 1


def test_views_are_drawn_on_demand_and_cached():
    scene = small_street()
    made: list[int] = []

    def make(index: int):
        made.append(index)
        return scene_view(scene, replace(AHEAD, name=f"{index}"))

    views = CachedViews(CACHED_VIEWS + 2, make)
    assert made == []
    assert views[-1].name == f"{CACHED_VIEWS + 1}"
    assert views[0] is views[0]
    assert made == [CACHED_VIEWS + 1, 0]
    assert [view.name for view in views[1:3]] == ["1", "2"]
    for index in range(CACHED_VIEWS):
        _ = views[index]
    _ = views[CACHED_VIEWS + 1]
    assert made.count(CACHED_VIEWS + 1) == 2
    with pytest.raises(IndexError):
        views[CACHED_VIEWS + 2]


# Views of a capture

Y_UP = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])


def test_lidar_becomes_dense_depth_and_normals_and_the_sky_is_found():
    capture = drive_capture()
    view = CaptureViews(capture, WIDTH)[2]
    truth = world_depth(capture[2].camera)
    finite = np.isfinite(truth)
    assert view.sky[:8].min() == 1
    assert view.sky[HEIGHT // 2 :].max() == 0
    assert not view.depth[view.sky > 0].any()
    rows = slice(HEIGHT // 2 + 4, HEIGHT)
    np.testing.assert_allclose(view.depth[rows], truth[rows], rtol=0.12)
    assert (view.depth[finite] > 0).mean() > 0.95
    assert np.median(view.normals[rows][..., 2]) > 0.98
    assert view.vehicles.max() == 0
    np.testing.assert_array_equal(view.image, capture[2].image.astype(np.float32) / np.float32(255))


def test_what_a_capture_knows_is_taken_as_it_is():
    plain = drive_capture(2)
    truth = [world_depth(view.camera) for view in plain]
    known = tuple(
        replace(
            view,
            depth_source=np.where(np.isfinite(depth), depth, 0).astype(np.float32),
            sky_source=~np.isfinite(depth),
            normals_source=np.tile(np.float32([0, 0, 1]), (HEIGHT, WIDTH, 1)),
            labels_source=np.where(depth < 5, np.uint8(Label.CAR), np.uint8(Label.ROAD)),
        )
        for view, depth in zip(plain, truth, strict=True)
    )
    view = CaptureViews(replace(plain, views=known, sweeps=()), WIDTH)[1]
    np.testing.assert_array_equal(view.depth, known[1].depth)
    np.testing.assert_array_equal(view.sky > 0.5, known[1].sky)
    np.testing.assert_array_equal(view.normals[..., 2], 1)
    np.testing.assert_array_equal(view.vehicles > 0.5, truth[1] < 5)


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
    scale = EGO_HEIGHT_M / -ROAD_Z
    rows = slice(HEIGHT // 2 + 6, HEIGHT)
    np.testing.assert_allclose(views[1].depth[rows], scale * world_depth(metric[1].camera)[rows], rtol=0.1)
    assert np.median(views[1].normals[rows][..., 2]) > 0.98
    assert views.to_world[:3, :3] @ Y_UP[:3, 2] == pytest.approx([0, 0, 2], abs=0.15)


def test_poses_that_are_all_the_same_are_none():
    plain = replace(drive_capture(2), sweeps=())
    assert all(view.has_pose for view in CaptureViews(plain, WIDTH))
    still = tuple(replace(view, camera=plain[0].camera) for view in plain)
    assert not any(view.has_pose for view in CaptureViews(replace(plain, views=still), WIDTH))
    at_rest = tuple(replace(view, camera=plain[0].camera) for view in drive_capture(2))
    measured = replace(drive_capture(2), views=at_rest)  # a tripod with a lidar
    assert all(view.has_pose for view in CaptureViews(measured, WIDTH))
    assert not any(view.has_pose for view in CaptureViews(replace(plain, has_poses=False), WIDTH))


def test_only_what_the_lens_saw_is_learned_from_and_no_picture_grows():
    capture = drive_capture(1)
    bent = replace(capture, views=(replace(capture[0], lens=Lens("opencv", (0.3, 0.0, 0.0, 0.0))),))
    mask = CaptureViews(bent, WIDTH).mask("0")
    assert mask is not None and not mask.all() and mask[HEIGHT // 2, WIDTH // 2]
    assert CaptureViews(capture, WIDTH).mask("0") is None
    assert CaptureViews(capture, 48)[0].image.shape == (32, 48, 3)
    assert CaptureViews(capture, 4800)[0].image.shape == (HEIGHT, WIDTH, 3)


def test_a_real_drive_has_road_sky_and_cars(test_data):
    capture = chosen_views(open_capture(test_data / "driving" / "dgp" / "scene_02"), ViewChoice(sensors=("CAMERA_09",)))
    view = CaptureViews(chosen_views(capture, ViewChoice(count=1)), 160)[0]
    assert 0.05 < view.sky.mean() < 0.4
    assert view.vehicles.sum() > 10
    middle = view.depth[70:80, 70:90]
    assert 3 < np.median(middle) < 15
    assert np.median(view.normals[75:90, 40:120, 2]) > 0.9
