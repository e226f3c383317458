"""Interpolation between keyframes: splines, straight lines, loops and easing."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import CubicSpline, PchipInterpolator
from scipy.spatial.transform import Rotation, RotationSpline

from gsrain_engine.scene.camera_path import CameraPath, apply_easing

KNOTS = np.array([0.0, 1.0, 2.5, 3.0])


def wild(keys=6, seed=2, **fields):
    rng = np.random.default_rng(seed)
    turns = Rotation.random(keys, random_state=seed).as_quat()[:, [3, 0, 1, 2]]
    times = np.cumsum(rng.uniform(0.5, 2, keys))
    return CameraPath(times, rng.normal(0, 5, (keys, 3)), turns, rng.uniform(30, 60, keys), **fields)


def test_default_paths_have_the_same_bytes_as_ever():
    path = wild()
    positions = CubicSpline(path.times_s, path.positions, bc_type="natural")
    rotations = RotationSpline(path.times_s, Rotation.from_quat(path.quaternions_wxyz[:, [1, 2, 3, 0]]))
    fov = PchipInterpolator(path.times_s, path.vertical_fov_deg)
    for t in np.linspace(path.times_s[0], path.times_s[-1], 23).tolist():
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = rotations(t).as_matrix(), positions(t)
        camera = path.camera(t, 90, 60)
        assert camera.world_to_camera.tobytes() == np.linalg.inv(pose).tobytes()
        assert camera.fy == 0.5 * 60 / np.tan(np.radians(float(fov(t))) / 2)
        assert path.velocity(t).tobytes() == positions(t, 1).tobytes()


def test_linear_is_linear():
    path = wild(interpolation="linear")
    for k in range(5):
        start, end = path.times_s[k : k + 2]
        for share in (0.0, 0.25, 0.9):
            t = start + share * (end - start)
            camera = path.camera(t, 90, 60)
            assert camera.position == pytest.approx((1 - share) * path.positions[k] + share * path.positions[k + 1])
            fov = (1 - share) * path.vertical_fov_deg[k] + share * path.vertical_fov_deg[k + 1]
            assert camera.vertical_fov_deg == pytest.approx(fov)
            assert path.velocity(t) == pytest.approx((path.positions[k + 1] - path.positions[k]) / (end - start))
    a, b = (Rotation.from_quat(q[[1, 2, 3, 0]]) for q in path.quaternions_wxyz[:2])
    middle = path.turns(np.array([(path.times_s[0] + path.times_s[1]) / 2]))[0]
    half = a * Rotation.from_rotvec(0.5 * (a.inv() * b).as_rotvec())
    assert np.allclose(middle, half.as_matrix(), atol=1e-9)


@settings(max_examples=25, deadline=None)
@given(st.integers(2, 6), st.integers(0, 50), st.sampled_from(["none", "in and out", "at each key"]))
def test_a_loop_closes_in_place_and_speed(keys, seed, easing):
    path = wild(keys, seed, loop=True, easing=easing)
    assert path.duration_s == pytest.approx((path.times_s[-1] - path.times_s[0]) * keys / (keys - 1))
    h = 1e-6
    for seam in (path.start_s, path.end_s, path.start_s + 3 * path.duration_s):
        before, after = path.camera(seam - h, 9, 6), path.camera(seam + h, 9, 6)
        assert before.position == pytest.approx(after.position, abs=1e-3)
        assert np.allclose(before.world_to_camera[:3, :3], after.world_to_camera[:3, :3], atol=1e-3)
        assert path.velocity(seam - h) == pytest.approx(path.velocity(seam + h), abs=1e-3)
        turns = path.turns(np.array([seam - 2 * h, seam - h, seam + h, seam + 2 * h]))
        rates = [(turns[i].T @ turns[i + 1] - np.eye(3)) / h for i in (0, 2)]
        assert np.allclose(rates[0], rates[1], atol=1e-2)
    again = path.camera(path.start_s + 0.3 + 2 * path.duration_s, 9, 6)
    assert np.allclose(again.world_to_camera, path.camera(path.start_s + 0.3, 9, 6).world_to_camera, atol=1e-9)
    for k, t in enumerate(path.times_s):
        assert path.camera(float(t), 9, 6).position == pytest.approx(path.positions[k], abs=1e-9)


def test_a_linear_loop_flies_straight_back():
    path = wild(3, interpolation="linear", loop=True)
    way_back = path.end_s - path.times_s[-1]
    camera = path.camera(float(path.times_s[-1] + 0.25 * way_back), 9, 6)
    assert camera.position == pytest.approx(0.75 * path.positions[-1] + 0.25 * path.positions[0])


@pytest.mark.parametrize("easing", ["none", "in and out", "at each key"])
def test_easing_is_monotone_keeps_keys_and_tells_its_own_rate(easing):
    t = np.linspace(0, 3, 3001)
    times, rates = apply_easing(easing, KNOTS, t)
    assert np.all(np.diff(times) >= 0)
    assert apply_easing(easing, KNOTS, KNOTS).times_s == pytest.approx(KNOTS)
    assert np.all(rates >= 0)
    middle = (times[2:] - times[:-2]) / (t[2:] - t[:-2])
    assert middle == pytest.approx(rates[1:-1], abs=6e-3)
    assert np.abs(np.diff(rates)).max() < 0.02  # no jumps, at keys neither
    rests = {"none": [], "in and out": [0, 3], "at each key": [0, 1, 2, 3]}[easing]
    at_keys = apply_easing(easing, KNOTS, KNOTS).rates
    assert [k for k in range(4) if at_keys[k] < 1e-9] == rests


def test_easing_between_two_keys_rests_at_both():
    path = replace(wild(2), easing="in and out")
    assert path.velocity(path.start_s) == pytest.approx([0, 0, 0])
    assert path.velocity(path.end_s) == pytest.approx([0, 0, 0])
    middle = (path.start_s + path.end_s) / 2
    assert path.camera(middle, 9, 6).position == pytest.approx(path.positions.mean(axis=0))
    assert np.linalg.norm(path.velocity(middle)) == pytest.approx(
        1.5 * np.linalg.norm(path.positions[1] - path.positions[0]) / path.duration_s
    )


def test_velocity_of_an_eased_path_is_the_derivative_of_its_place():
    path, h = wild(easing="at each key"), 1e-6
    for t in (path.start_s + 0.1, 0.5 * (path.start_s + path.end_s)):
        change = (path.camera(t + h, 9, 6).position - path.camera(t - h, 9, 6).position) / (2 * h)
        assert path.velocity(t) == pytest.approx(change, rel=1e-4, abs=1e-6)


def test_many_moments_at_once_are_the_same_as_one_by_one():
    for path in (wild(), wild(loop=True, easing="in and out"), wild(1)):
        times = np.linspace(path.start_s - 1, path.end_s + 1, 9)
        for k, t in enumerate(times.tolist()):
            camera = path.camera(t, 9, 6)
            assert path.places(times)[k] == pytest.approx(camera.position, abs=1e-9)
            assert np.allclose(path.turns(times)[k], camera.camera_to_world[:3, :3], atol=1e-9)
            assert np.array_equal(path.velocities(times)[k], path.velocity(t))


def test_moving_a_path_keeps_what_lies_between_its_keys():
    path = wild(loop=True, easing="at each key", interpolation="linear", exposure_s=0.002)
    moved = path.moved(np.diag([2.0, 2, 2, 1]))
    assert (moved.loop, moved.easing, moved.interpolation, moved.exposure_s) == (True, "at each key", "linear", 0.002)
