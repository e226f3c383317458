"""Edit steps as text: they parse back, do the same in every form, and refuse what is wrong."""

import io
import json
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
from gsrain_engine.editor.editor import Editor
from gsrain_engine.editor.edits.actors import drive_along_own_path, retime_actor, set_ego_start, set_origin, turn_actor
from gsrain_engine.editor.edits.floaters import FloaterRules
from gsrain_engine.editor.edits.gaussians import (
    CropBox,
    compact,
    crop,
    delete_selected,
    hide_selected,
    isolate_selected,
    show_all,
)
from gsrain_engine.editor.edits.layers import duplicate, merge, move_down, move_up, remove, rename, separate
from gsrain_engine.editor.edits.level import level_from_ground, level_from_points, set_ground_height, set_length
from gsrain_engine.editor.edits.members import set_grading, set_locked, set_opacity, set_visible
from gsrain_engine.editor.edits.rain_keyframes import (
    add_shower,
    move_keyframe,
    replace_keyframes,
    set_interpolation,
    set_keyframe_number,
)
from gsrain_engine.editor.edits.transform import Pose, move_member, move_selected, set_layer_pose
from gsrain_engine.editor.selection.attributes import select_attribute_range
from gsrain_engine.editor.selection.candidates import select_similar_colors
from gsrain_engine.editor.selection.screen import select_in_screen_shape
from gsrain_engine.editor.selection.volume import Sphere, flood_select, in_volume
from gsrain_engine.editor.steps import (
    EDITS,
    EditError,
    EditStep,
    apply_steps,
    edit_help,
    python_program,
    shell_command,
    steps_since,
    with_rain_saved,
)
from gsrain_engine.rain.keyframes import RainKeyframes
from gsrain_engine.render.draw import RenderView
from gsrain_engine.scene.camera import Camera
from gsrain_engine.scene.camera_path import circle_path
from gsrain_engine.scene.flags import BitMask, SelectionFlags
from gsrain_engine.scene.formats.scene_files import write_scene
from gsrain_engine.scene.scene import Actor, ColorGrading
from small_scene import patch, small_scene

JSON = st.recursive(
    st.none() | st.booleans() | st.integers(-9, 2**53) | st.floats(allow_nan=False, allow_infinity=False) | st.text(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner, max_size=3),
    max_leaves=8,
)  # fmt: skip
NAMES = st.from_regex(r"[a-z][a-z_]{0,8}", fullmatch=True)

VIEW = (
    '{"width": 96, "height": 64, "fx": 60, "fy": 60, "cx": 48, "cy": 32, '
    '"world_to_camera": [[0, -1, 0, 0], [0, 0, -1, 1.5], [1, 0, 0, 2], [0, 0, 0, 1]]}'
)
"""A camera that looks along the road, to the wall."""
SHIFT = "[[1, 0, 0, 0.5], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]"
PIXELS = EditStep.with_values("", {"pixels": np.ones((64, 96), bool)}).text
CIRCLE = circle_path(np.zeros(3), Camera(96, 64, 60, 60, 48, 32, np.eye(4)), 6.0)
PATH = json.dumps(EditStep.with_values("", {"path": CIRCLE}).arguments["path"])
EXAMPLES = f"""
delete-selected
hide-selected
isolate-selected
show-all
crop box={{"center_m": [10, 0, 1], "size_m": [20, 6, 4], "yaw_deg": 20}}
purge-deleted
find-floaters rules={{"opacity_below": 0.96}}
select-all
select-none
invert-selection
select-in-view mode=add shot={{"camera": {VIEW}}} {PIXELS.strip()}
select-in-volume time_s=0 volume={{"center_m": [10, 0, 0], "radius_m": 3}}
select-near mode=add time_s=0 distance_m=0.5
select-flood time_s=0 key=layers/road index=20 tolerance=0.1 reach=2
select-color time_s=0 color=[0.35, 0.33, 0.3] tolerance=0.1
select-range time_s=0 camera={VIEW} name=opacity low=0.9 high=1
select-set name=every mode=remove
save-set name="a set"
rename-set name=every other=all
remove-set name=every
duplicate key=layers/road
separate
merge keys=["layers/road", "layers/wall"]
rename key=layers/road name="wet road"
remove key=layers/wall
move-up key=layers/wall
move-down key=layers/road
import path=SCENE
set-visible key=layers/sky visible=false
set-locked key=layers/road locked=true
set-opacity key=layers/road opacity=0.5
set-grading key=layers/road grading={{"exposure_ev": 0.5}}
move-selected delta={SHIFT}
move key=layers/road delta={SHIFT}
place key=layers/road pose={{"position_m": [1, 0, 0], "turn_deg": [0, 0, 5], "scale": 1}}
level-by-ground
level-by-points points_m=[[0, 0, 0], [1, 0, 0.1], [0, 1, 0]]
set-ground-height height_m=0.2
set-length measured_m=2 true_m=3
set-origin point_m=[1, 2, 3]
set-ego-start ground_point_m=[1, 2, 0] heading_rad=0.5
drive-along-path
turn-actor key=actors/car left_deg=30
retime-actor key=actors/car start_s=1 duration_s=2
set-path path=null
change-path interpolation=linear
set-keyframe time_s=0.2 camera={VIEW}
place-keyframe key=0 position=[0, 0, 2]
move-keyframe key=0 time_s=0.3
copy-keyframe key=0 time_s=0.3
snap-keyframe key=0 trajectory={PATH}
delete-keyframe key=1
reverse-path
stretch-path factor=2
change-rain intensity_mm_h=8.5 streak_region={{"minimum_m": [0, 0, 0], "maximum_m": [1, 1, 1]}}
set-rain-keyframe time_s=2 intensity_mm_h=4
move-rain-keyframe name=intensity_mm_h number=0 to_s=2 intensity_mm_h=3
set-rain-keyframe-number time_s=1 name=intensity_mm_h value=2
remove-rain-keyframe time_s=1
set-rain-keyframes other={{}}
set-rain-interpolation between=smooth
add-shower start_s=1
wet-look choice={{"count": 2, "width_px": 64}}
""".strip().splitlines()


OF_CAPTURES = ("recolor", "reconstruct")


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


def test_every_edit_of_a_scene_has_an_example_here():
    assert [each.partition(" ")[0] for each in EXAMPLES] == [each for each in EDITS if each not in OF_CAPTURES]
    assert all(each.summary for each in edit_help())


@pytest.mark.parametrize("text", EXAMPLES)
def test_steps_do_the_same_as_text_as_python_and_on_the_command_line(text, tmp_path):
    """The three forms of a step write the same files, and they differ from those of the scene before."""
    write_scene(edited_scene(), tmp_path / "scene")
    text = text.replace("SCENE", str(tmp_path / "scene"))
    scene, step = gr.load(tmp_path / "scene"), EditStep.parse(text)
    made = files_of(apply_steps(scene, [step]), tmp_path / "made")
    assert made != files_of(scene, tmp_path / "same")
    variables = {"gr": gr, "scene": scene}
    exec(step.python, variables)
    assert files_of(variables["scene"], tmp_path / "python") == made
    assert run(["edit", str(tmp_path / "scene"), text, "-o", str(tmp_path / "command")]) == 0
    assert files_of(gr.load(tmp_path / "command"), tmp_path / "again") == made


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
    document.edit("Hide", hide_selected)
    document.edit("Show all", show_all)
    selection.recall_set("mine", "set")
    document.edit("Move", move_selected, translation(0.0, 0.5, 0.0), 0.0)
    document.edit("Isolate", isolate_selected)
    document.edit("Separate", separate)
    selection.select("set", "sphere", in_volume, 0.0, Sphere((10.0, 0.0, 0.0), 1.0))
    selection.distance_m = 3.0
    selection.grow()
    selection.shrink()
    document.edit("Delete", delete_selected)
    document.edit("Purge", compact)
    document.edit("Crop", crop, CropBox((20.0, 0.0, 0.0), (60.0, 30.0, 20.0)))
    selection.select_all()
    selection.select_none()
    document.edit("Visible", set_visible, "layers/sky", False)
    document.edit("Opacity", set_opacity, road, 0.5)
    document.edit("Opacity", set_opacity, road, 0.7, gesture="opacity")
    document.edit("Opacity", set_opacity, road, 0.8, gesture="opacity")
    document.edit("Grading", set_grading, road, ColorGrading(exposure_ev=0.5))
    document.edit("Move", move_member, road, translation(0.1, 0.0, 0.0))
    document.edit("Place", set_layer_pose, road, Pose((0.2, 0.0, 0.0), (0.0, 0.0, 1.0), 1.0), 0.0)
    document.edit("Turn", turn_actor, car, 30.0)
    document.edit("Re-time", retime_actor, car, 1.0, 3.0)
    document.edit("Duplicate", duplicate, road)
    document.edit("Rename", rename, "layers/road 2", "wet road")
    document.edit("Up", move_up, "layers/wet road")
    document.edit("Down", move_down, "layers/wet road")
    document.edit("Merge", merge, ["layers/road", "layers/wet road"])
    document.edit("Level", level_from_ground)
    document.edit("Level", level_from_points, np.array([[0.0, 0, 0], [1, 0, 0.1], [0, 1, 0]]))
    document.edit("Ground", set_ground_height, 0.1)
    document.edit("Scale", set_length, 2.0, 2.5)
    document.edit("Origin", set_origin, np.array([0.5, 0.0, 0.0]))
    document.edit("Ego start", set_ego_start, np.array([1.0, 0.0, 0.0]), 0.1)
    document.edit("Ego drive", drive_along_own_path)
    path.add_keyframe(0.5)
    path.place_keyframe(0, "Move keyframe", position_m=np.array([1.0, 0.0, 2.0]))
    path.retime_keyframe(0, 0.2)
    path.copy_keyframe(1, 9.0)
    path.snap_keyframe(1)
    path.delete_keyframe(0)
    path.change_path("Linear", interpolation="linear")
    path.stretch_path(5.0)
    path.reverse_path()
    path.circle_target()
    document.change_rain("Intensity", intensity_mm_h=4.0)
    document.edit_keyframes("Insert", RainKeyframes.with_key, 2.0, intensity_mm_h=3.0)
    document.edit_keyframes("Insert", RainKeyframes.with_key, 2.0, wind_m_s=(1.0, 2.0))
    document.change_rain("Wind", wind_m_s=(2.0, 2.0))
    document.edit_keyframes("Move", move_keyframe, "intensity_mm_h", 0, 0.5, intensity_mm_h=2.0)
    document.edit_keyframes("Number", set_keyframe_number, 0.5, "intensity_mm_h", 1.5)
    document.edit_keyframes("Remove", RainKeyframes.without_key, 2.0, "wind_m_s")
    document.edit_keyframes("Smooth", set_interpolation, "smooth")
    document.edit_keyframes("Shower", add_shower, 1.0)
    document.edit_keyframes("Clear", replace_keyframes, RainKeyframes())
    document.edit("Lock", set_locked, road, True)
    document.edit("Remove", remove, "layers/wall")


def test_all_steps_of_the_history_have_a_command_that_does_the_same(tmp_path):
    """Each step as text makes the document after it of the one before; all together, so do command and program."""
    source = str(tmp_path / "scene")
    write_scene(edited_scene(), source, in_drawing_order=True)
    with closing(Editor()) as editor:
        editor.files.open(source)
        settle(editor)
        editor.floaters.find(FloaterRules(opacity_below=0.96)).wait(60)
        settle(editor)
        act(editor)
        editor.files.import_from(source)
        settle(editor)
        history, saved = editor.document.history, editor.files.saved
    steps = [EditStep.of(step) for step in history.steps[1:]]
    assert set(EDITS) - {step.name for step in steps} == {"wet-look", *OF_CAPTURES}
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
