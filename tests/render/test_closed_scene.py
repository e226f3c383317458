"""A scene that is closed is held by nobody: its memory is free for the next one."""

import gc
import threading
import weakref

import pytest

from gsrain_engine.editor.drawing import live_view, textures
from gsrain_engine.editor.drawing.live_view import LiveView
from gsrain_engine.editor.editor import Editor
from gsrain_engine.rain.settings import load_preset
from gsrain_engine.scene.scene import Scene
from live_frames import draw_frame
from small_scene import small_scene


@pytest.mark.parametrize("backend", ["opengl", "cpu"])
def test_a_closed_scene_is_free(context, backend):
    editor = Editor(small_scene(), load_preset("8.5"))
    editor.playback.clock.playing = False
    view = LiveView(context, backend)
    editor.viewport.options.split = "clear | rainy"
    for _ in range(3):
        draw_frame(editor, view)
    editor.viewport.options.split = "off"
    draw_frame(editor, view)
    held = [weakref.ref(each.gaussians.means) for each in editor.document.scene.members]
    editor.files.close_scene()
    for _ in range(2):
        draw_frame(editor, view)
    gc.collect()
    assert [each() is None for each in held] == [True] * 3
    assert not view.arrays.masks
    editor.files.give_up()
    editor.close()


def test_an_empty_scene_waits_for_no_kernels(context, monkeypatch):
    monkeypatch.setattr(live_view, "has_kernels", lambda: False)
    monkeypatch.setattr(textures, "_are_loaded", threading.Event())
    editor = Editor(Scene("no scene"))
    view = LiveView(context, "cpu")
    assert not view.is_settled
    draw_frame(editor, view)
    assert view.is_settled
    editor.close()
