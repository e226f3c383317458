"""Edits of packages as jobs: what may change meanwhile stays, and a result that no longer fits is left out."""

import threading
from contextlib import closing
from dataclasses import replace

import numpy as np
import pytest

from gsrain_engine import plugins
from gsrain_engine.editor.editor import Editor
from gsrain_engine.editor.edits.lamps import add_lamp
from gsrain_engine.editor.edits.layers import remove, rename
from gsrain_engine.editor.edits.members import set_locked, set_opacity, set_path
from gsrain_engine.editor.scene_edits import InstalledEdit, SceneEdit
from gsrain_engine.scene.camera import Camera
from gsrain_engine.scene.camera_path import circle_path
from gsrain_engine.scene.lamps import Lamp
from gsrain_engine.scene.progress import Progress
from gsrain_engine.scene.scene import Layer
from small_scene import small_scene

LAMP = Lamp(name="moon", position=(0.0, 0.0, 50.0))
PATH = circle_path(np.array([20.0, 0.0, 1.0]), Camera.from_fov(96, 64, 50.0, np.eye(4)), 6.0)


def shaded(scene):
    """Darken the road, add a cloud and a lamp."""
    yield Progress(0.5, "Shading")
    road = scene.member("layers/road").gaussians
    scene = scene.with_member("layers/road", gaussians=replace(road, sh=0.5 * road.sh))
    return replace(scene, layers=(*scene.layers, Layer("cloud", road.take(np.arange(3)))), lamps=(*scene.lamps, LAMP))


def thinned(scene):
    yield Progress(0.5, "Thinning")
    return scene.with_member("layers/road", gaussians=scene.member("layers/road").gaussians.take(np.arange(5)))


def with_path(scene):
    yield Progress(0.5, "Flying")
    return replace(scene, path=PATH)


def unchanged(scene):
    yield Progress(0.5, "Looking")
    return scene


class HeldEdit:
    """An edit of a package that does not end before the test lets it."""

    def __init__(self, work):
        may_end = threading.Event()

        def held(scene):
            yield Progress(0.1, "Waiting")
            assert may_end.wait(60)
            return (yield from work(scene))

        name = work.__name__
        extension = plugins.Extension(plugins.SCENE_EDITS, name, f"lab:{name}", "lab", "1.0", None)
        self.edit = InstalledEdit(name, SceneEdit(f"Make {name}", "Edit the scene.", held), extension)
        self.let_end = may_end.set

    def start(self, editor):
        self.job = editor.scene_edits.start(self.edit)

    def finish(self):
        self.let_end()
        return self.job.wait(60)


@pytest.fixture
def editor():
    with closing(Editor(small_scene())) as editor:
        yield editor


def test_the_end_is_one_step_that_names_what_is_new(editor):
    before, held, edits = editor.document.scene, HeldEdit(shaded), editor.scene_edits
    assert edits.is_possible(held.edit)
    held.start(editor)
    assert not edits.is_possible(HeldEdit(thinned).edit)  # it would begin with the same scene
    held.finish()
    assert held.job.progress.message == "1 lamp (Rain panel, Lamps); new in the Layers panel: cloud"
    assert editor.document.history.labels == ["Opened", "Make shaded"] and edits.is_possible(held.edit)
    assert editor.document.scene.lamps == (LAMP,) and editor.document.scene.layers[-1].name == "cloud"
    editor.document.undo()
    assert editor.document.scene is before


def test_no_step_is_made_where_nothing_changes(editor):
    held = HeldEdit(unchanged)
    held.start(editor)
    held.finish()
    assert editor.document.history.labels == ["Opened"]


def test_what_does_not_concern_the_edit_may_change_meanwhile(editor):
    held = HeldEdit(shaded)
    held.start(editor)
    editor.document.edit("Lock", set_locked, "layers/road", True)
    editor.document.edit("Path", set_path, PATH)
    editor.selection.select_all()
    made, dark = held.finish(), editor.document.scene.member("layers/road")
    assert editor.document.history.labels[-1] == "Make shaded"
    assert dark.locked and dark.gaussians is made.member("layers/road").gaussians
    assert editor.document.scene.path is PATH
    assert editor.document.scene.member("layers/wall").marks.selected.size > 0


@pytest.mark.parametrize(
    ("work", "change", "arguments"),
    [
        (shaded, set_opacity, ("layers/wall", 0.5)),
        (shaded, add_lamp, (LAMP,)),
        (shaded, rename, ("layers/wall", "fence")),
        (shaded, remove, ("layers/wall",)),
        (thinned, set_locked, ("layers/wall", True)),
        (with_path, set_path, (None,)),
    ],
)
def test_a_result_that_does_not_fit_any_more_is_left_out(editor, work, change, arguments):
    if change is set_path:
        editor.document.edit("Path", set_path, circle_path(np.zeros(3), Camera.from_fov(9, 9, 50.0, np.eye(4)), 1.0))
    held = HeldEdit(work)
    held.start(editor)
    editor.document.edit("Meanwhile", change, *arguments)
    now = editor.document.scene
    held.finish()
    assert editor.document.scene is now and held.job.state == "finished"
    assert held.job.progress.message == f"The scene has changed meanwhile: Make {work.__name__} once more"
