from dataclasses import replace

import numpy as np
import pytest

from gsrain_engine.editor.viewport.camera import home_camera
from gsrain_engine.rain.settings import RainSettings
from gsrain_engine.rain.simulation import RainSimulation
from gsrain_engine.render.cpu.renderer import CpuRenderer
from gsrain_engine.render.sequence import FrameSequence, render_image
from gsrain_engine.scene.gaussians import sh_from_color
from small_scene import small_scene

RAIN = RainSettings(intensity_mm_h=30.0, exposure_s=0.02)


def test_it_is_the_frame_that_a_sequence_has_at_that_moment():
    scene, renderer = small_scene(), CpuRenderer()
    camera = home_camera(scene, 96, 64)
    sequence = FrameSequence(scene, RainSimulation.start(RAIN), camera, 96, 64, fps=2.0)
    frame = sequence.frame(renderer, 3, sequence.sky(renderer), with_depth=True)
    still = render_image(renderer, scene, RAIN, camera, 1.5, with_depth=True)
    assert np.array_equal(still.rgba, frame.rgba) and np.array_equal(still.depth, frame.depth)
    assert not np.array_equal(still.rgba, render_image(renderer, scene, RAIN, camera, 1.6).rgba)
    assert render_image(renderer, scene, RAIN, camera).depth is None


def test_a_wet_scene_is_wet_without_rain():
    scene, renderer = small_scene(), CpuRenderer()
    camera = home_camera(scene, 96, 64)
    road = scene.member("layers/road").gaussians
    red = sh_from_color(np.tile(np.array([0.9, 0.1, 0.1], np.float32), (len(road), 1)))
    wet = replace(scene, layers=(replace(scene.layers[0], wet_sh=red), *scene.layers[1:]))
    clear, soaked = (
        render_image(renderer, wet, RainSettings(wetness=w), camera).to_uint8().astype(float) for w in (0, 1)
    )
    assert (soaked - clear)[48:, :, 0].mean() > 50  # the road
    assert np.abs((soaked - clear)[:16]).mean() < 10  # the sky, but for what reaches up from the road
    assert np.array_equal(render_image(renderer, wet, RainSettings(), camera).to_uint8(), clear)


def test_a_calibration_that_is_not_there_is_named():
    scene = small_scene()
    with pytest.raises(ValueError, match="nowhere"):
        render_image(
            CpuRenderer(), scene, RainSettings(intensity_mm_h=1, calibration="nowhere"), home_camera(scene, 96, 64)
        )
