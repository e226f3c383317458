from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from gsrain_engine.datasets.capture import Capture, CaptureError, CaptureFrame, Lens
from gsrain_engine.datasets.capture_folder import write_views
from gsrain_engine.datasets.image_override import flat_name, with_images
from gsrain_engine.datasets.undistort import undistort_frame
from gsrain_engine.scene.camera import Camera


def views(*names: str, sensor: str = "") -> tuple[CaptureFrame, ...]:
    image = np.zeros((8, 12, 3), np.uint8)
    return tuple(
        CaptureFrame(name, Camera(12, 8, 10, 10, 6, 4), image, float(k), sensor) for k, name in enumerate(names)
    )


def test_other_pictures_are_matched_by_name_and_missing_ones_are_reported(tmp_path):
    capture = Capture("c", (*views("a/one", "two", "three.jpg"), *views("four", sensor="CAM")))
    capture = replace(capture, views=(capture[0], replace(capture[1], sensor="CAM"), *capture.views[2:]))
    (tmp_path / "CAM").mkdir()
    for k, name in enumerate(["one.png", "CAM/two.png", "three.png", "five.png"]):
        Image.fromarray(np.full((8, 12, 3), 10 * (k + 1), np.uint8)).save(tmp_path / name)
    changed = with_images(capture, tmp_path)
    assert [view.name for view in changed] == ["a/one", "two", "three.jpg"]
    assert [int(view.image[0, 0, 0]) for view in changed] == [10, 20, 30]
    assert "1 views have no picture" in changed.problems[0] and "'four' for one" in changed.problems[0]
    assert "1 pictures" in changed.problems[1] and "'five' for one" in changed.problems[1]


def test_pictures_of_another_size_are_resized_and_strange_ones_refused(tmp_path):
    capture = Capture("c", views("one"))
    Image.fromarray(np.full((16, 24, 3), 90, np.uint8)).save(tmp_path / "one.png")
    assert with_images(capture, tmp_path)[0].image.shape == (8, 12, 3)
    Image.fromarray(np.full((16, 16, 3), 90, np.uint8)).save(tmp_path / "one.png")
    with pytest.raises(CaptureError, match="is 16x16 px, its view is 12x8: other proportions"):
        _ = with_images(capture, tmp_path)[0].image
    (tmp_path / "one.png").write_bytes(b"no picture")
    with pytest.raises(CaptureError, match="one.png"):
        _ = with_images(capture, tmp_path)[0].image
    (tmp_path / "one.png").unlink()
    with pytest.raises(CaptureError, match="has no picture of a view; expected one.png"):
        with_images(capture, tmp_path)
    with pytest.raises(CaptureError, match="no such folder"):
        with_images(capture, tmp_path / "nowhere")


@pytest.mark.parametrize("below", [".", "images"])
def test_pictures_with_cameras_are_without_distortion_and_so_are_the_views_then(tmp_path, below):
    bent = replace(views("CAM/one.jpg")[0], lens=Lens("opencv", (-0.2, 0.0, 0.0, 0.0)))
    straight = replace(undistort_frame(bent, 6), name=flat_name(bent.name), mask_source=None)
    list(write_views(tmp_path / below, [replace(straight, image_source=np.full((4, 6, 3), 77, np.uint8))]))
    changed = with_images(Capture("c", (bent,)), tmp_path)
    assert changed.problems == ()
    assert changed[0].lens is None
    assert (changed[0].camera.width, changed[0].camera.fx) == (6, 5)
    assert (changed[0].image == 77).all()
    assert changed[0].mask is not None  # what the lens did not see is still known
