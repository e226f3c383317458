"""Edit steps as text: they parse back, do the same in every form, and refuse what is wrong."""

import io
import shlex
from contextlib import closing
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import gsrain as gr
from app.main import run
from editor.files.open_document import settle
from gsrain_engine.appearance.view_choice import ViewChoice
from gsrain_engine.editor.editor import Editor
from gsrain_engine.editor.edits import actors, gaussians, lamps, layers, level, members, rain_keyframes, transform
from gsrain_engine.editor.edits.floaters import FloaterRules
from gsrain_engine.editor.edits.gaussians import CropBox
from gsrain_engine.editor.selection.attributes import select_attribute_range
from gsrain_engine.editor.selection.candidates import select_similar_colors
from gsrain_engine.editor.selection.screen import select_in_screen_shape
from gsrain_engine.editor.selection.volume import Sphere, flood_select, in_volume
from gsrain_engine.editor.steps import (
    EDITS,
    EditError,
    EditStep,
    all_edits,
    apply_steps,
    document_of,
    edit_help,
    python_program,
    shell_command,
    steps_since,
    with_rain_saved,
)
from gsrain_engine.rain.keyframes import RainKeyframes
from gsrain_engine.render.view import RenderView
from gsrain_engine.scene.camera import Camera
from gsrain_engine.scene.camera_path import CameraPath, circle_path
from gsrain_engine.scene.flags import BitMask, SelectionFlags
from gsrain_engine.scene.formats.scene_files import write_scene
from gsrain_engine.scene.lamps import Lamp
from gsrain_engine.scene.scene import Actor, ColorGrading
from small_scene import patch, small_scene

JSON = st.recursive(
    st.none() | st.booleans() | st.integers(-9, 2**53) | st.floats(allow_nan=False, allow_infinity=False) | st.text(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner, max_size=3),
    max_leaves=8,
)  # fmt: skip
NAMES = st.lists(st.text("abcxyz", min_size=1, max_size=4), min_size=1, max_size=2).map("_".join)

VIEW = (
    '{"width": 96, "height": 64, "fx": 60, "fy": 60, "cx": 48, "cy": 32, '
    '"world_to_camera": [[0, -1, 0, 0], [0, 0, -1, 1.5], [1, 0, 0, 2], [0, 0, 0, 1]]}'
)
"""A camera that looks along the road, to the wall."""


def edited_scene():
    """A road, a wall with a selection, a sky, a car that drives, and a camera path."""
    scene = small_scene()
    body = patch((-1, -1, 0), np.array([2.0, 0, 0]), np.array([0, 2.0, 0]), 5, (0.6, 0.1, 0.1))
    car = Actor("car", "car", (2.0, 2.0, 1.0), body, scene.ego)
    third = [BitMask.of(np.arange(400) % 3 == remainder) for remainder in range(3)]
    marks = SelectionFlags(selected=third[0], hidden=third[1], deleted=third[2])
    path = circle_path(np.array([20.0, 0.0, 1.0]), gr.home_camera(scene), 6.0)
    keys = [{"time_s": 1.0, "intensity_mm_h": 1.0}, {"time_s": 3.0, "intensity_mm_h": 2.0}]
    saved = {"rain": {"intensity_mm_h": 1.0}, "weather": {"keys": keys}}
    sets = {"every": {"layers/wall": BitMask.all(400)}}
    scene = scene.with_member("layers/wall", marks=marks)
    return replace(scene, actors=(car,), path=path, up=(0.05, 0.0, 1.0), selections=sets, **saved)


def files_of(scene, folder, **options):
    write_scene(scene, folder, **options)
    return read_files(folder)


def read_files(folder):
    return {path.relative_to(folder): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@given(NAMES, st.dictionaries(NAMES, JSON, max_size=4))
def test_steps_parse_back(name, arguments):
    step = EditStep(name.replace("_", "-"), arguments)
    assert EditStep.parse(step.text) == step


@pytest.mark.parametrize(
    ("text", "names"),
    [
        ("renam key=3", "rename"),
        ("rename key=layers/road", "name"),
        ("rename key=layers/road name=a b=2", "b"),
        ("crop box=3", "box"),
        ("crop box", "box"),
        ("move key=layers/road delta=[1,2]", "delta"),
        ("rename key=layers/none name=x", "layers/none"),
        ("change-rain intensity_mm_h=-1", "intensity_mm_h"),
        ("set-opacity key=layers/none opacity=0.5", "layers/none"),
        ("set-grading key=layers/road exposure_ev=9", "exposure_ev"),
        ('select-in-view shot={} pixels={"shape": [9, 9], "bits": ""}', "shot"),
        (f'select-in-view shot={{"camera": {VIEW}}} pixels={{"shape": [9, 9], "bits": "eA=="}}', "pixels"),
        ("set-rain-keyframe time_s=nan", "time_s"),
    ],
)
def test_wrong_steps_are_refused_by_name(text, names):
    with pytest.raises(ValueError, match=names):
        apply_steps(edited_scene(), [EditStep.parse(text)])


# Steps of the history


def act(editor):
    """Make one step of each kind, by what panels, tools and commands call."""
    document, selection, path = editor.document, editor.selection, editor.camera_path
    eye, target, up = np.array([[2.0, 0, 1.5], [20, 0, 1.5], [0, 0, 1]])
    view = RenderView(Camera(96, 64, 60, 60, 48, 32, gr.look_at(eye, target, up)))
    pixels = np.zeros((64, 96), bool)
    pixels[20:50, 20:70] = True
    road, car = "layers/road", "actors/car"
    selection.select_all()
    selection.invert()
    selection.select("set", "rectangle", select_in_screen_shape, view, pixels)
    selection.select("add", "sphere", in_volume, 0.0, Sphere((10.0, 0.0, 0.0), 3.0))
    selection.select("remove", "box", in_volume, 0.0, CropBox((10.0, 0.0, 0.0), (2.0, 2.0, 2.0)))
    selection.select("add", "flood", flood_select, 0.0, road, 20, 0.1, 2.0)
    selection.select("set", "color", select_similar_colors, 0.0, np.float32([0.7, 0.45, 0.3]), 0.1)
    selection.select("add", "opacity", select_attribute_range, 0.0, view.camera, "opacity", 0.9, 0.96)
    selection.save_set()
    selection.rename_set("selection 1", "mine")
    selection.shrink()
    selection.recall_set("mine", "set")
    selection.remove_set("every")
    document.edit("Hide", gaussians.hide_selected)
    document.edit("Show all", gaussians.show_all)
    selection.recall_set("mine", "set")
    document.edit("Move", transform.move_selected, translation(0.0, 0.5, 0.0), 0.0)
    document.edit("Isolate", gaussians.isolate_selected)
    document.edit("Separate", layers.separate)
    selection.select("set", "sphere", in_volume, 0.0, Sphere((10.0, 0.0, 0.0), 1.0))
    selection.distance_m = 3.0
    selection.grow()
    selection.shrink()
    document.edit("Delete", gaussians.delete_selected)
    document.edit("Purge", gaussians.compact)
    document.edit("Crop", gaussians.crop, CropBox((20.0, 0.0, 0.0), (60.0, 30.0, 20.0)))
    selection.select_all()
    selection.select_none()
    document.edit("Visible", members.set_visible, "layers/sky", False)
    document.edit("Visible", members.set_visible, ("layers/sky", road), True)
    document.edit("Exposure", members.set_grading, ("layers/sky", road), exposure_ev=-0.5)
    document.edit("Opacity", members.set_opacity, road, 0.5)
    document.edit("Opacity", members.set_opacity, road, 0.7, gesture="opacity")
    document.edit("Opacity", members.set_opacity, road, 0.8, gesture="opacity")
    document.edit("Grading", members.set_grading, road, ColorGrading(exposure_ev=0.5))
    document.edit("Move", transform.move_member, road, translation(0.1, 0.0, 0.0))
    document.edit("Place", transform.set_layer_pose, road, transform.Pose((0.2, 0.0, 0.0), (0.0, 0.0, 1.0), 1.0), 0.0)
    document.edit("Turn", actors.turn_actor, car, 30.0)
    document.edit("Re-time", actors.retime_actor, car, 1.0, 3.0)
    document.edit("Duplicate", layers.duplicate, road)
    document.edit("Rename", layers.rename, "layers/road 2", "wet road")
    document.edit("Up", layers.move_up, "layers/wet road")
    document.edit("Down", layers.move_down, "layers/wet road")
    document.edit("Merge", layers.merge, ["layers/road", "layers/wet road"])
    document.edit("Up", level.oriented, "x")
    document.edit("Guess", level.guess_orientation)
    document.edit("Level", level.level_from_ground)
    document.edit("Level", level.level_from_points, np.array([[0.0, 0, 0], [1, 0, 0.1], [0, 1, 0]]))
    document.edit("Ground", level.set_ground_height, 0.1)
    document.edit("Scale", level.set_length, 2.0, 2.5)
    document.edit("Add", lamps.add_lamp, lamps.lamp_at(document.scene, np.array([10.0, 2.0, 3.0])))
    document.edit("Add", lamps.add_lamp, Lamp(name="headlight", position=(2.0, 0.5, 0.6), mount="car"))
    document.edit("Cone", lamps.change_lamp, 0, color=(1.0, 0.5, 0.2), outer_deg=40.0)
    document.edit("Cone", lamps.change_lamp, 0, gesture="cone", outer_deg=30.0)
    document.edit("Cone", lamps.change_lamp, 0, gesture="cone", outer_deg=20.0)
    document.edit("Remove", lamps.remove_lamp, 1)
    document.edit("Origin", actors.set_origin, np.array([0.5, 0.0, 0.0]))
    document.edit("Ego start", actors.set_ego_start, np.array([1.0, 0.0, 0.0]), 0.1)
    document.edit("Ego drive", actors.drive_along_own_path)
    editor.views.save("Gate")
    editor.views.save()
    editor.views.move("View 1", -1)
    editor.views.rename("View 1", "Bridge")
    editor.views.remove("Gate")
    document.edit("Origin", actors.set_origin, np.array([0.0, 0.5, 0.0]))
    path.add_keyframe(0.5)
    path.place_keyframe(0, "Move keyframe", position_m=np.array([1.0, 0.0, 2.0]))
    path.retime_keyframe(0, 0.2)
    path.copy_keyframe(1, 9.0)
    path.snap_keyframe(1)
    path.ease(1, "ease out")
    path.delete_keyframe(0)
    path.change_path("Linear", interpolation="linear")
    path.stretch_path(5.0)
    path.reverse_path()
    path.circle_target()
    document.change_rain("Intensity", intensity_mm_h=4.0)
    document.edit_keyframes("Insert", RainKeyframes.with_key, 2.0, intensity_mm_h=3.0)
    document.edit_keyframes("Insert", RainKeyframes.with_key, 2.0, wind_m_s=(1.0, 2.0))
    document.change_rain("Wind", wind_m_s=(2.0, 2.0))
    document.edit_keyframes("Move", rain_keyframes.move_keyframe, "intensity_mm_h", 0, 0.5, intensity_mm_h=2.0)
    document.edit_keyframes("Ease", rain_keyframes.set_keyframe_easing, "intensity_mm_h", 0, "hold")
    document.edit_keyframes("Copy", rain_keyframes.copy_keyframe, "intensity_mm_h", 0, 0.75)
    document.edit_keyframes("Remove", RainKeyframes.without_key, 2.0, "wind_m_s")
    document.edit_keyframes("Smooth", rain_keyframes.set_interpolation, "smooth")
    document.edit_keyframes("Shower", rain_keyframes.add_shower, 1.0)
    document.edit_keyframes("Clear", rain_keyframes.replace_keyframes, RainKeyframes())
    document.edit("Lock", members.set_locked, road, True)
    document.edit("Remove", layers.remove, "layers/wall")


def test_edits_are_explained():
    explained = list(edit_help())
    assert [each.name for each in explained] == list(all_edits()) and all(each.summary for each in explained)


@pytest.mark.parametrize(
    ("name", "arguments"),
    [
        ("rename", {"key": "layers/wall", "name": "facade"}),
        ("select-near", {"time_s": 0.0, "distance_m": 0.5, "mode": "add"}),
        ("reverse-path", {}),
        ("change-rain", {"intensity_mm_h": 3.0}),
        ("add-shower", {"start_s": 1.0}),
        ("set-opacity", {"key": ["layers/wall", "layers/road"], "opacity": 0.5}),
        ("set-grading", {"key": "layers/wall,layers/road", "exposure_ev": 0.5}),
    ],
)
def test_an_edit_made_as_a_step_of_a_history_is_described_as_that_edit(name, arguments):
    flight = CameraPath(
        np.array([0.0, 2.0]), np.array([[0.0, 0, 2], [6, 0, 2]]), np.tile([1.0, 0, 0, 0], (2, 1)), np.full(2, 50.0)
    )
    edit = EditStep(name, arguments)
    step = edit.step(document_of(replace(small_scene(), path=flight)))
    found = EditStep.of(step)
    assert found.name == name and found.arguments == arguments


def test_all_steps_of_the_history_have_a_command_that_does_the_same(tmp_path):
    """Each step as text makes the document after it of the one before; all together, so do command and program."""
    source = str(tmp_path / "scene")
    write_scene(edited_scene(), source, in_drawing_order=True)
    with closing(Editor()) as editor:
        editor.files.open(source)
        settle(editor)
        editor.wet_look.choice = ViewChoice(count=2, width_px=64)
        editor.wet_look.make()
        editor.jobs.all[-1].wait(120)
        settle(editor)
        job = editor.floaters.find(FloaterRules(opacity_below=0.96))
        job.wait(60)
        assert job.progress.message.startswith(f"{editor.floaters.count:,} Gaussians") and editor.floaters.count > 0
        act(editor)
        editor.files.import_from(source)
        settle(editor)
        history, saved = editor.document.history, editor.files.saved
    steps = [EditStep.of(step) for step in history.steps[1:]]
    assert set(EDITS) - {step.name for step in steps} == {"recolor", "reconstruct", "find-lamps"}
    for before, step, made in zip(history.steps, steps, history.steps[1:], strict=False):
        again = EditStep.parse(step.text).apply(before.document)
        assert files_of_document(again, tmp_path / "again") == files_of_document(made.document, tmp_path / "made"), step
    command = shlex.split(shell_command(source, steps_since(history, saved), str(tmp_path / "command")))
    assert run(command[1:]) == 0
    exec(python_program(source, steps, f"gr.save(scene, {str(tmp_path / 'python')!r})"), {})
    present = with_rain_saved(history.present)
    assert read_files(tmp_path / "command") == files_of(present, tmp_path / "ordered", in_drawing_order=True)
    assert read_files(tmp_path / "python") == files_of(present, tmp_path / "present")


def test_long_commands_become_a_here_document(tmp_path, monkeypatch):
    source = str(tmp_path / "scene")
    write_scene(edited_scene(), source, in_drawing_order=True)
    steps = [EditStep.parse(f"rename key=layers/road name={'x' * 120_000}"), EditStep.parse("select-all")]
    first, _, rest = shell_command(source, steps, str(tmp_path / "made")).partition("\n")
    monkeypatch.setattr("sys.stdin", io.StringIO(rest.removesuffix("STEPS")))
    assert run(shlex.split(first.removesuffix("<<'STEPS'"))[1:]) == 0
    assert files_of(gr.load(tmp_path / "made"), tmp_path / "again") == files_of(
        apply_steps(gr.load(source), steps), tmp_path / "same"
    )


def test_steps_that_no_edit_makes_are_refused(tmp_path):
    with closing(Editor(edited_scene())) as editor:
        editor.document.set_contents("Scene of a program", small_scene(), editor.document.rain, "program")
        with pytest.raises(EditError, match="Scene of a program"):
            steps_since(editor.document.history, editor.files.saved)
        with pytest.raises(EditError, match="save it first"):
            steps_since(editor.document.history, replace(editor.files.saved))


def files_of_document(state, folder):
    return files_of(with_rain_saved(state), folder)


def translation(x, y, z):
    matrix = np.eye(4)
    matrix[:3, 3] = x, y, z
    return matrix
