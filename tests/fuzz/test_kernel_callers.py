"""Hostile numbers reach kernels without an end of the process, and sound pictures afterwards are as before."""

from random import Random

import numpy as np

from gsrain_engine.editor.viewport.camera import home_camera
from gsrain_engine.rain.settings import RainSettings
from gsrain_engine.render.sequence import render_image
from small_scene import small_scene

from .kernel_callers import kernel_callers

_CALLS = 30


def test_hostile_numbers_end_in_a_picture_or_a_refusal() -> None:
    with kernel_callers() as callers:

        def sound() -> np.ndarray:
            camera = home_camera(small_scene(), 48, 32)
            return render_image(callers.renderer, small_scene(), RainSettings(intensity_mm_h=8.5), camera, 0.5).rgba

        before = sound()
        found = [callers.call(Random(seed)) for seed in range(_CALLS)]
        np.testing.assert_array_equal(sound(), before)
    assert found.count("drawn") > _CALLS / 3
