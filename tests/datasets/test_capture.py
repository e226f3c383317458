import numpy as np
import pytest

from gsrain_engine.datasets.capture import Capture, View
from gsrain_engine.scene.camera import Camera


def _view(name: str, **more: np.ndarray) -> View:
    return View(name, Camera(8, 6, 10.0, 10.0, 4.0, 3.0), np.zeros((6, 8, 3), np.uint8), **more)


def test_says_what_every_view_has() -> None:
    depth = np.ones((6, 8), np.float32)
    both = Capture("two", (_view("a", depth=depth), _view("b", depth=depth, labels=np.zeros((6, 8), np.uint8))))
    assert both.has == {"depth"}
    assert len(both) == 2
    assert [view.name for view in both] == ["a", "b"]
    assert both[1].labels is not None


def test_refuses_a_picture_of_another_size() -> None:
    with pytest.raises(ValueError, match=r"view 'a': image is \(6, 8\), its camera says \(6, 9\)"):
        View("a", Camera(9, 6, 10.0, 10.0, 4.0, 3.0), np.zeros((6, 8, 3), np.uint8))


def test_refuses_two_views_of_one_name() -> None:
    with pytest.raises(ValueError, match="several views named 'a'"):
        Capture("two", (_view("a"), _view("a")))
