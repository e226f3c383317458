"""Random sessions of an editor: edit, drag, undo, redo, save, die and recover, to the same bytes."""

import os
import shutil
import tempfile
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule

from editor.edits.edited_scene import edited_scene, turned
from editor.files.open_document import answer, keep_now, settle
from gsrain_engine.editor.document import DocumentState
from gsrain_engine.editor.editor import Editor
from gsrain_engine.editor.edits import actors, gaussians, layers, level, members, rain_keyframes, transform
from gsrain_engine.editor.edits.gaussians import CropBox
from gsrain_engine.editor.selection import candidates, commands
from gsrain_engine.editor.selection.volume import Sphere, in_volume, near_selection
from gsrain_engine.rain.keyframes import NO_KEYFRAMES, RainKeyframes
from gsrain_engine.rain.settings import RainSettings
from gsrain_engine.scene import camera_path_edit
from gsrain_engine.scene.camera import Camera, look_at
from gsrain_engine.scene.flags import BitMask
from gsrain_engine.scene.formats.scene_files import write_scene
from gsrain_engine.scene.formats.scene_json import record_of
from gsrain_engine.scene.scene import ColorGrading, Scene


def arrays_of(scene):
    names = ("means", "scales", "quaternions", "opacities", "sh")
    return [getattr(member.gaussians, name) for member in scene.members for name in names]


def facts_of(state):
    """All of a document except for its Gaussians."""
    scene = replace(state.scene, rain=None, weather=None, view=None)
    return msgspec.json.encode(record_of(scene, [""] * len(scene.members))), state.rain, state.keyframes


def bytes_of(state):
    return [array.tobytes() for array in arrays_of(state.scene)], facts_of(state)


# Edits with any arguments; "WHICH" and the like stand for members of the scene that is there


def on_member(edit):
    def change(scene, which, *arguments):
        return edit(scene, scene.members[which % len(scene.members)].key, *arguments)

    return change


def select_some(scene, which, seed):
    member = scene.members[which % len(scene.members)]
    flags = np.random.default_rng(seed).random(len(member.gaussians)) < 0.4
    return scene.with_member(member.key, marks=replace(member.marks, selected=BitMask.of(flags)))


def merge_two(scene, first, second):
    return layers.merge(scene, [scene.layers[which % len(scene.layers)].key for which in (first, second)])


def on_path(edit):
    """Edit the camera path; ValueError if there is none."""

    def change(scene, *arguments):
        if scene.path is None:
            raise ValueError("no path")
        return members.with_path(scene, edit, *arguments)

    return change


WHICH, SEED, TIME = st.integers(0, 7), st.integers(0, 99), st.integers(0, 9000).map(lambda time_ms: time_ms / 1000)
PLACE = st.tuples(*[st.floats(-3, 3)] * 3)
DELTA = st.builds(turned, st.floats(-90, 90), st.integers(0, 2), st.floats(0.5, 2), PLACE)
CAMERA = st.builds(
    lambda eye: Camera.from_fov(30, 20, 50.0, look_at(np.array(eye), np.array([9.0, 0, 0]), np.array([0.0, 0, 1]))),
    PLACE,
)
GRADING = st.builds(ColorGrading, exposure_ev=st.floats(-2, 2), saturation=st.floats(0, 2))
BALL = st.builds(Sphere, PLACE, st.floats(0.5, 3))
MODE = st.sampled_from(["set", "add", "remove", "intersect"])


def edit_of(function, *arguments):
    return st.tuples(st.just(function), *arguments)


EDIT = st.one_of(
    edit_of(select_some, WHICH, SEED),
    st.tuples(st.sampled_from([
        gaussians.delete_selected, gaussians.hide_selected, gaussians.show_all, gaussians.isolate_selected,
        gaussians.compact, layers.separate, candidates.all_selected, candidates.none_selected, candidates.inverted,
        actors.drive_along_own_path,
    ])),
    edit_of(commands.select_found, MODE, st.just(in_volume), TIME, BALL),
    edit_of(commands.select_found, st.just("add"), st.just(near_selection), TIME, st.floats(0.1, 2)),
    edit_of(commands.save_set, st.sampled_from(["a", "b"])),
    edit_of(transform.move_selected, DELTA),
    edit_of(on_member(transform.move_member), WHICH, DELTA),
    edit_of(on_member(members.set_grading), WHICH, GRADING),
    edit_of(on_member(members.set_opacity), WHICH, st.floats(0, 1)),
    edit_of(on_member(members.set_locked), WHICH, st.booleans()),
    edit_of(on_member(members.set_visible), WHICH, st.booleans()),
    *(edit_of(on_member(each), WHICH) for each in (layers.duplicate, layers.remove, layers.move_up, layers.move_down)),
    edit_of(on_member(layers.rename), WHICH, st.sampled_from(["ground", "house", "", "new"])),
    edit_of(merge_two, WHICH, WHICH),
    edit_of(on_member(actors.turn_actor), WHICH, st.floats(-90, 90)),
    edit_of(on_member(actors.retime_actor), WHICH, st.floats(0, 5), st.floats(0.1, 5)),
    edit_of(level.set_length, st.floats(0.5, 2), st.floats(0.5, 2)),
    edit_of(level.set_ground_height, st.floats(-2, 2)),
    edit_of(actors.set_origin, PLACE.map(np.array)),
    edit_of(actors.set_ego_start, PLACE.map(np.array), st.floats(-3, 3)),
    edit_of(level.level_from_points, st.just(np.array([[0.0, 0, 0], [1, 0, 0.2], [0, 1, 0]]))),
    edit_of(gaussians.crop, st.just(CropBox((0.0, 0.0, 0.0), (3.0, 3.0, 3.0)))),
    edit_of(members.with_path, st.just(camera_path_edit.with_keyframe), TIME, CAMERA),
    edit_of(on_path(camera_path_edit.reverse_path_time)),
    edit_of(on_path(camera_path_edit.stretch_path_time), st.floats(0.2, 3)),
    edit_of(on_path(camera_path_edit.move_keyframe), st.just(0), TIME),
    edit_of(on_path(camera_path_edit.without_keyframe), st.just(0)),
)  # fmt: skip
RAIN = st.fixed_dictionaries({}, optional={
    "intensity_mm_h": st.floats(0, 100), "wind_m_s": st.tuples(st.floats(-9, 9), st.floats(-9, 9)),
    "exposure_s": st.floats(0.001, 0.1), "haze": st.sampled_from(["medium", "gaussians", "none"]), "seed": SEED,
})  # fmt: skip
KEYFRAMES = st.one_of(
    edit_of(rain_keyframes.add_shower, TIME),
    edit_of(RainKeyframes.with_key, TIME, st.none()),
    edit_of(RainKeyframes.without_key, st.just(0.0)),
    edit_of(rain_keyframes.replace_keyframes, st.just(NO_KEYFRAMES)),
)  # fmt: skip


class RandomSession(RuleBasedStateMachine):
    """One editor after another with one scene folder. `states` are the bytes of each step of its history."""

    @initialize()
    def open_scene(self):
        self.folder = Path(tempfile.mkdtemp())
        self.before = dict(os.environ)
        os.environ |= {"XDG_STATE_HOME": str(self.folder / "state"), "XDG_CONFIG_HOME": str(self.folder / "config")}
        write_scene(edited_scene(), self.folder / "scene")
        self.editor = Editor()
        self.editor.files.open(str(self.folder / "scene"))
        settle(self.editor)
        self.states = [bytes_of(self.editor.document.state)]

    def teardown(self):
        if hasattr(self, "editor"):
            self.editor.files.give_up()
            self.editor.close()
            shutil.rmtree(self.folder)
            os.environ.clear()
            os.environ |= self.before

    def changed(self):
        """Take the state after a change that may have been refused, or have made a step."""
        history = self.editor.document.history
        now = bytes_of(history.present)
        if now != self.states[min(history.cursor, len(self.states) - 1)] or history.cursor == len(self.states):
            self.states[history.cursor :] = [now]
        del self.states[len(history.steps) :]

    @rule(edit=EDIT)
    def edit_scene(self, edit):
        if self.editor.document.scene.layers:
            self.editor.document.edit("Edit", *edit)
            self.changed()

    @rule(time_s=TIME, gesture=st.sampled_from([None, "drag"]), changes=st.lists(RAIN, min_size=1, max_size=3))
    def change_rain(self, time_s, gesture, changes):
        self.editor.playback.clock.seek(time_s)
        for fields in changes:
            self.editor.document.change_rain("Rain", gesture, **fields)
            self.changed()

    @rule(edit=KEYFRAMES, rate=st.floats(-1, 101))
    def edit_keyframes(self, edit, rate):
        function, *arguments = edit
        if function is RainKeyframes.with_key:
            self.editor.document.edit_keyframes("Key", function, arguments[0], intensity_mm_h=rate)
        else:
            self.editor.document.edit_keyframes("Keys", function, *arguments)
        self.changed()

    @rule()
    def end_gesture(self):
        self.editor.document.end_gesture()

    @rule()
    def undo(self):
        self.editor.document.undo()

    @rule()
    def redo(self):
        self.editor.document.redo()

    @rule(step=st.integers(-1, 9))
    def go_to_step(self, step):
        self.editor.document.go_to_step(step)

    @rule()
    def save(self):
        self.editor.files.save()
        settle(self.editor)
        assert not self.editor.files.has_changes and self.editor.status.problem is None

    @precondition(lambda self: self.editor.files.has_changes and self.editor.document.scene.members)
    @rule()
    def die_and_recover(self):
        """Lose the window after an autosave, and go on in another one."""
        keep_now(self.editor)
        before = self.editor.document.state
        self.editor.close()
        self.editor = Editor()
        self.editor.files.recovery.look()
        settle(self.editor)
        answer(self.editor, "Recover")
        after = self.editor.document.state
        assert facts_of(after) == facts_of(before) and self.editor.files.has_changes
        for old, new in zip(arrays_of(before.scene), arrays_of(after.scene), strict=True):
            np.testing.assert_allclose(new, old, rtol=1e-5, atol=1e-6)  # opacities are saved as logits
        self.states = [bytes_of(after)]

    @invariant()
    def every_byte_is_there(self):
        if hasattr(self, "states"):
            history = self.editor.document.history
            assert bytes_of(history.present) == self.states[history.cursor]
            assert len(history.steps) == len(self.states)

    @invariant()
    def a_step_is_its_function_with_its_arguments(self):
        if hasattr(self, "editor"):
            history = self.editor.document.history
            again = history.step.applied_to(history.previous if history.cursor else history.present)
            assert bytes_of(again) == bytes_of(history.present)


TestRandomSession = RandomSession.TestCase
TestRandomSession.settings = settings(max_examples=25, stateful_step_count=20, deadline=None)


# The document alone


def test_a_drag_is_one_step_from_where_it_began(editor):
    document = editor.document
    document.edit_keyframes("Keys", rain_keyframes.add_shower, 0.0)
    heard = []
    document.followers.append(lambda old, new: heard.append((old, new)))
    for to_s in (12.0, 14.0, 11.0):
        document.edit_keyframes("Move", rain_keyframes.move_keyframe, "intensity_mm_h", 1, to_s, gesture="drag")
    document.end_gesture()
    document.edit_keyframes("Move", rain_keyframes.move_keyframe, "intensity_mm_h", 1, 13.0, gesture="drag")
    assert [each.label for each in document.history.steps] == ["Opened", "Keys", "Move", "Move"]
    assert document.history.steps[2].arguments == ("intensity_mm_h", 1, 11.0)
    assert document.keyframes.times_s[1] == 13.0 and len(document.keyframes.keys) == 7
    assert len(heard) == 4 and heard[-1] == (document.history.previous, document.state)
    assert heard[0][1] is heard[1][0]
    for at_s in (100.0, 200.0):
        document.edit_keyframes("Key", RainKeyframes.with_key, at_s, intensity_mm_h=1.0, gesture="place")
    assert document.keyframes.times_s[-1] == 200.0 and len(document.keyframes.keys) == 8  # one key, not two


def test_a_drag_after_an_undo_drops_the_redo_steps(editor):
    document = editor.document
    document.change_rain("Rain", "drag", intensity_mm_h=1.0)
    document.edit_keyframes("Keys", rain_keyframes.add_shower, 0.0)
    document.undo()
    document.change_rain("Rain", "drag", intensity_mm_h=3.0)
    assert [each.label for each in document.history.steps] == ["Opened", "Rain"]
    assert document.rain.intensity_mm_h == 3.0 and document.history.redo_label is None


@pytest.mark.parametrize(
    ("fields", "text"),
    [
        ({"intensity_mm_h": 13.0}, "8.5 -> 13 mm/h"), ({"sensor": "rainsense"}, "none -> rainsense"),
        ({"haze": "none"}, "medium -> none"), ({"streaks": False}, ""),
        ({"exposure_s": 0.004}, "none -> 0.004 s"),
        ({"wind_speed_m_s": 9.0, "wind_from_deg": 90.0}, "2 m/s, 240\u00b0 -> 9 m/s, 90\u00b0"),
        ({"intensity_mm_h": 1.0, "seed": 3}, ""), ({"drop_color": (1.0, 1.0, 1.0)}, ""), ({}, ""),
    ],
)  # fmt: skip
def test_a_step_of_the_rain_tells_its_old_and_new_value(fields, text):
    before = DocumentState(Scene("scene"), RainSettings(intensity_mm_h=8.5))
    assert before.rain_change(replace(before, rain=msgspec.structs.replace(before.rain, **fields))) == text


def test_what_a_change_refuses_is_reported_and_what_changes_nothing_is_no_step(editor):
    document, status = editor.document, editor.status
    document.edit("Save set", commands.save_set, "a")
    assert "selection set" in status.problem and "selection set" in status.log.lines[-1].text
    assert not document.edit("Nothing", candidates.none_selected)
    document.change_rain("Same", intensity_mm_h=document.rain.intensity_mm_h)
    document.undo()
    assert len(document.history.steps) == 1 and document.history.undo_label is document.history.redo_label is None
