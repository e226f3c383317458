"""Axes of normals, and the one channel that is made of them."""

import numpy as np
import pytest
from PIL import Image

from gsrain_engine.appearance.normal_models import (
    from_right_down_outward,
    from_right_up_backward,
)
from gsrain_engine.appearance.normals import (
    normals_to_gray,
    right_down_outward,
)
from gsrain_engine.scene.camera import Camera, look_at

UP = np.array([0.0, 0.0, 1.0])


def camera(forward=(1.0, 0.0, 0.0)) -> Camera:
    eye = np.array([3.0, -2.0, 1.5])
    return Camera.from_fov(8, 6, 60, look_at(eye, eye + np.array(forward), UP))


def everywhere(normal) -> np.ndarray:
    return np.broadcast_to(np.float32(normal), (6, 8, 3))


# Looking along +x: right is -y, so that a wall on the left, which faces right, has normal (0, -1, 0).
GROUND, FACING, ON_THE_LEFT, CEILING = (0, 0, 1), (-1, 0, 0), (0, -1, 0), (0, 0, -1)


@pytest.mark.parametrize(
    ("normal", "outward", "backward"),
    [
        (GROUND, (0, 1, 0), (0, 1, 0)),
        (FACING, (0, 0, 1), (0, 0, 1)),
        (ON_THE_LEFT, (-1, 0, 0), (1, 0, 0)),
        (CEILING, (0, -1, 0), (0, -1, 0)),
    ],
)
def test_conventions_of_estimators(normal, outward, backward):
    np.testing.assert_allclose(right_down_outward(everywhere(normal), camera()), everywhere(outward), atol=1e-6)
    np.testing.assert_allclose(from_right_down_outward(everywhere(outward), camera()), everywhere(normal), atol=1e-6)
    np.testing.assert_allclose(from_right_up_backward(everywhere(backward), camera()), everywhere(normal), atol=1e-6)


def test_there_and_back_with_a_turned_camera():
    normals = np.random.default_rng(4).normal(size=(6, 8, 3))
    turned = camera((0.5, 0.7, -0.3))
    np.testing.assert_allclose(from_right_down_outward(right_down_outward(normals, turned), turned), normals, atol=1e-5)


# Shares of white that Pillow draws for normals away from the eye; away from the left wall is to the left.
@pytest.mark.parametrize(
    ("normal", "gray"), [(GROUND, 0.79), (FACING, 0.56), ((0, 1, 0), 0.65), (ON_THE_LEFT, 0.35), (CEILING, 0.21)]
)
def test_luma_is_what_pillow_makes_of_the_picture_of_normals(normal, gray):
    guide = normals_to_gray(everywhere(normal), camera(), "luma")
    assert (guide + 1) / 2 == pytest.approx(np.full((6, 8), gray), abs=0.006)
    picture = np.round((right_down_outward(everywhere(normal), camera()) + 1) / 2 * 255).astype(np.uint8)
    assert np.asarray(Image.fromarray(picture).convert("L")) / 255 == pytest.approx((guide + 1) / 2, abs=0.006)


@pytest.mark.parametrize("forward", [(1, 0, 0), (0.2, 1, -0.4), (-1, 0.1, 0.3)])
def test_up_is_the_same_whatever_way_the_camera_turns(forward):
    for normal, value in ((GROUND, 1), (FACING, 0), (CEILING, -1)):
        assert (normals_to_gray(everywhere(normal), camera(forward), "up") == value).all()


@pytest.mark.parametrize("kind", ["up", "luma"])
def test_what_is_not_known_and_the_sky_are_neither(kind):
    guide = normals_to_gray(everywhere((0, 0, 0)), camera(), kind)
    assert guide.dtype == np.float32
    assert (guide == 0).all()
