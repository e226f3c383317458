"""An OpenGL context without a window, the same one for all tests of this folder."""

import pytest

from gsrain_engine.render.opengl.context import NoOpenGLError, is_software, open_context


@pytest.fixture(scope="session")
def shared_context():
    try:
        context = open_context("egl")
    except NoOpenGLError as error:
        pytest.skip(str(error))
    yield context
    context.release()


@pytest.fixture
def context(shared_context):
    """The context, current while a test runs and clean before and after."""
    with shared_context:
        assert shared_context.error == "GL_NO_ERROR"
        yield shared_context
        assert shared_context.error == "GL_NO_ERROR"


@pytest.fixture
def gpu_context(context):
    """The context where a GPU executes it; what only shows among threads that run at the same time is tested there."""
    if is_software(context):
        pytest.skip("needs a GPU: a software rasterizer runs the threads of a workgroup one after another")
    return context
