"""Edit steps as text: they parse back, do in every form what the edit itself does, and refuse what is wrong."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import gsrain as gr
from app.main import run
from gsrain_engine.editor.edits.gaussians import CropBox, crop
from gsrain_engine.editor.edits.transform import move_member
from gsrain_engine.editor.steps import EDITS, EditError, EditStep, apply_steps, edit_help
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

EXAMPLES = """
turn-actor key=actors/car left_deg=30
retime-actor key=actors/car start_s=1 duration_s=2
drive-along-own-path
set-ego-start ground_point_m=[1,2,0] heading_rad=0.5
set-origin point_m=[1,2,3]
delete-selected
hide-selected
isolate-selected
show-all
crop box={"center_m":[10,0,1],"size_m":[20,6,4],"yaw_deg":20}
compact
duplicate key=layers/road
separate
remove key=layers/wall
rename key=layers/road name="wet road"
move-up key=layers/wall
move-down key=layers/road
merge keys=["layers/road","layers/wall"]
level-from-ground
level-from-points points_m=[[0,0,0],[1,0,0.1],[0,1,0]]
set-ground-height height_m=0.2
set-length measured_m=2 true_m=3
change-rain intensity_mm_h=8.5
set-rain-keyframes keyframes={"keys":[{"time_s":1,"intensity_mm_h":4}]}
move-selected delta=[[1,0,0,0.5],[0,1,0,0],[0,0,1,0],[0,0,0,1]]
move-member key=layers/road delta=[[1,0,0,0.5],[0,1,0,0],[0,0,1,0],[0,0,0,1]]
set-layer-pose key=layers/road pose={"position_m":[1,0,0],"turn_deg":[0,0,5],"scale":1}
""".strip().splitlines()


def edited_scene():
    """A road, a wall with a selection, a sky, a car that drives, and a camera path."""
    scene = small_scene()
    body = patch((-1, -1, 0), np.array([2.0, 0, 0]), np.array([0, 2.0, 0]), 5, (0.6, 0.1, 0.1))
    car = Actor("car", "car", (2.0, 2.0, 1.0), body, scene.ego)
    third = [BitMask.of(np.arange(400) % 3 == remainder) for remainder in range(3)]
    marks = SelectionFlags(selected=third[0], hidden=third[1], deleted=third[2])
    path = circle_path(np.array([20.0, 0.0, 1.0]), gr.home_camera(scene), 6.0)
    return replace(scene.with_member("layers/wall", marks=marks), actors=(car,), path=path, up=(0.05, 0.0, 1.0))


def files_of(scene, folder):
    write_scene(scene, folder)
    return {path.relative_to(folder): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@given(NAMES, st.dictionaries(NAMES, JSON, max_size=4))
def test_steps_parse_back(name, arguments):
    step = EditStep(name.replace("_", "-"), arguments)
    assert EditStep.parse(step.text) == step


def test_every_edit_has_an_example_here():
    assert [each.partition(" ")[0] for each in EXAMPLES] == list(EDITS)
    assert [each.name for each in edit_help()] == list(EDITS)
    assert all(each.summary for each in edit_help())


@pytest.mark.parametrize("text", EXAMPLES)
def test_steps_do_the_same_as_text_as_python_and_on_the_command_line(text, tmp_path):
    """The three forms of a step write the same files, and they differ from those of the scene before."""
    write_scene(edited_scene(), tmp_path / "scene")
    scene = gr.load(tmp_path / "scene")
    step = EditStep.parse(text)
    made = files_of(step.apply(scene), tmp_path / "made")
    assert made != files_of(scene, tmp_path / "same")
    variables = {"gr": gr, "scene": scene}
    exec(step.python, variables)
    assert files_of(variables["scene"], tmp_path / "python") == made
    assert run(["edit", str(tmp_path / "scene"), text, "-o", str(tmp_path / "command")]) == 0
    assert files_of(gr.load(tmp_path / "command"), tmp_path / "again") == made


def test_calls_are_described_by_what_differs_from_their_defaults():
    assert EditStep.of(crop, [CropBox((0, 0, 1), (4, 4, 2))]).arguments["box"]["size_m"] == [4, 4, 2]
    step = EditStep.of(move_member, ["layers/road", np.eye(4)])
    assert EditStep.parse(step.text) == step
    with pytest.raises(EditError, match="edited_scene"):
        EditStep.of(edited_scene, [])


@pytest.mark.parametrize(
    ("text", "names"),
    [
        ("renam key=3", "rename"),
        ("rename key=layers/road", "name"),
        ("rename key=layers/road name=a b=2", "b"),
        ("crop box=3", "box"),
        ("crop box", "box"),
        ("move-member key=layers/road delta=[1,2]", "delta"),
        ("rename key=layers/none name=x", "layers/none"),
        ("change-rain intensity_mm_h=-1", "intensity_mm_h"),
    ],
)
def test_wrong_steps_are_refused_by_name(text, names):
    with pytest.raises(ValueError, match=names):
        apply_steps(edited_scene(), [EditStep.parse(text)])
