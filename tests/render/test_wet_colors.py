"""Wet colors in OpenGL, in the sky, in sequences and in the live view: blended by a number, never uploaded twice."""

from dataclasses import replace

import msgspec
import numpy as np
import pytest

from gsrain_engine.editor.drawing import live_view
from gsrain_engine.editor.drawing.frame import DrawResult
from gsrain_engine.editor.drawing.live_view import LiveView
from gsrain_engine.editor.editor import Editor
from gsrain_engine.editor.edits.members import replace_scene
from gsrain_engine.editor.viewport_state import PendingScene
from gsrain_engine.rain.keyframes import RainKeyframe, RainKeyframes
from gsrain_engine.rain.settings import RainSettings, load_preset
from gsrain_engine.rain.simulation import RainSimulation
from gsrain_engine.rain.wetness import wetness
from gsrain_engine.render.cpu.renderer import CpuRenderer
from gsrain_engine.render.opengl.renderer import SplatRenderer
from gsrain_engine.render.sequence import FrameSequence
from gsrain_engine.render.sky_color import SkyColor, sky_color
from gsrain_engine.scene.camera import Camera, look_at
from gsrain_engine.scene.flags import BitMask
from gsrain_engine.scene.transforms import with_wet_colors_of, with_wetness_baked
from live_frames import draw_frame
from render.cpu.raster_scenes import small_camera
from render.cpu.test_marked_parts import COLORS
from render.cpu.test_wet_colors import blended, wet_part
from small_scene import small_scene

SIZE = (96, 64)
HERE = Camera.from_fov(96, 64, 50.0, look_at(np.array([0.0, 0, 1.5]), np.array([1.0, 0, 1.5]), np.array([0.0, 0, 1])))


def drawn(renderer, *parts):
    renderer.draw(parts, small_camera())
    return renderer.read().rgba


def darker(scene, share=0.5):
    """The scene with wet colors: the clear ones, darker."""
    for each in scene.members:
        sh = each.gaussians.sh
        scene = scene.with_member(each.key, wet_sh=sh - np.float32(share))
    return scene


@pytest.mark.parametrize("harmonics", ["single", "half", "byte"])
@pytest.mark.parametrize("degree", [0, 1, 3])
def test_opengl_blends_as_the_processor_does(context, harmonics, degree):
    opengl, part = SplatRenderer(context, harmonics=harmonics), wet_part(degree=degree)
    clear = drawn(opengl, part._replace(wet_sh=None)).tobytes()
    assert drawn(opengl, part).tobytes() == clear
    soaked = part._replace(wetness=1.0)
    assert drawn(opengl, soaked).tobytes() == drawn(opengl, blended(soaked)).tobytes() != clear
    between = part._replace(wetness=0.4, colors=COLORS, selected=BitMask.of(np.arange(300) % 3 == 0))
    atol = {"single": 2e-3, "half": 3e-3, "byte": 5e-2}[harmonics]
    np.testing.assert_allclose(drawn(opengl, between), drawn(CpuRenderer(), between), atol=atol)
    dry = wet_part(degree=2)._replace(wet_sh=None)
    mixed = [drawn(opengl, dry, each) for each in (soaked, blended(soaked))]
    np.testing.assert_allclose(*mixed, atol=1e-6)


def test_wet_colours_are_uploaded_once(context):
    renderer, part = SplatRenderer(context), wet_part()
    for share in (0.3, 0.0, 0.9):
        drawn(renderer, part._replace(wetness=share))
    wet = renderer.arrays.buffers(part.gaussians, part.wet_sh).wet_sh[0].glo
    for share in (0.1, 0.0, 1.0):
        drawn(renderer, part._replace(wetness=share))
        assert renderer.arrays.missing(part.gaussians, part.wet_sh) == 0
    assert renderer.arrays.buffers(part.gaussians, part.wet_sh).wet_sh[0].glo == wet


def test_nobody_uploads_wet_colours_that_are_not_seen(context):
    renderer, part = SplatRenderer(context), wet_part()
    drawn(renderer, part)
    assert renderer.arrays.missing(part.gaussians) == 0
    assert renderer.arrays.missing(part.gaussians, part.wet_sh) == 300


def test_wet_colours_at_rest_outlive_what_else_comes(context, monkeypatch):
    """With no room for resting arrays, those of the present scene stay while it is dry."""
    monkeypatch.setattr("gsrain_engine.render.opengl.buffers.RESTING_BYTES", 0)
    renderer, part = SplatRenderer(context), wet_part()
    drawn(renderer, part._replace(wetness=0.5))
    drawn(renderer, part)
    assert renderer.arrays.missing(part.gaussians, part.wet_sh) == 0
    drawn(renderer, wet_part(degree=0))
    assert renderer.arrays.missing(part.gaussians, part.wet_sh) == 300


def test_the_sky_gets_as_dark_as_it_looks():
    scene, renderer = darker(small_scene()), CpuRenderer()
    sky = sky_color(renderer, scene, HERE)
    assert sky.at(0.0) == sky_color(renderer, small_scene(), HERE).color
    assert sky.at(1.0) == sky_color(renderer, with_wetness_baked(scene, 1.0), HERE).color
    between = sky_color(renderer, with_wetness_baked(scene, 0.5), HERE).color
    assert sky.at(0.5) == pytest.approx(between, abs=2e-3)
    assert max(sky.at(0.5)) < max(sky.at(0.0)) - 0.05
    assert SkyColor((0.1, 0.2, 0.3), True).at(0.7) == (0.1, 0.2, 0.3)


def test_a_sequence_gets_wet_as_its_weather_does():
    """Frame by frame as the same scene in the colors of that wetness, drops included."""
    keys = (RainKeyframe(time_s=0, intensity_mm_h=0.0), RainKeyframe(time_s=4, intensity_mm_h=12.0))
    rain = RainSimulation.start(RainSettings(seed=3), weather=RainKeyframes(keys=keys))
    scene, renderer = darker(small_scene()), CpuRenderer()
    sequence = FrameSequence(scene, rain, HERE, *SIZE, fps=1.0)
    sky = sequence.sky(renderer)
    frames = [sequence.frame(renderer, number, sky).rgba for number in range(5)]
    brightness = [frame[..., :3].mean() for frame in frames]
    assert brightness == sorted(brightness, reverse=True)
    assert brightness[0] > brightness[4] + 0.05
    np.testing.assert_array_equal(frames[0], sequence.frame(renderer, 0, None).rgba)
    alone = replace(sequence, scene=small_scene(), rainfall=rain)
    assert np.abs(frames[4] - alone.frame(renderer, 4, SkyColor(sky.at(wetness(12.0)), True)).rgba).mean() > 0.05
    held = RainSimulation.start(RainSettings(seed=3, wetness=wetness(12.0)), weather=RainKeyframes(keys=keys))
    fixed = replace(sequence, rainfall=held)
    np.testing.assert_array_equal(fixed.frame(renderer, 4, sky).rgba, frames[4])


@pytest.fixture
def editor():
    opened = Editor(small_scene())
    opened.playback.clock.playing = False
    yield opened
    opened.close()


def picture(editor, view):
    (texture,) = draw_frame(editor, view, SIZE)
    return np.frombuffer(texture.read(), np.uint8)


def rain_at(editor, intensity_mm_h, **fields):
    clear = msgspec.structs.asdict(load_preset("clear"))
    editor.document.change_rain("Rain", **clear | {"intensity_mm_h": intensity_mm_h, **fields})


def test_the_slider_moves_the_appearance(context, editor):
    view = LiveView(context, "opengl")
    clear = picture(editor, view)
    editor.document.edit("Wet colors", replace_scene, darker(editor.document.scene))
    assert np.array_equal(picture(editor, view), clear)
    rain_at(editor, 0.0, wetness=1.0)
    soaked = picture(editor, view)
    assert soaked.mean() < clear.mean() - 10
    rain_at(editor, 0.0, wetness=0.5)
    assert clear.mean() > picture(editor, view).mean() > soaked.mean()
    rain_at(editor, 12.0, streaks=False, haze=False)
    assert soaked.mean() < picture(editor, view).mean() < soaked.mean() + 5
    editor.document.undo()
    editor.document.undo()
    editor.document.undo()
    assert np.array_equal(picture(editor, view), clear)


def test_drops_take_the_wet_skys_colour(context, editor):
    view = LiveView(context, "opengl")
    editor.document.edit("Wet colors", replace_scene, darker(editor.document.scene))
    rain_at(editor, 1.2)
    picture(editor, view)
    light = editor.live_rain.sky
    rain_at(editor, 12.0)
    assert max(editor.live_rain.sky) < max(light) - 0.02
    rain_at(editor, 12.0, wetness=0.0)
    exact = sky_color(SplatRenderer(context), editor.document.scene, editor.viewport.shot(*SIZE).camera)
    while editor.live_rain.sky_is_stale:
        picture(editor, view)
    assert editor.live_rain.sky == pytest.approx(exact.color, abs=1e-6)


def test_finished_wet_colours_are_one_step_and_come_in_slices(context, editor, monkeypatch):
    monkeypatch.setattr(live_view, "_CHUNK_SIZE", 0)
    monkeypatch.setattr(live_view, "_UPLOAD_S", 1e-9)
    rain_at(editor, 12.0, streaks=False, haze=False)
    view = LiveView(context, "opengl")
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


def test_wet_colours_that_fit_nothing_are_reported(editor):
    editor.viewport.staged = PendingScene("Make it rainy", editor.document.scene, change=with_wet_colors_of)
    editor.apply(DrawResult(is_pending_ready=True))
    assert (
        editor.status.problem
        == "The scene has changed so much that the new wet colors fit none of its layers and actors."
    )
    assert editor.document.history.undo_label is None


def test_the_clear_side_is_dry(context, editor):
    editor.document.edit("Wet colors", replace_scene, darker(editor.document.scene))
    rain_at(editor, 12.0, wetness=0.9)
    editor.viewport.options.split = "clear | rainy"
    left, right = draw_frame(editor, LiveView(context, "opengl"), SIZE)
    assert np.frombuffer(left.read(), np.uint8).mean() > np.frombuffer(right.read(), np.uint8).mean() + 10
