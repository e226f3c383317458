"""An OpenGL context without a window, the same one for all tests of this folder."""

import pytest

from gsrain_engine.render.context import NoOpenGLError, open_context


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
