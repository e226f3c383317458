"""Pictures drawn on a thread: as those drawn at once, while the editor goes on; errors; and what changes in time."""

import itertools
import threading
from dataclasses import replace
from types import SimpleNamespace

import msgspec
import numpy as np
import pytest
from PIL import Image

from gsrain_engine.editor import viewport_state
from gsrain_engine.editor.drawing import picture_thread
from gsrain_engine.editor.drawing.live_view import LiveView, MosaicImages
from gsrain_engine.editor.drawing.picture_thread import PictureThread
from gsrain_engine.editor.edits.members import replace_scene
from gsrain_engine.editor.viewport.options import LEVELS
from gsrain_engine.editor.viewport_state import PendingScene
from gsrain_engine.kernels import kernel
from gsrain_engine.rain.settings import load_preset
from gsrain_engine.render.opengl.context import NoOpenGLError, open_context
from live_frames import SIZE, darkened, draw_frame
from repository import REPOSITORY
from small_scene import small_scene


class OwnContext:
    """A context of the thread's own."""

    def enter(self):
        self._context = open_context("egl")
        return self._context.__enter__()

    def finish(self):
        self._context.finish()

    def leave(self):
        self._context.__exit__(None, None, None)
        self._context.release()


@pytest.fixture
def pictures():
    try:
        open_context("egl").release()
    except NoOpenGLError as error:
        pytest.skip(str(error))
    thread = PictureThread(OwnContext(), "opengl")
    yield thread
    thread.close()
    thread.close()


def begin(editor, pictures):
    pictures.begin(editor.render_input(*SIZE), editor.mosaic_input())


def finish(editor, pictures):
    """Take the picture that is being drawn, as the window does."""
    pictures.wait()
    taken = pictures.take()
    editor.apply(taken.result)
    return taken.result


def rain(editor):
    editor.document.change_rain("Rain", **msgspec.structs.asdict(load_preset("8.5")))


def test_a_picture_of_the_thread_is_that_drawn_at_once_and_the_editor_may_change_meanwhile(
    editor, pictures, view, tmp_path
):
    rain(editor)
    first, other = editor.document.scene, darkened(editor.document.scene)
    for number, draw in enumerate((lambda: draw_frame(editor, view), lambda: begin(editor, pictures))):
        editor.viewport.screenshot = tmp_path / f"{number}.png"
        draw()
    editor.document.edit("Darker", replace_scene, other)
    editor.viewport.screenshot, editor.viewport.staged = tmp_path / "2.png", PendingScene("More", first)
    finish(editor, pictures)
    at_once, on_thread = (np.asarray(Image.open(tmp_path / f"{number}.png")) for number in (0, 1))
    assert np.array_equal(at_once, on_thread) and at_once.any()
    # Nothing of the older frame is taken for an answer about the present one.
    assert editor.viewport.screenshot == tmp_path / "2.png"
    assert editor.viewport.staged is not None and editor.document.scene is other
    assert editor.live_rain.sky_is_stale
    assert not pictures.is_current
    begin(editor, pictures)
    finish(editor, pictures)
    assert editor.viewport.screenshot is None and editor.viewport.staged is None
    assert not np.array_equal(np.asarray(Image.open(tmp_path / "2.png")), on_thread)
    for _ in range(40):  # the new scene's sky is sampled an image at a time
        begin(editor, pictures)
        finish(editor, pictures)
    assert pictures.is_current and not editor.live_rain.sky_is_stale


def test_the_picture_on_the_screen_stays_while_the_next_is_drawn(editor, view):
    (first,) = draw_frame(editor, view)
    pixels = first.read()
    editor.document.edit("Darker", replace_scene, darkened(editor.document.scene))
    (second,) = draw_frame(editor, view)
    assert first.read() == pixels != second.read()
    (third,) = draw_frame(editor, view, (SIZE[0], 2 * SIZE[1]))
    assert second.read() and third.size == (SIZE[0], 2 * SIZE[1])


def test_an_error_of_one_picture_is_raised_once_and_the_next_is_drawn(editor, pictures, monkeypatch):
    with monkeypatch.context() as broken:
        broken.setattr(LiveView, "draw", lambda view, frame: 1 / 0)
        begin(editor, pictures)
        pictures.wait()
    with pytest.raises(ZeroDivisionError):
        pictures.take()
    assert pictures.take() is None
    begin(editor, pictures)
    assert finish(editor, pictures).drawn is not None


def test_a_picture_of_full_quality_is_given_up_for_a_newer_view_but_never_two_in_a_row(editor, monkeypatch, pictures):
    rain(editor)
    pictures.close()
    pictures = PictureThread(OwnContext(), "cpu")
    while not pictures.is_settled:  # kernels are loaded
        begin(editor, pictures)
        finish(editor, pictures)
    gate, draw = threading.Event(), LiveView.draw
    monkeypatch.setattr(LiveView, "draw", lambda view, frame: (gate.wait(60), draw(view, frame))[1])

    def drawn(change):
        """Begin a picture, change something while it is drawn, and return whether it was finished."""
        gate.clear()
        begin(editor, pictures)
        change()
        viewport = editor.viewport
        pictures.reconsider(viewport.shot(*SIZE), editor.split_panes, viewport.options.look)
        gate.set()
        pictures.wait()
        taken = pictures.take()
        if taken is not None:
            editor.apply(taken.result)
        return taken is not None and taken.result.drawn is not None

    def orbit():
        editor.viewport.navigation.orbit(0.3, 0.0)

    orbit()
    last = pictures.last
    assert not drawn(orbit) and pictures.last is last and not pictures.is_drawing
    assert drawn(orbit)
    assert drawn(lambda: None)
    editor.document.change_rain("Seed", seed=3)
    assert not drawn(lambda: editor.document.change_rain("Seed", seed=4))
    assert drawn(lambda: None) and drawn(orbit) is False  # the last view is up to date, so that nothing was drawn
    pictures.close()


def test_pictures_that_take_long_are_drawn_for_when_they_are_on_the_screen(editor, monkeypatch, tmp_path):
    """Those of the processor, which are warped when something goes on in another way than expected."""
    pictures = PictureThread(OwnContext(), "cpu")
    while not (pictures.is_settled and pictures.last.reliefs):
        begin(editor, pictures)
        finish(editor, pictures)
    monkeypatch.setattr(picture_thread, "_SHORT_S", 0.0)
    editor.viewport.ride(True)
    clock = editor.playback.clock
    clock.seek(1.0)
    clock.playing = True
    begin(editor, pictures)
    finish(editor, pictures)
    assert 0 < pictures.ahead_s <= 0.6
    monkeypatch.setattr(picture_thread, "_SHORT_S", 60.0)
    assert pictures.ahead_s == 0
    frame = editor.render_input(*SIZE, ahead_s=0.5)
    assert frame.view.time_s == frame.canvas_view.time_s == 1.5
    assert frame.view.camera.position[0] > editor.viewport.shot(*SIZE).camera.position[0] + 0.9
    editor.viewport.screenshot = tmp_path / "now.png"
    assert editor.render_input(*SIZE, ahead_s=0.5).view.time_s == 1.0
    pictures.close()


def test_the_window_wakes_when_a_picture_is_drawn_and_only_then(editor, pictures):
    pictures.close()
    drawn = threading.Event()
    thread = PictureThread(OwnContext(), "opengl", drawn.set)
    begin(editor, thread)
    assert drawn.wait(60) and thread.wait(0.0) and thread.take() is not None and not thread.wait(0.0)
    for turn, wakes in ((0.0, False), (0.3, True)):
        drawn.clear()
        editor.viewport.navigation.orbit(turn, 0.0)
        begin(editor, thread)
        thread.wait()
        assert (thread.take().result.drawn is not None) == wakes
        assert drawn.is_set() == wakes
    thread.close()


def test_overlays_follow_the_picture_on_the_screen(editor, view):
    draw_frame(editor, view)
    before = editor.viewport.shot(*SIZE).camera.world_to_camera
    editor.viewport.navigation.orbit(0.5, 0.0)
    assert np.array_equal(editor.viewport.canvas_view(*SIZE).camera.world_to_camera, before)
    draw_frame(editor, view)
    assert not np.array_equal(editor.viewport.canvas_view(*SIZE).camera.world_to_camera, before)


def test_each_pane_is_finished_also_where_the_other_one_is_up_to_date(editor, context):
    finished = []
    view = LiveView(context, "opengl", lambda: finished.append(view.last_textures))
    rain(editor)
    draw_frame(editor, view)
    editor.viewport.options.split = "clear | rainy"
    del finished[:]
    clear, rainy = draw_frame(editor, view)
    assert finished == [(clear, rainy)] and clear.read() != rainy.read()


def test_an_edit_is_first_drawn_fast_where_a_full_picture_takes_long(editor):
    budget = editor.viewport.budget
    budget.enabled = True

    def quality(full_ms):
        editor.render_input(*SIZE)
        budget.observe(moving=False, real_s=1.0)
        budget.measured(LEVELS[0], full_ms)
        editor.document.change_rain("Seed", seed=round(full_ms))
        return editor.render_input(*SIZE).quality

    assert quality(50.0).is_exact
    assert not quality(400.0).is_exact
    budget.observe(moving=False, real_s=1.0)
    assert editor.render_input(*SIZE).quality.is_exact


def test_playing_rain_holds_the_frame_time_and_a_paused_picture_is_exact(editor):
    def quality():
        return editor.render_input(*SIZE).quality

    clock, budget = editor.playback.clock, editor.viewport.budget
    clock.playing = budget.enabled = True
    quality()
    budget.measured(LEVELS[0], 10 * budget.target_ms)
    assert quality().is_exact  # a clear scene looks the same at any time
    rain(editor)
    assert not quality().is_exact
    clock.playing = False
    budget.observe(moving=False, real_s=1.0)
    assert quality().is_exact


def test_steady_rain_before_a_still_camera_is_drawn_over_a_backdrop_by_the_processor(editor, monkeypatch):
    seconds = itertools.count()
    monkeypatch.setattr(viewport_state, "time", SimpleNamespace(perf_counter=lambda: float(next(seconds))))

    def quality():
        return [editor.render_input(*SIZE).quality for _ in range(2)][-1]

    clock, viewport = editor.playback.clock, editor.viewport
    rain(editor)
    clock.playing = viewport.budget.enabled = True
    viewport.budget.measured(LEVELS[0], 10 * viewport.budget.target_ms)
    assert not quality().has_backdrop  # of an unknown back end
    viewport.backend = "cpu"
    assert quality().has_backdrop
    viewport.navigation.orbit(0.2, 0.0)
    assert not editor.render_input(*SIZE).quality.has_backdrop
    assert quality().has_backdrop
    editor.document.edit("Darker", replace_scene, darkened(editor.document.scene))
    assert not editor.render_input(*SIZE).quality.has_backdrop
    for look in ("depth", "splats"):
        viewport.options.look = look
        assert quality().has_backdrop == (look == "splats")
    for changes in ({"model": "paper"}, {"model": "physical"}):
        editor.document.change_rain("Light", **changes)
        assert quality().has_backdrop == (changes["model"] == "physical")


def test_images_of_a_rig_take_a_tenth_of_the_time_while_time_plays(editor, context, view, monkeypatch):
    now, drawn = [0.0], []

    def draw_aside(*_):
        now[0] += 0.5
        drawn.append(now[0])
        return context.texture((4, 4), 4)

    monkeypatch.setattr(view, "draw_aside", draw_aside)
    images = MosaicImages(context, lambda: now[0])

    def passed(seconds, *, playing):
        now[0] += seconds
        editor.playback.clock.time_s, editor.playback.clock.playing = now[0], playing
        editor.rollouts.mosaic.want(64)
        return images.draw(editor.mosaic_input(), view)

    assert not passed(0.0, playing=True).is_behind
    assert passed(4.4, playing=True).is_behind and drawn == [0.5]
    assert not passed(0.2, playing=True).is_behind and len(drawn) == 2
    assert not passed(0.1, playing=False).is_behind and len(drawn) == 3  # at rest each is drawn at once


def test_no_time_passes_where_nothing_happens(editor):
    clock = editor.playback.clock
    clock.playing = True
    editor.tick(0.5)
    assert clock.time_s == 0.5  # the ego vehicle drives
    editor.document.edit("Alone", replace_scene, replace(small_scene(), ego=None, rigs={}))
    editor.tick(0.5)
    assert clock.time_s == 0.5
    rain(editor)
    editor.tick(0.5)
    assert clock.time_s == 1.0


def test_time_stands_until_the_renderer_is_ready_and_the_first_scene_is_open(editor, monkeypatch):
    rain(editor)
    viewport, clock = editor.viewport, editor.playback.clock
    clock.playing = True
    for name in ("is_compiling", "is_preparing"):
        setattr(viewport, name, True)
        editor.tick(0.5)
        assert (clock.time_s, clock.playing) == (0.0, True)
        setattr(viewport, name, False)
    monkeypatch.setattr(type(editor.files), "busy", "Opening street")
    editor.tick(0.5)
    assert clock.time_s == 0.5  # another scene is watched meanwhile
    editor.document.edit("Nothing", replace_scene, replace(small_scene(), layers=(), actors=()))
    editor.tick(0.5)
    assert clock.time_s == 0.5


def test_kernels_let_the_interface_go_on():
    @kernel(error_model="numpy")
    def double(x):
        return 2 * x

    assert double.targetoptions["nogil"]
    stored = [path for path in (REPOSITORY / "gsrain_engine").rglob("*.py") if "cache=True" in path.read_text()]
    assert stored == []  # by `kernel` alone
