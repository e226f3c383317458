import numpy as np
import pytest

from gsrain_engine.datasets.capture import Capture, CaptureError, CaptureFrame, Lens
from gsrain_engine.scene.camera import Camera


def _view(name: str, **more: np.ndarray) -> CaptureFrame:
    return CaptureFrame(name, Camera(8, 6, 10.0, 10.0, 4.0, 3.0), np.zeros((6, 8, 3), np.uint8), **more)


def test_says_what_every_view_has() -> None:
    depth = np.ones((6, 8), np.float32)
    labelled = _view("b", depth_source=lambda: depth, labels_source=np.zeros((6, 8), np.uint8))
    both = Capture("two", (_view("a", depth_source=depth), labelled))
    assert both.has == {"depth"}
    assert len(both) == 2
    assert [view.name for view in both] == ["a", "b"]
    assert both[1].labels is not None
    assert both[1].depth is depth


def test_reads_pixels_when_they_are_asked_for() -> None:
    read: list[str] = []

    def picture() -> np.ndarray:
        read.append("image")
        return np.zeros((6, 8, 3), np.uint8)

    view = CaptureFrame("a", Camera(8, 6, 10.0, 10.0, 4.0, 3.0), picture)
    assert not read
    held = view.held()
    assert held.image is held.image
    assert read == ["image"]


def test_a_lens_has_as_many_coefficients_as_its_model() -> None:
    assert Lens("fisheye", (0.1, 0.0, 0.0, 0.0)).model == "fisheye"
    with pytest.raises(ValueError, match="not 3"):
        Lens("opencv", (0.1, 0.0, 0.0))


def test_refuses_a_picture_of_another_size() -> None:
    view = CaptureFrame("a", Camera(9, 6, 10.0, 10.0, 4.0, 3.0), np.zeros((6, 8, 3), np.uint8))
    with pytest.raises(CaptureError, match=r"view 'a': image is \(6, 8\), its camera says \(6, 9\)"):
        view.image.sum()


def test_refuses_two_views_of_one_name() -> None:
    with pytest.raises(ValueError, match="several views named 'a'"):
        Capture("two", (_view("a"), _view("a")))
