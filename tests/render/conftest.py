"""An OpenGL context without a window, the same one for all tests of this folder; renderers, an editor and its view."""

import moderngl
import pytest

from gsrain_engine.editor.drawing import live_view
from gsrain_engine.editor.drawing.live_view import LiveView
from gsrain_engine.editor.editor import Editor
from gsrain_engine.render.cpu.renderer import CpuRenderer
from gsrain_engine.render.opengl.context import NoOpenGLError, is_software, open_context
from gsrain_engine.render.opengl.renderer import SplatRenderer
from small_scene import small_scene


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items):
    for item in items:
        if "gpu_context" in getattr(item, "fixturenames", ()):
            item.add_marker("gpu")


@pytest.fixture(scope="session")
def shared_context():
    try:
        context = open_context("egl")
    except NoOpenGLError as error:
        pytest.skip(str(error))
    context.gc_mode = "context_gc"
    yield context
    context.release()


@pytest.fixture
def context(shared_context):
    """The context, current while a test runs and clean before and after."""
    with shared_context:
        assert shared_context.error == "GL_NO_ERROR"
        yield shared_context
        assert shared_context.error == "GL_NO_ERROR"
        _free_unused(shared_context)


def _free_unused(context):
    """Free the programs, textures and buffers of renderers that are gone; not what these have freed themselves."""
    unused = [each for each in context.objects if not isinstance(each, moderngl.InvalidObject)]
    context.objects.clear()
    for each in unused:
        each.release()


@pytest.fixture
def gpu_context(context):
    """The context where a GPU executes it; what only shows among threads that run at the same time is tested there."""
    if is_software(context):
        pytest.skip("needs a GPU: a software rasterizer runs the threads of a workgroup one after another")
    return context


@pytest.fixture
def open_kind(request):
    """Open a renderer by its name."""

    def opened(kind):
        if kind == "cpu":
            return CpuRenderer()
        way = {"opengl-tiles": "tiles"}.get(kind)
        return SplatRenderer(request.getfixturevalue("context"), harmonics="single", rasterizer=way)

    return opened


@pytest.fixture(params=["cpu", "opengl", "opengl-tiles"])
def any_renderer(request, open_kind):
    return open_kind(request.param)


@pytest.fixture
def editor():
    opened = Editor(small_scene())
    opened.playback.clock.playing = False
    opened.viewport.budget.enabled = False  # each picture in full quality, however slow the machine is
    yield opened
    opened.close()


@pytest.fixture
def view(context):
    return LiveView(context, "opengl")


@pytest.fixture
def slow_view(view, monkeypatch):
    """A live view that uploads one slice a frame."""
    monkeypatch.setattr(live_view, "_CHUNK_SIZE", 0)
    monkeypatch.setattr(live_view, "_UPLOAD_S", 1e-9)
    return view
