"""Renderers without a window, several of which are open at a time."""

import contextlib

import numpy as np

from gsrain_engine.backends import open_renderer
from gsrain_engine.scene.camera import Camera
from gsrain_engine.scene.scene import DrawItem
from render.cpu.raster_scenes import random_gaussians

CAMERA = Camera(64, 48, 60.0, 60.0, 32.0, 24.0)


def picture(renderer, seed):
    renderer.draw([DrawItem(random_gaussians(200, seed), np.eye(4))], CAMERA)
    return renderer.read().rgba


def test_they_take_turns():
    with open_renderer("opengl") as first, open_renderer("opengl") as second:
        pictures = [picture(first, 1), picture(second, 2), picture(second, 1), picture(first, 2)]
    assert np.array_equal(pictures[0], pictures[2])
    assert np.array_equal(pictures[1], pictures[3])
    assert not np.array_equal(pictures[0], pictures[1])
    with open_renderer("opengl") as third:
        assert np.array_equal(picture(third, 1), pictures[0])


def test_they_close_in_any_order():
    stacks = [contextlib.ExitStack() for _ in range(2)]
    first, second = (stack.enter_context(open_renderer("opengl")) for stack in stacks)
    expected = picture(first, 1)
    stacks[0].close()
    assert np.array_equal(picture(second, 1), expected)
    stacks[1].close()
