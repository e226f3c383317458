"""A graphics card that is lost while pictures are drawn without a window: one sentence, and no picture that is none."""

import contextlib
import ctypes

import moderngl
import numpy as np
import pytest
from PIL import Image

from app.main import BAD_INPUT, run
from gsrain_engine.backends import open_renderer
from gsrain_engine.editor.drawing.live_view import LiveView
from gsrain_engine.render.opengl import context
from gsrain_engine.render.opengl.context import DeviceLostError, NoOpenGLError, context_monitor, open_context
from gsrain_engine.render.opengl.renderer import SplatRenderer
from gsrain_engine.scene.camera import Camera
from gsrain_engine.scene.formats.scene_files import write_scene
from live_frames import draw_frame
from render.cpu.raster_scenes import drawn, random_gaussians
from small_scene import small_scene

_RESET_NOTIFICATION_STRATEGY, _LOSE_CONTEXT_ON_RESET = 0x8256, 0x8252
GUILTY_CONTEXT_RESET = 0x8253
CAMERA = Camera(64, 48, 60.0, 60.0, 32.0, 24.0)


@pytest.fixture
def own_context():
    """A context that a test may lose."""
    try:
        context = open_context("egl")
    except NoOpenGLError as error:
        pytest.skip(str(error))
    with context:
        yield context
    context.release()


@pytest.fixture
def lost_after(monkeypatch):
    """Let drivers say once, after so many answers that all is well, that a context is lost."""

    def lose(count):
        answers = iter([0] * count + [GUILTY_CONTEXT_RESET])
        monkeypatch.setattr(context, "reset_status_function", lambda address: lambda: next(answers, 0))

    return lose


def test_contexts_are_made_to_tell_of_resets(own_context):
    try:
        address = context.EglContext().load_opengl_function("glGetIntegerv")
    except OSError:
        pytest.skip("this driver does not tell of resets")
    strategy = ctypes.c_int()
    ctypes.CFUNCTYPE(None, ctypes.c_uint, ctypes.POINTER(ctypes.c_int))(address)(_RESET_NOTIFICATION_STRATEGY, strategy)
    assert strategy.value == _LOSE_CONTEXT_ON_RESET
    assert context_monitor(own_context).ask() == 0
    assert own_context.error == "GL_NO_ERROR"


def picture(renderer, seed=1):
    return drawn(renderer, random_gaussians(200, seed), camera=CAMERA).rgba


def test_where_the_driver_tells_nothing_another_context_is_taken(monkeypatch):
    def none(self):
        raise OSError("no context that tells its end")

    monkeypatch.setattr("gsrain_engine.render.opengl.context.EglContext.__init__", none)
    with open_context("egl") as context:
        assert context_monitor(context) is None
        assert picture(SplatRenderer(context)).any()
    context.release()


def test_contexts_take_turns_and_close_in_any_order(own_context):
    stacks = [contextlib.ExitStack() for _ in range(2)]
    first, second = (stack.enter_context(open_renderer("opengl")) for stack in stacks)
    pictures = [picture(first), picture(second, 2), picture(second), picture(first, 2)]
    assert np.array_equal(pictures[0], pictures[2])
    assert np.array_equal(pictures[1], pictures[3])
    assert not np.array_equal(pictures[0], pictures[1])
    stacks[0].close()
    assert np.array_equal(picture(second), pictures[0])
    stacks[1].close()
    assert own_context.buffer(b"outer").read() == b"outer"


@pytest.mark.parametrize("backend", ["opengl-tiles", "opengl-quads"])
def test_no_picture_comes_from_a_lost_context_and_its_loss_is_remembered(lost_after, backend):
    lost_after(1)
    with pytest.raises(DeviceLostError), open_renderer(backend) as renderer:
        monitor = context_monitor(renderer.context)
        assert picture(renderer).any()
        with pytest.raises(DeviceLostError):
            picture(renderer)
        assert monitor.is_lost() and monitor.is_lost()
        monitor.wait_for_driver(60)
        raise moderngl.Error("cannot create texture")  # an error in a lost context is its loss
    with pytest.raises(moderngl.Error), open_renderer("opengl"):
        raise moderngl.Error("cannot create texture")


@pytest.mark.parametrize("out", ["frames", "still.png", "still.npy"])
def test_a_command_ends_in_a_sentence_and_writes_no_empty_picture(tmp_path, capsys, lost_after, out):
    write_scene(small_scene(), tmp_path / "scene")
    options = ["--size", "64x48", "--backend", "opengl", *(["--fps", "5", "--to", "3"] if out == "frames" else [])]
    command = ["render", str(tmp_path / "scene"), "-o"]
    assert run([*command, str(tmp_path / "healthy" / out), *options]) == 0
    lost_after(12 if out == "frames" else 0)  # the sky is looked at first
    assert run([*command, str(tmp_path / "lost" / out), *options]) == BAD_INPUT
    assert "gsrain: the graphics driver has restarted" in capsys.readouterr().err
    written = sorted((tmp_path / "lost").rglob("*.*"))
    assert 0 < len(written) < 15 if out == "frames" else not written
    for path in written:
        assert path.read_bytes() == (tmp_path / "healthy" / out / path.name).read_bytes()
        assert np.asarray(Image.open(path)).any()


def test_a_screenshot_of_nothing_is_not_saved(own_context, editor, tmp_path):
    view = LiveView(own_context, "opengl")
    draw_frame(editor, view)
    editor.viewport.screenshot = tmp_path / "picture.png"
    context_monitor(own_context).ask = lambda: GUILTY_CONTEXT_RESET
    with pytest.raises(DeviceLostError):
        draw_frame(editor, view)
    assert not list(tmp_path.iterdir())
