"""The search for the vehicle's own body in its images."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from gsrain_engine.datasets.capture import Capture, CaptureFrame
from gsrain_engine.datasets.depth_maps import completed_depths, measured_depths
from gsrain_engine.datasets.open_capture import open_capture
from gsrain_engine.datasets.sky_masks import sky_masks
from gsrain_engine.datasets.undistort import undistort_frame
from gsrain_engine.training.ego_mask import ego_masks, mask_ego_vehicle

from .drive_capture import HEIGHT, WIDTH, drive_capture


def searched(capture: Capture, views=None) -> tuple[list[CaptureFrame], dict[str, float]]:
    views = capture.views if views is None else views
    return mask_ego_vehicle(views, completed_depths(capture, views, measured_depths(capture, views)))


def without_top(view: CaptureFrame, rows: int) -> CaptureFrame:
    camera = replace(view.camera, height=view.camera.height - rows, cy=view.camera.cy - rows)
    return replace(view, camera=camera, image_source=view.image[rows:])


def test_the_bonnet_is_found_also_in_views_of_slightly_different_sizes() -> None:
    """Images of one lens differ by a few rows after undistortion with a camera per image."""
    capture = drive_capture(6, bonnet=12)
    for views in (capture.views, tuple(without_top(view, k % 4) for k, view in enumerate(capture))):
        ready, shares = searched(capture, views)
        assert shares.keys() == {"FRONT"} and abs(shares["FRONT"] - 12 / HEIGHT) < 0.07
        for view in ready:
            assert view.mask is not None and view.mask.shape == (view.camera.height, WIDTH)
            assert not view.mask[-8:].any() and view.mask[: HEIGHT // 2].all()
            body = (~view.mask).sum(axis=0)
            assert abs(float(np.median(body)) - 12) <= 3 and np.abs(body - 12).max() <= 5


def test_without_a_bonnet_a_motion_or_a_third_picture_nothing_is_found() -> None:
    for capture in (drive_capture(6), drive_capture(6, step_m=0.0, bonnet=12), drive_capture(2, bonnet=12)):
        ready, shares = searched(capture)
        assert shares == {} and ready == list(capture.views)


def test_a_picture_that_was_turned_is_left_alone() -> None:
    views = list(drive_capture(7, bonnet=12))
    views[3] = replace(
        views[3], camera=replace(views[3].camera, width=40, cx=20.0), image_source=views[3].image[:, :40]
    )
    ready, shares = searched(drive_capture(7), tuple(views))
    assert shares.keys() == {"FRONT"} and ready[3] is views[3]


def test_real_bonnets(test_data: Path) -> None:
    """One camera of the rig sees no car body; the rear ones see a fifth of it. Read off the photographs."""
    capture = open_capture(test_data / "driving" / "dgp")
    views = [undistort_frame(view, 240).held() for view in capture.views]
    measured = measured_depths(capture, views)
    masks = ego_masks(views, completed_depths(capture, views, measured, sky_masks(views, measured, capture.up)))
    assert set(masks) == {"CAMERA_05", "CAMERA_06", "CAMERA_07", "CAMERA_08", "CAMERA_09"}
    rear = masks["CAMERA_09"]
    assert not rear[-15:, 40:200].any() and rear[: round(0.7 * len(rear))].all()
