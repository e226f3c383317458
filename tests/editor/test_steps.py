"""Edit steps as text: they parse back, do the same in every form, and refuse what is wrong."""

import json
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import gsrain as gr
from app.main import run
from gsrain_engine.editor.steps import EDITS, EditStep, apply_steps, edit_help
from gsrain_engine.scene.camera import Camera
from gsrain_engine.scene.camera_path import circle_path
from gsrain_engine.scene.flags import BitMask, SelectionFlags
from gsrain_engine.scene.formats.scene_files import write_scene
from gsrain_engine.scene.scene import Actor
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


def files_of(scene, folder):
    write_scene(scene, folder)
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
