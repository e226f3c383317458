"""Edits of camera paths: whatever is done, keys stay in order and apart, and what was not touched stays as it is."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from gsrain_engine.scene.camera import Camera, look_at
from gsrain_engine.scene.camera_path import CameraPath
from gsrain_engine.scene.camera_path_edit import (
    SAME_TIME_S,
    copy_keyframe_to,
    keyframe_at,
    keyframe_camera,
    move_keyframe,
    place_keyframe_at,
    reverse_path_time,
    shift_path_time,
    stretch_path_time,
    with_keyframe,
    without_keyframe,
)
from gsrain_engine.scene.geometry import normalized

UP = np.array([0.0, 0, 1])
moments = st.floats(0, 20, allow_nan=False)


def camera(number, fov=50.0):
    eye = np.array([number, 0.5 * number**2, 1.5])
    return Camera.from_fov(96, 64, fov, look_at(eye, eye + [1.0, 0.1 * number, 0], UP))


@st.composite
def paths(draw, least=1, most=7):
    times = sorted(draw(st.lists(st.integers(0, 200), min_size=least, max_size=most, unique=True)))
    seed = draw(st.integers(0, 99))
    rng = np.random.default_rng(seed)
    return CameraPath(
        np.array(times) / 10.0,
        rng.normal(0, 5, (len(times), 3)),
        Rotation.random(len(times), random_state=seed).as_quat()[:, [3, 0, 1, 2]],
        rng.uniform(30, 70, len(times)),
        interpolation=draw(st.sampled_from(["spline", "linear"])),
        easing=draw(st.sampled_from(["none", "in and out", "at each key"])),
        loop=draw(st.booleans()),
    )


def keys_of(path):
    """Keys without their moments, to be found again in another order."""
    rows = np.hstack([path.positions, path.quaternions_wxyz, path.vertical_fov_deg[:, None]])
    return {tuple(row) for row in rows.round(9).tolist()}


def test_the_first_key_begins_a_path_and_later_ones_find_their_place():
    path, key = with_keyframe(None, 2.0, camera(1))
    assert (len(path.times_s), key) == (1, 0)
    path, key = with_keyframe(path, 0.5, camera(0, 40))
    assert key == 0
    path, key = with_keyframe(path, 1.0, camera(3))
    assert key == 1
    assert path.times_s.tolist() == [0.5, 1.0, 2.0]
    assert path.vertical_fov_deg == pytest.approx([40, 50, 50])
    assert np.allclose(keyframe_camera(path, 1, 96, 64).world_to_camera, camera(3).world_to_camera, atol=1e-12)
    changed, key = with_keyframe(path, 1.0 + SAME_TIME_S / 2, camera(7))
    assert key == 1
    assert changed.times_s.tolist() == [0.5, 1.0, 2.0]
    assert np.allclose(changed.camera(1.0, 96, 64).position, camera(7).position)
    assert path.positions[1] == pytest.approx(camera(3).position)  # the old value is untouched


@given(paths(), moments)
def test_adding_a_key_and_taking_it_away_gives_the_same_path(path, time_s):
    if keyframe_at(path, time_s) is not None:
        return
    longer, key = with_keyframe(path, time_s, camera(2))
    assert longer.times_s[key] == time_s
    again = without_keyframe(longer, key)
    for field in ("times_s", "positions", "quaternions_wxyz", "vertical_fov_deg"):
        assert np.array_equal(getattr(again, field), getattr(path, field))
    assert (again.interpolation, again.easing, again.loop) == (path.interpolation, path.easing, path.loop)


@given(paths(), st.data(), moments)
def test_a_moved_key_keeps_its_camera_and_keeps_apart_from_others(path, data, time_s):
    key = data.draw(st.integers(0, len(path.times_s) - 1))
    moved, at = move_keyframe(path, key, time_s)
    assert np.array_equal(moved.positions[at], path.positions[key])
    assert np.array_equal(moved.quaternions_wxyz[at], path.quaternions_wxyz[key])
    assert np.all(np.diff(moved.times_s) > SAME_TIME_S)
    assert abs(moved.times_s[at] - time_s) <= 4 * SAME_TIME_S
    assert keys_of(moved) == keys_of(path)


@given(paths(), st.data(), moments)
def test_a_copied_key_leaves_the_others_where_they_are(path, data, time_s):
    key = data.draw(st.integers(0, len(path.times_s) - 1))
    copied, at = copy_keyframe_to(path, key, time_s)
    assert len(copied.times_s) == len(path.times_s) + 1
    assert np.all(np.diff(copied.times_s) > SAME_TIME_S)
    assert np.array_equal(copied.positions[at], path.positions[key])
    assert np.array_equal(np.delete(copied.times_s, at), path.times_s)


def test_the_last_key_leaves_no_path():
    path = with_keyframe(None, 0.0, camera(1)).path
    assert without_keyframe(path, 0) is None


@given(paths(least=2), st.floats(0.5, 4))
def test_stretching_shifting_and_reversing_come_back(path, factor):
    back = shift_path_time(stretch_path_time(stretch_path_time(shift_path_time(path, 3.0), factor), 1 / factor), -3.0)
    assert back.times_s == pytest.approx(path.times_s, abs=1e-9)
    twice = reverse_path_time(reverse_path_time(path))
    assert twice.times_s == pytest.approx(path.times_s, abs=1e-9)
    assert np.array_equal(twice.positions, path.positions)


@settings(max_examples=30)
@given(paths(least=2), st.floats(0, 1))
def test_a_reversed_flight_passes_the_same_places_backwards(path, share):
    path = replace(path, loop=False)
    t = path.start_s + share * path.duration_s
    back = reverse_path_time(path).places(np.array([path.start_s + path.end_s - t]))
    assert back == pytest.approx(path.places(np.array([t])), abs=1e-6)


def test_rotations_without_a_spline_are_interpolated_linearly():
    path = CameraPath(
        np.array([0.0, 0.1, 4.2, 19.7]),
        np.zeros((4, 3)),
        normalized(np.array([[-0.765283, -0.214952, -0.217861, -0.566281], [-0.562218, 0.504768, -0.579325, 0.305783],
                             [-0.272462, 0.68327, 0.458908, -0.498307], [0.687757, 0.122932, -0.715419, 0.007287]])),
        np.full(4, 50.0),
    )  # fmt: skip
    turns = reverse_path_time(path).turns(np.linspace(0, 19.7, 50))
    assert np.allclose(turns @ turns.transpose(0, 2, 1), np.eye(3), atol=1e-6)


@pytest.mark.parametrize("factor", [0.0, -1.0, np.nan])
def test_keys_can_not_be_stretched_onto_one_another(factor):
    path = with_keyframe(with_keyframe(None, 0.0, camera(1)).path, 1.0, camera(2)).path
    with pytest.raises(ValueError, match="fall together"):
        stretch_path_time(path, factor)


def test_a_placed_key_changes_only_what_is_given():
    path = with_keyframe(with_keyframe(None, 0.0, camera(1)).path, 1.0, camera(2)).path
    placed = place_keyframe_at(path, 1, np.array([9.0, 8, 7]))
    assert placed.positions[1].tolist() == [9, 8, 7]
    assert np.array_equal(placed.positions[0], path.positions[0])
    assert np.array_equal(placed.quaternions_wxyz, path.quaternions_wxyz)
    longer_quaternion = place_keyframe_at(path, 0, quaternion_wxyz=np.array([2.0, 0, 0, 0]))
    assert longer_quaternion.quaternions_wxyz[0].tolist() == [1, 0, 0, 0]
    with pytest.raises(ValueError, match="below 180"):
        place_keyframe_at(path, 0, vertical_fov_deg=180.0)
