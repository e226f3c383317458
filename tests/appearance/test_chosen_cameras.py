from dataclasses import replace

import numpy as np
import pytest

from gsrain_engine.appearance.scene_views import (
    DEFAULT_PIXELS,
    EYE_HEIGHT_M,
    ViewChoice,
    chosen_cameras,
    chosen_views,
    evenly_spaced_indices,
)
from gsrain_engine.datasets.capture import Capture, CaptureFrame, Lens
from gsrain_engine.scene.camera import Camera, look_at
from gsrain_engine.scene.camera_path import circle_path, orbit_path
from gsrain_engine.scene.scene import Scene
from tests.training.small_street import FORWARD, LEFT, small_street, still_track

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


def test_only_some_cameras_of_the_rig_can_be_asked_for():
    assert {view.sensor for view in cameras_of(small_street(), 4, sensors=("left",))} == {"left"}
    with pytest.raises(ValueError, match="its rig has no camera roof, only front, left"):
        cameras_of(small_street(), 4, sensors=("roof",))


def test_pictures_are_small_and_keep_their_field_of_view():
    wide = replace(
        small_street(),
        rigs={
            "big": tuple(
                replace(each, width=960, height=640, fx=600, fy=600, cx=480, cy=320)
                for each in small_street().rigs["test"]
            )
        },
    )
    for view in cameras_of(wide, 2):
        assert view.camera.width * view.camera.height == pytest.approx(DEFAULT_PIXELS, rel=0.01)
        assert view.camera.vertical_fov_deg == pytest.approx(2 * np.degrees(np.arctan(32 / 60)))
    assert cameras_of(small_street(), 1)[0].camera.width == 96  # never more than its own
    asked = cameras_of(wide, 1, width_px=100)[0].camera
    assert (asked.width, asked.height, asked.fx) == (100, 67, pytest.approx(62.5))


def test_a_parked_ego_vehicle_looks_at_different_times():
    parked = replace(small_street(), ego=still_track((0, 0, 1.5), (0, 0, 1.5)))
    assert len({view.time_s for view in cameras_of(parked, 8)}) == 8


def test_without_a_track_views_surround_the_middle():
    views = cameras_of(replace(small_street(), ego=None), 8)
    middle = views[1].camera.position
    assert middle[2] == pytest.approx(EYE_HEIGHT_M)
    assert np.abs(middle[:2] - [12, 0]).max() < 6
    for ring, outward in zip(views[::2], views[1::2], strict=True):
        to_middle = (middle - ring.camera.position) / np.linalg.norm(middle - ring.camera.position)
        np.testing.assert_allclose(forward_of(ring.camera), to_middle, atol=1e-9)
        np.testing.assert_allclose(outward.camera.position, middle, atol=1e-9)
    assert len({tuple(np.round(forward_of(view.camera), 6)) for view in views}) == 8


def test_an_empty_scene_still_gives_cameras():
    assert len(cameras_of(Scene("empty"), 3)) == 3


def test_views_on_a_path_are_in_metres_whatever_the_scenes_unit():
    path = orbit_path(np.array([9.0, 0, 1]), BELOW, 4.0)
    scene = replace(small_street(), path=path, metres_per_unit=2.0)
    views = cameras_of(scene, 3, source="path")
    assert [view.time_s for view in views] == [0, 2, 4]
    np.testing.assert_allclose(views[1].camera.position, 2 * path.camera(2.0, 48, 32).position)
    loop = replace(scene, path=circle_path(np.array([9.0, 0, 1]), BELOW, 4.0))
    assert [view.time_s for view in cameras_of(loop, 4, source="path")] == [0, 1, 2, 3]


def test_recorded_cameras_come_from_a_capture_in_the_scenes_units_without_distortion():
    scene, capture = replace(small_street(), metres_per_unit=3.0), recording("front", "back", "front", "back")
    views = chosen_cameras(scene, ViewChoice(), capture)
    assert [view.name for view in views] == ["v0", "v1", "v2", "v3"]
    assert [view.time_s for view in views] == [0, 0.5, 1, 1.5]
    np.testing.assert_allclose(views[0].camera.position, 3 * BELOW.position)
    only = chosen_cameras(scene, ViewChoice(sensors=("back",), count=1), capture)
    assert [view.sensor for view in only] == ["back"]


@pytest.mark.parametrize(
    ("choice", "capture", "expected"),
    [
        (ViewChoice(source="recorded"), None, "its capture is needed"),
        (ViewChoice(source="path"), None, "has no camera path"),
        (ViewChoice(source="recorded"), replace(recording("a"), has_poses=False), "not where their cameras stood"),
        (ViewChoice(sensors=("b",)), recording("a"), "has no camera b, only a"),
    ],
)
def test_what_there_is_not_is_said(choice, capture, expected):
    with pytest.raises(ValueError, match=expected):
        chosen_cameras(small_street(), choice, capture)


def test_a_scene_without_rig_says_so():
    with pytest.raises(ValueError, match="no ego vehicle with a camera rig"):
        cameras_of(replace(small_street(), rigs={}), 2, source="rig")


def test_indices_are_spread_over_all_there_are():
    assert list(evenly_spaced_indices(5, None)) == [0, 1, 2, 3, 4]
    assert list(evenly_spaced_indices(3, 9)) == [0, 1, 2]
    assert list(evenly_spaced_indices(10, 2)) == [2, 7]
    assert [view.name for view in chosen_views(recording(*"aaaaaa"), ViewChoice(count=3))] == ["v1", "v3", "v5"]
