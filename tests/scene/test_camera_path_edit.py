"""Edits of camera paths, and their numbers: angles, focal lengths, speeds, and few keys taken from a drive."""

from dataclasses import fields, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from gsrain_engine.editor.edits.level import set_length
from gsrain_engine.scene import camera_path_edit as edits
from gsrain_engine.scene.camera import Camera, look_at
from gsrain_engine.scene.camera_path import CameraPath
from gsrain_engine.scene.geometry import matrices_from_quaternions, normalized, quaternions_from_matrices
from small_scene import AHEAD, small_scene

# The type checker of the tests picks an element of a tuple by `random`.
pytestmark = pytest.mark.filterwarnings("ignore::hypothesis.errors.HypothesisDeprecationWarning")
UP = np.array([0.0, 0, 1])
moments = st.floats(0, 20, allow_nan=False)


def camera(number: int, fov: float = 50.0) -> Camera:
    eye = np.array([number, 0.5 * number**2, 1.5])
    return Camera.from_fov(96, 64, fov, look_at(eye, eye + [1.0, 0.1 * number, 0], UP))


@st.composite
def paths(draw: st.DrawFn, min_keys: int = 1) -> CameraPath:
    times = sorted(draw(st.lists(st.integers(0, 200), min_size=min_keys, max_size=7, unique=True)))
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


def same_path(a: CameraPath | None, b: CameraPath) -> bool:
    return a is not None and all(np.array_equal(getattr(a, each.name), getattr(b, each.name)) for each in fields(a))


# Keyframes stay in order and apart, and others stay as they are


def test_the_first_key_begins_a_path_and_later_ones_find_their_place() -> None:
    path, key = edits.with_keyframe(None, 2.0, camera(1))
    assert (len(path.times_s), key) == (1, 0) and edits.without_keyframe(path, 0) is None
    path, key = edits.with_keyframe(path, 0.5, camera(0, 40))
    assert key == 0
    path, key = edits.with_keyframe(path, 1.0, camera(3))
    assert key == 1 and path.times_s.tolist() == [0.5, 1.0, 2.0]
    assert path.vertical_fov_deg == pytest.approx([40, 50, 50])
    assert np.allclose(edits.keyframe_camera(path, 1, 96, 64).world_to_camera, camera(3).world_to_camera, atol=1e-12)
    changed, key = edits.with_keyframe(path, 1.0 + edits.SAME_TIME_S / 2, camera(7))
    assert key == 1 and changed.times_s.tolist() == [0.5, 1.0, 2.0]
    assert np.allclose(changed.camera(1.0, 96, 64).position, camera(7).position)
    assert path.positions[1] == pytest.approx(camera(3).position)  # the old value is untouched


@given(paths(), st.data(), moments)
def test_keys_are_added_moved_copied_and_removed_without_changing_others(
    path: CameraPath, data: st.DataObject, time_s: float
) -> None:
    key = data.draw(st.integers(0, len(path.times_s) - 1))
    moved, at = edits.move_keyframe(path, key, time_s)
    copied, copy = edits.copy_keyframe_to(path, key, time_s)
    for changed, place in ((moved, at), (copied, copy)):
        assert np.array_equal(changed.positions[place], path.positions[key])
        assert np.array_equal(changed.quaternions_wxyz[place], path.quaternions_wxyz[key])
        assert np.all(np.diff(changed.times_s) > edits.SAME_TIME_S)
    assert abs(moved.times_s[at] - time_s) <= 4 * edits.SAME_TIME_S
    assert moved.times_s[at] >= min(time_s, 0) and copied.times_s[copy] >= min(time_s, 0)
    assert same_path(edits.without_keyframe(copied, copy), path)
    assert same_path(edits.without_keyframe(moved, at) or path, edits.without_keyframe(path, key) or path)
    if edits.keyframe_at(path, time_s) is None:
        longer, added = edits.with_keyframe(path, time_s, camera(2))
        assert longer.times_s[added] == time_s
        assert same_path(edits.without_keyframe(longer, added), path)


@settings(max_examples=50)
@given(paths(min_keys=2), st.floats(0.5, 4), st.floats(0, 1))
def test_stretching_shifting_and_reversing_come_back(path: CameraPath, factor: float, share: float) -> None:
    stretched = edits.stretch_path_time(edits.stretch_path_time(path, factor), 1 / factor)
    back = edits.shift_path_time(edits.shift_path_time(stretched, 3.0), -3.0)
    twice = edits.reverse_path_time(edits.reverse_path_time(path))
    for each in (back, twice):
        assert each.times_s == pytest.approx(path.times_s, abs=1e-9)
        assert same_path(replace(each, times_s=path.times_s), path)
    path = replace(path, loop=False)
    t = path.start_s + share * path.duration_s
    reversed_place = edits.reverse_path_time(path).places(np.array([path.start_s + path.end_s - t]))
    assert reversed_place == pytest.approx(path.places(np.array([t])), abs=1e-6)


def test_rotations_without_a_spline_are_interpolated_linearly() -> None:
    quaternions = [[-0.765283, -0.214952, -0.217861, -0.566281], [-0.562218, 0.504768, -0.579325, 0.305783],
                   [-0.272462, 0.68327, 0.458908, -0.498307], [0.687757, 0.122932, -0.715419, 0.007287]]  # fmt: skip
    times = np.array([0.0, 0.1, 4.2, 19.7])
    path = CameraPath(times, np.zeros((4, 3)), normalized(np.array(quaternions)), np.full(4, 50.0))
    turns = edits.reverse_path_time(path).turns(np.linspace(0, 19.7, 50))
    assert np.allclose(turns @ turns.transpose(0, 2, 1), np.eye(3), atol=1e-6)


def test_a_placed_key_changes_only_what_is_given() -> None:
    path = edits.with_keyframe(edits.with_keyframe(None, 0.0, camera(1)).path, 1.0, camera(2)).path
    placed = edits.place_keyframe_at(path, 1, np.array([9.0, 8, 7]))
    assert placed.positions.tolist() == [path.positions[0].tolist(), [9, 8, 7]]
    assert same_path(replace(placed, positions=path.positions), path)
    longer_quaternion = edits.place_keyframe_at(path, 0, quaternion_wxyz=np.array([2.0, 0, 0, 0]))
    assert longer_quaternion.quaternions_wxyz[0].tolist() == [1, 0, 0, 0]
    with pytest.raises(ValueError, match="below 180"):
        edits.place_keyframe_at(path, 0, vertical_fov_deg=180.0)
    for factor in (0.0, -1.0, np.nan):
        with pytest.raises(ValueError, match="fall together"):
            edits.stretch_path_time(path, factor)


# Angles and focal lengths


@given(st.floats(-179, 179), st.floats(-89, 89), st.floats(-179, 179))
def test_angles_come_back(heading: float, pitch: float, roll: float) -> None:
    rotation = edits.view_rotation(edits.ViewAngles(heading, pitch, roll))
    assert np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(rotation) == pytest.approx(1)
    assert edits.view_angles(rotation) == pytest.approx((heading, pitch, roll), abs=1e-6)


def test_angles_and_focal_lengths_are_those_of_the_world() -> None:
    assert np.allclose(edits.view_rotation(edits.ViewAngles(0, 0, 0)), AHEAD)
    assert edits.view_rotation(edits.ViewAngles(90, 0, 0))[:, 2] == pytest.approx([0, 1, 0])
    assert edits.view_rotation(edits.ViewAngles(0, 90, 0))[:, 2] == pytest.approx([0, 0, 1])
    assert edits.view_rotation(edits.ViewAngles(0, 0, 30))[2, 0] == pytest.approx(-0.5)  # its right side points down
    assert edits.view_angles(edits.view_rotation(edits.ViewAngles(40, 90, 0))) == pytest.approx((40, 90, 0), abs=1e-5)
    assert edits.focal_length_mm(27.0) == pytest.approx(50, rel=0.01)  # the normal lens
    assert edits.fov_of_focal_length(edits.focal_length_mm(63.0)) == pytest.approx(63)


# Speed


def flight(times: object, positions: object, headings_deg: object = 0.0) -> CameraPath:
    times = np.asarray(times, float)
    turns = [
        edits.view_rotation(edits.ViewAngles(float(each), 0.0, 0.0))
        for each in np.broadcast_to(headings_deg, len(times))
    ]
    quaternions = quaternions_from_matrices(np.array(turns))
    return CameraPath(times, np.asarray(positions, float), quaternions, np.full(len(times), 50.0))


def along_x(*places: float) -> CameraPath:
    """A key a second."""
    return flight(np.arange(len(places)), [[x, 0.0, 2.0] for x in places])


def test_speeds_leaps_and_spins_of_flights() -> None:
    speed = edits.PathSpeed.of(along_x(0, 10, 20))
    assert (speed.length_m, speed.fastest_km_h, speed.mean_km_h) == pytest.approx((20, 36, 36))
    assert speed.warning is None and speed.implausible_spans == []
    leaping = flight([0, 1, 1.2, 2], [[0, 0, 0], [1, 0, 0], [30, 0, 0], [31, 0, 0]])
    leap = edits.PathSpeed.of(replace(leaping, interpolation="linear"))
    assert leap.fastest_km_h == pytest.approx(3.6 * 29 / 0.2)
    assert leap.warning is not None and "522 km/h" in leap.warning
    (span,) = leap.implausible_spans
    assert span == pytest.approx((1.0, 1.2), abs=0.05)
    spin = edits.PathSpeed.of(flight([0, 0.4], [[0, 0, 0], [1, 0, 0]], [0, 170]))
    assert spin.warning is not None and "degrees a second" in spin.warning
    one = edits.PathSpeed.of(along_x(3))
    assert (one.length_m, one.mean_km_h, one.fastest_km_h, one.warning) == (0, 0, 0, None)


def test_photos_without_times_are_passed_at_a_speed() -> None:
    path = edits.with_constant_speed(along_x(0, 1, 5, 6), 2.0)
    assert path.times_s.tolist() == [0, 0.5, 2.5, 3.0] and not path.is_timed
    assert edits.PathSpeed.of(path).mean_km_h == pytest.approx(7.2, rel=0.02)
    assert edits.with_constant_speed(path, 2.0, is_timed=True).is_timed
    assert edits.with_constant_speed(along_x(3), 2.0).times_s.tolist() == [0]
    still = along_x(1, 1, 1)
    turns = np.array([[1.0, 0, 0, 0], [np.sqrt(0.5), 0, np.sqrt(0.5), 0], [0, 0, 1, 0]])
    turning = edits.with_constant_speed(replace(still, quaternions_wxyz=turns), 1.4)
    assert np.diff(turning.times_s) == pytest.approx([1.0, 1.0])
    assert (np.diff(edits.with_constant_speed(still, 1.4).times_s) > 0).all()
    for speed in (0.0, -1.0, np.inf, np.nan):
        with pytest.raises(ValueError, match="must be above 0"):
            edits.with_constant_speed(still, speed)


@pytest.mark.parametrize(("is_timed", "times"), [(False, [0, 50, 100]), (True, [0, 5, 10])])
def test_a_new_scale_keeps_the_pace_of_a_path_without_times(is_timed: bool, times: list[float]) -> None:
    path = replace(edits.with_constant_speed(along_x(0, 7, 14), edits.WALKING_M_S), is_timed=is_timed)
    longer = set_length(replace(small_scene(), metres_per_unit=1.0, path=path), 1.0, 10.0)  # a unit is 10 m
    assert longer.path is not None and longer.path.times_s == pytest.approx(times)


def test_a_path_whose_key_gets_a_time_is_timed() -> None:
    path = edits.with_constant_speed(along_x(0, 7, 14), edits.WALKING_M_S)
    assert edits.move_keyframe(path, 1, 6.0).path.is_timed and edits.stretch_path_time(path, 2.0).is_timed
    assert edits.with_keyframe(path, 3.0, path.camera(3.0, 6, 4)).path.is_timed
    assert not edits.place_keyframe_at(path, 1, np.array([7.0, 1.0, 2.0])).is_timed


# Keys taken from a drive


def drive() -> CameraPath:
    """A minute of 10 Hz: straight on, round a corner, straight on."""
    t = np.arange(0, 60, 0.1)
    heading = np.clip((t - 20) / 10, 0, 1) * 90
    steps = 0.8 * np.stack([np.cos(np.radians(heading)), np.sin(np.radians(heading)), 0 * t], axis=1)
    return flight(t, np.cumsum(steps, axis=0), heading)


def test_a_drive_becomes_few_keys_that_follow_it() -> None:
    whole = drive()
    few = edits.simplify(whole, 0.05, 0.5)
    assert 4 <= len(few.times_s) < 40
    assert set(few.times_s) <= set(whole.times_s)
    assert (few.start_s, few.end_s) == (whole.start_s, whole.end_s)
    assert np.linalg.norm(few.places(whole.times_s) - whole.positions, axis=1).max() <= 0.05
    traces = np.einsum("tij,tij->t", few.turns(whole.times_s), whole.turns(whole.times_s))
    assert np.degrees(np.arccos(np.clip((traces - 1) / 2, -1, 1))).max() <= 0.5
    assert len(edits.simplify(whole, 1.0, 10).times_s) < len(few.times_s)
    assert edits.resample(whole, 10.0).times_s == pytest.approx(np.linspace(0, 59.9, 7), abs=0.06)
    assert len(edits.resample(whole, 1e6).times_s) == 2 and len(edits.resample(along_x(1), 1.0).times_s) == 1
    with pytest.raises(ValueError, match="above 0"):
        edits.resample(whole, 0.0)


def test_a_key_snaps_to_the_nearest_place_of_a_drive() -> None:
    straight = flight([0, 10], [[0, 0, 0], [100, 0, 0]])
    path = flight([1, 2], [[42.5, 3, 1], [0, 0, 9]], 80)
    assert edits.nearest_time(straight, path.positions[0]) == pytest.approx(4.25)
    snapped = edits.snap_key_to(path, 0, straight)
    assert snapped.positions[0] == pytest.approx([42.5, 0, 0])
    angles = edits.view_angles(matrices_from_quaternions(snapped.quaternions_wxyz[0]))
    assert angles == pytest.approx((0, 0, 0), abs=1e-6)
    assert np.array_equal(snapped.positions[1], path.positions[1])
    assert np.array_equal(edits.snap_key_to(path, 0, straight, turn_too=False).quaternions_wxyz, path.quaternions_wxyz)
