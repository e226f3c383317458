from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gsrain_engine.datasets.capture import CaptureFrame
from gsrain_engine.datasets.depth_maps import completed_depths, measured_depths
from gsrain_engine.datasets.open_capture import open_capture
from gsrain_engine.datasets.sky_masks import sky_masks
from gsrain_engine.datasets.undistort import undistort_frame
from gsrain_engine.training.ego_mask import ego_masks, mask_ego_vehicle

from .drive_capture import HEIGHT, WIDTH, drive_capture


def masks_of(capture):
    depths = completed_depths(capture, capture.views, measured_depths(capture, capture.views))
    return ego_masks(capture.views, depths)


def test_the_bonnet_is_found() -> None:
    mask = masks_of(drive_capture(6, bonnet=12))["FRONT"]
    rows = mask.sum(axis=0)
    assert np.abs(rows - (HEIGHT - 12)).max() <= 4 and abs(float(np.median(rows)) - (HEIGHT - 12)) <= 3


def test_a_camera_without_a_bonnet_has_no_mask() -> None:
    assert masks_of(drive_capture(6)) == {}


def test_who_stands_still_tells_nothing() -> None:
    assert masks_of(drive_capture(6, step_m=0.0, bonnet=12)) == {}


def test_two_pictures_are_too_few() -> None:
    assert masks_of(drive_capture(2, bonnet=12)) == {}


def test_views_lose_the_bonnet(caplog: pytest.LogCaptureFixture) -> None:
    capture = drive_capture(6, bonnet=12)
    depths = completed_depths(capture, capture.views, measured_depths(capture, capture.views))
    with caplog.at_level("INFO", logger="gsrain"):
        views, shares = mask_ego_vehicle(capture.views, depths)
    assert shares.keys() == {"FRONT"} and 12 / HEIGHT - 0.07 < shares["FRONT"] < 12 / HEIGHT + 0.07
    assert "FRONT" in caplog.text
    assert all(view.mask is not None and not view.mask[-8:].any() and view.mask[: HEIGHT // 2].all() for view in views)


def without_top(view: CaptureFrame, rows: int) -> CaptureFrame:
    camera = replace(view.camera, height=view.camera.height - rows, cy=view.camera.cy - rows)
    return replace(view, camera=camera, image_source=view.image[rows:])


def test_sizes_may_differ_by_a_few_rows() -> None:
    """Images of one lens after undistortion with a camera per image."""
    capture = drive_capture(6, bonnet=12)
    views = tuple(without_top(view, k % 4) for k, view in enumerate(capture))
    depths = completed_depths(capture, views, measured_depths(capture, views))
    ready, shares = mask_ego_vehicle(views, depths)
    assert shares.keys() == {"FRONT"}
    for view in ready:
        assert view.mask is not None and view.mask.shape == (view.camera.height, WIDTH)
        assert not view.mask[-8:].any() and view.mask[: HEIGHT // 2].all()


def test_a_picture_that_was_turned_is_left_alone() -> None:
    capture = drive_capture(7, bonnet=12)
    odd = replace(
        capture[3], camera=replace(capture[3].camera, width=40, cx=20.0), image_source=capture[3].image[:, :40]
    )
    views = (*capture.views[:3], odd, *capture.views[4:])
    depths = completed_depths(capture, views, measured_depths(capture, views))
    ready, shares = mask_ego_vehicle(views, depths)
    assert shares.keys() == {"FRONT"} and ready[3] is odd


def test_real_bonnets(test_data: Path) -> None:
    """One camera of the rig sees no car body; the rear ones see a fifth of it. Read off the photographs."""
    capture = open_capture(test_data / "driving" / "dgp")
    views = [undistort_frame(view, 240).held() for view in capture.views]
    measured = measured_depths(capture, views)
    masks = ego_masks(views, completed_depths(capture, views, measured, sky_masks(views, measured, capture.up)))
    assert set(masks) == {"CAMERA_05", "CAMERA_06", "CAMERA_07", "CAMERA_08", "CAMERA_09"}
    rear = masks["CAMERA_09"]
    assert not rear[-15:, 40:200].any() and rear[: round(0.7 * len(rear))].all()
