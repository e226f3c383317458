"""Wet colors in the sky, in sequences and in the live view: they follow the rain."""

from dataclasses import replace

import msgspec
import numpy as np
import pytest

from gsrain_engine.editor.edits.members import replace_scene
from gsrain_engine.editor.viewport_state import PendingScene
from gsrain_engine.rain.frame import SkyLight
from gsrain_engine.rain.keyframes import RainKeyframe, RainKeyframes
from gsrain_engine.rain.settings import RainSettings, load_preset
from gsrain_engine.rain.simulation import RainSimulation
from gsrain_engine.rain.wetness import wetness
from gsrain_engine.render.cpu.renderer import CpuRenderer
from gsrain_engine.render.opengl.renderer import SplatRenderer
from gsrain_engine.render.sequence import FrameSequence
from gsrain_engine.render.sky_color import SkyColor, sky_color
from gsrain_engine.scene.camera import Camera, look_at
from gsrain_engine.scene.transforms import with_wet_colors_of, with_wetness_baked
from live_frames import SIZE, draw_frame, picture
from small_scene import small_scene

HERE = Camera.from_fov(96, 64, 50.0, look_at(np.array([0.0, 0, 1.5]), np.array([1.0, 0, 1.5]), np.array([0.0, 0, 1])))


def darker(scene, share=0.5):
    """The scene with wet colors: the clear ones, darker."""
    for each in scene.members:
        scene = scene.with_member(each.key, wet_sh=each.gaussians.sh - np.float32(share))
    return scene


def rain_at(editor, intensity_mm_h, **fields):
    clear = msgspec.structs.asdict(load_preset("clear"))
    editor.document.change_rain("Rain", **clear | {"intensity_mm_h": intensity_mm_h, **fields})


def test_the_sky_gets_as_dark_as_it_looks():
    scene, renderer = darker(small_scene()), CpuRenderer()
    sky = sky_color(renderer, scene, HERE)
    assert sky.at(0.0) == sky_color(renderer, small_scene(), HERE).light
    assert sky.at(1.0) == sky_color(renderer, with_wetness_baked(scene, 1.0), HERE).light
    between = sky_color(renderer, with_wetness_baked(scene, 0.5), HERE).light
    assert np.array(sky.at(0.5)) == pytest.approx(np.array(between), abs=2e-3)
    assert max(sky.at(0.5).drops) < max(sky.at(0.0).drops) - 0.05
    light = SkyLight((0.1, 0.2, 0.3), (0.2, 0.3, 0.4))
    assert SkyColor(light, True).at(0.7) is light


def test_a_sequence_gets_wet_as_its_weather_does():
    """Frame by frame as the same scene in the colors of that wetness, drops included."""
    keys = (RainKeyframe(time_s=0, intensity_mm_h=0.0), RainKeyframe(time_s=4, intensity_mm_h=1.2))
    rain = RainSimulation.start(RainSettings(seed=3), weather=RainKeyframes(keys=keys))
    scene, renderer = darker(small_scene()), CpuRenderer()
    sequence = FrameSequence(scene, rain, HERE, *SIZE, fps=1.0)
    sky = sequence.sky(renderer)
    frames = [sequence.frame(renderer, number, sky).rgba for number in range(5)]
    brightness = [frame[..., :3].mean() for frame in frames]
    assert brightness[1:] == sorted(brightness[1:], reverse=True)
    assert brightness[0] > brightness[4] + 0.05
    np.testing.assert_array_equal(frames[0], sequence.frame(renderer, 0, None).rgba)
    alone = replace(sequence, scene=small_scene(), rainfall=rain)
    assert np.abs(frames[4] - alone.frame(renderer, 4, SkyColor(sky.at(1.0), True)).rgba).mean() > 0.05
    held = RainSimulation.start(RainSettings(seed=3, wetness=wetness(1.2)), weather=RainKeyframes(keys=keys))
    fixed = replace(sequence, rainfall=held)
    np.testing.assert_array_equal(fixed.frame(renderer, 4, sky).rgba, frames[4])


def test_the_slider_moves_the_appearance_but_the_clear_side_is_dry(context, editor, view):
    clear = picture(editor, view)
    editor.document.edit("Wet colors", replace_scene, darker(editor.document.scene))
    assert np.array_equal(picture(editor, view), clear)
    rain_at(editor, 0.0, wetness=1.0)
    soaked = picture(editor, view)
    assert soaked.mean() < clear.mean() - 10
    rain_at(editor, 0.0, wetness=0.5)
    assert clear.mean() > picture(editor, view).mean() > soaked.mean()
    rain_at(editor, 12.0, streaks=False, haze="none")
    assert soaked.mean() <= picture(editor, view).mean() < soaked.mean() + 5
    exact = sky_color(SplatRenderer(context), editor.document.scene, editor.viewport.shot(*SIZE).camera)
    assert exact.wet_light is not None
    while editor.live_rain.sky_is_stale:
        picture(editor, view)
    assert np.array(editor.live_rain.sky) == pytest.approx(np.array(exact.at(1.0)), abs=1e-6)
    editor.viewport.options.split = "clear | rainy"
    left, right = draw_frame(editor, view, SIZE)
    assert np.frombuffer(left.read(), np.uint8).mean() > np.frombuffer(right.read(), np.uint8).mean() + 10
    editor.viewport.options.split = "off"
    for _ in range(3):
        editor.document.undo()
    assert np.array_equal(picture(editor, view), clear)


def test_finished_wet_colors_are_one_step_and_come_in_slices(editor, slow_view):
    rain_at(editor, 12.0, streaks=False, haze="none")
    view = slow_view
    clear, before = picture(editor, view), editor.document.scene
    editor.viewport.staged = PendingScene("Make it rainy", darker(editor.document.scene), change=with_wet_colors_of)
    shown = []
    while editor.viewport.staged is not None:
        shown.append(picture(editor, view))
    assert len(shown) >= 3  # a slice a layer
    assert all(np.array_equal(each, clear) for each in shown[:-1])
    assert [new.gaussians for new in editor.document.scene.members] == [old.gaussians for old in before.members]
    wet = picture(editor, view)
    assert wet.mean() < clear.mean() - 10
    editor.document.undo()
    assert editor.document.scene is before
    assert np.array_equal(picture(editor, view), clear)
    editor.document.redo()
    assert np.array_equal(picture(editor, view), wet)
