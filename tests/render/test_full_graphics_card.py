"""A graphics card without room: it is said once, and the processor draws."""

import threading

import numpy as np
import pytest

from gsrain_engine.editor.drawing import textures
from gsrain_engine.editor.drawing.live_view import LiveView
from gsrain_engine.editor.edits.members import replace_scene
from gsrain_engine.editor.viewport_state import PendingScene
from gsrain_engine.render.opengl import buffers
from gsrain_engine.render.opengl.buffers import GrowableBuffer, reserve_buffer
from live_frames import darkened, picture
from render.cpu.raster_scenes import random_gaussians


def settled_picture(editor, view):
    """Image after the change to the CPU renderer."""
    picture(editor, view)
    for thread in threading.enumerate():
        if thread.name == "compile kernels":
            thread.join()
    assert view.is_settled
    picture(editor, view)
    return picture(editor, view)


def refuse(context, size):
    raise MemoryError(f"no room for {size}")


@pytest.mark.parametrize("reserve", [reserve_buffer, lambda context, size: GrowableBuffer(context).reserve(size, size)])
def test_what_the_driver_refuses_is_an_error(context, reserve):
    with pytest.raises(MemoryError, match="67108864 MiB"):
        reserve(context, 1 << 46)
    assert reserve_buffer(context, 1024).size == 1024


def test_an_upload_that_does_not_fit_leaves_nothing_behind(context, monkeypatch):
    arrays, made = buffers.GpuArrays(context), []

    def two_fit(context, size):
        if len(made) == 2:
            refuse(context, size)
        made.append(reserve_buffer(context, size))
        return made[-1]

    monkeypatch.setattr(buffers, "reserve_buffer", two_fit)
    gaussians = random_gaussians(100)
    with pytest.raises(MemoryError):
        list(arrays.upload(gaussians))
    arrays.release_everything()
    assert len(made) == 2
    assert {type(each.mglo).__name__ for each in made} == {"InvalidObject"}
    assert arrays.missing(gaussians) == 100


@pytest.mark.parametrize("change", ["edit", "open"])
def test_the_processor_goes_on_where_the_card_is_full(context, editor, view, monkeypatch, change):
    before = picture(editor, view)
    monkeypatch.setattr(buffers, "reserve_buffer", refuse)
    monkeypatch.setattr(textures, "compile_kernels", lambda: None)  # those that are needed compile as they are
    scene = darkened(editor.document.scene)
    if change == "edit":
        editor.document.edit("Darker", replace_scene, scene)
    else:
        editor.viewport.staged = PendingScene("Darker", scene)
    after = settled_picture(editor, view)
    assert editor.viewport.staged is None
    assert [each.gaussians for each in editor.document.scene.members] == [each.gaussians for each in scene.members]
    assert editor.status.problem.startswith("no room for") and editor.status.problem.endswith(
        ": the processor draws from now on"
    )
    assert editor.viewport.backend == "cpu"
    assert not np.array_equal(before, after)
    assert np.array_equal(after, settled_picture(editor, LiveView(context, "cpu")))
    editor.status.dismiss()
    editor.document.undo()
    settled_picture(editor, view)
    assert editor.status.problem is None  # it is said once
