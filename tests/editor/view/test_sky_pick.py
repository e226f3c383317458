"""The color of a part of the picture, for drops to take."""

import numpy as np
import pytest

from gsrain_engine.backends import open_renderer
from gsrain_engine.editor.viewport.picking import SkyColorPick, mean_color_in_rectangle
from gsrain_engine.render.draw import RenderView
from gsrain_engine.scene.camera import Camera, look_at
from gsrain_engine.scene.geometry import linear_to_srgb, srgb_to_linear
from small_scene import small_scene


@pytest.fixture(scope="module")
def renderer():
    with open_renderer("cpu") as renderer:
        yield renderer


@pytest.fixture
def shot():
    eye = np.array([0.0, 0, 1.5])
    return RenderView(Camera.from_fov(120, 80, 50.0, look_at(eye, eye + [1.0, 0, 0], np.array([0.0, 0, 1]))))


def picture(renderer, shot):
    renderer.draw(small_scene().parts(0.0), shot.camera)
    rgba = renderer.read().rgba.astype(np.float64)
    return rgba[..., :3] + (1 - rgba[..., 3:]) * np.array([0.2, 0.0, 0.0])


def test_a_rectangle_is_averaged_in_linear_light(renderer, shot):
    """Half sky, half wall: the mean of display values would be darker."""
    color = mean_color_in_rectangle(renderer, small_scene(), shot, SkyColorPick(0.25, 0.1, 0.75, 0.6), (0.2, 0.0, 0.0))
    shown = np.clip(picture(renderer, shot)[8:48, 30:90].reshape(-1, 3), 0, 1)
    expected = linear_to_srgb(srgb_to_linear(shown).mean(axis=0))
    assert color == pytest.approx(expected, abs=1e-6)
    assert np.abs(np.array(color) - shown.mean(axis=0)).max() > 0.005
