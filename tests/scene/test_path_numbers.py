"""A path in numbers that people read and set: angles, focal lengths, speeds, and keys taken from a drive."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gsrain_engine.scene.camera_path import CameraPath
from gsrain_engine.scene.camera_path_edit import (
    PathSpeed,
    ViewAngles,
    focal_length_mm,
    fov_of_focal_length,
    nearest_time,
    resample,
    simplify,
    snap_key_to,
    view_angles,
    view_rotation,
)
from gsrain_engine.scene.geometry import matrices_from_quaternions, quaternions_from_matrices

LEVEL = np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]])  # looks along +x


def flight(times, positions, headings_deg=None, fov=50.0):
    headings = np.zeros(len(times)) if headings_deg is None else headings_deg
    quaternions = np.array(
        [quaternions_from_matrices(view_rotation(ViewAngles(float(each), 0.0, 0.0))) for each in headings]
    )
    return CameraPath(
        np.asarray(times, float), np.asarray(positions, float), quaternions, np.full(len(times), float(fov))
    )


@given(st.floats(-179, 179), st.floats(-89, 89), st.floats(-179, 179))
def test_angles_come_back(heading, pitch, roll):
    rotation = view_rotation(ViewAngles(heading, pitch, roll))
    assert np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(rotation) == pytest.approx(1)
    assert view_angles(rotation) == pytest.approx((heading, pitch, roll), abs=1e-6)


def test_angles_mean_what_they_say():
    assert np.allclose(view_rotation(ViewAngles(0, 0, 0)), LEVEL)
    assert view_rotation(ViewAngles(90, 0, 0))[:, 2] == pytest.approx([0, 1, 0])
    assert view_rotation(ViewAngles(0, 90, 0))[:, 2] == pytest.approx([0, 0, 1])
    leaning = view_rotation(ViewAngles(0, 0, 30))
    assert leaning[2, 0] == pytest.approx(-0.5)  # its right side points down
    assert view_angles(view_rotation(ViewAngles(40, 90, 0))) == pytest.approx((40, 90, 0), abs=1e-5)


def test_focal_lengths():
    assert focal_length_mm(27.0) == pytest.approx(50, rel=0.01)  # the normal lens
    assert fov_of_focal_length(focal_length_mm(63.0)) == pytest.approx(63)


def test_speed_of_a_straight_flight():
    speed = PathSpeed.of(flight([0, 1, 2], [[0, 0, 0], [10, 0, 0], [20, 0, 0]]))
    assert speed.length_m == pytest.approx(20)
    assert speed.fastest_km_h == pytest.approx(36)
    assert speed.mean_km_h == pytest.approx(36)
    assert speed.warning is None
    assert speed.implausible_spans == []


def test_leaps_and_spins_are_reported():
    leaping = flight([0, 1, 1.2, 2], [[0, 0, 0], [1, 0, 0], [30, 0, 0], [31, 0, 0]])
    leap = PathSpeed.of(replace(leaping, interpolation="linear"))
    assert leap.fastest_km_h == pytest.approx(3.6 * 29 / 0.2)
    assert "522 km/h" in leap.warning
    (span,) = leap.implausible_spans
    assert span == pytest.approx((1.0, 1.2), abs=0.05)
    spin = PathSpeed.of(flight([0, 0.4], [[0, 0, 0], [1, 0, 0]], [0, 170]))
    assert "degrees a second" in spin.warning


def test_one_key_has_no_length_and_no_speed():
    speed = PathSpeed.of(flight([2.0], [[1, 2, 3]]))
    assert (speed.length_m, speed.mean_km_h, speed.fastest_km_h, speed.warning) == (0, 0, 0, None)


def a_drive():
    """A minute of 10 Hz: straight on, round a corner, straight on."""
    t = np.arange(0, 60, 0.1)
    heading = np.clip((t - 20) / 10, 0, 1) * 90
    steps = 0.8 * np.stack([np.cos(np.radians(heading)), np.sin(np.radians(heading)), 0 * t], axis=1)
    return flight(t, np.cumsum(steps, axis=0), heading)


def test_a_drive_becomes_few_keys_that_follow_it():
    drive = a_drive()
    few = simplify(drive, 0.05, 0.5)
    assert 4 <= len(few.times_s) < 40
    assert set(few.times_s) <= set(drive.times_s)
    assert (few.start_s, few.end_s) == (drive.start_s, drive.end_s)
    assert np.linalg.norm(few.places(drive.times_s) - drive.positions, axis=1).max() <= 0.05
    traces = np.einsum("tij,tij->t", few.turns(drive.times_s), drive.turns(drive.times_s))
    assert np.degrees(np.arccos(np.clip((traces - 1) / 2, -1, 1))).max() <= 0.5
    assert len(simplify(drive, 1.0, 10).times_s) < len(few.times_s)


def test_keys_every_few_seconds():
    drive = a_drive()
    assert resample(drive, 10.0).times_s == pytest.approx(np.linspace(0, 59.9, 7), abs=0.06)
    assert len(resample(drive, 1e6).times_s) == 2
    assert len(resample(flight([1.0], [[0, 0, 0]]), 1.0).times_s) == 1
    with pytest.raises(ValueError, match="above 0"):
        resample(drive, 0.0)


def test_a_key_snaps_to_the_nearest_place_of_a_drive():
    drive = flight([0, 10], [[0, 0, 0], [100, 0, 0]], [0, 0])
    path = flight([1, 2], [[42.5, 3, 1], [0, 0, 9]], [80, 80])
    assert nearest_time(drive, path.positions[0]) == pytest.approx(4.25)
    snapped = snap_key_to(path, 0, drive)
    assert snapped.positions[0] == pytest.approx([42.5, 0, 0])
    assert view_angles(matrices_from_quaternions(snapped.quaternions_wxyz[0])).heading_deg == pytest.approx(0, abs=1e-6)
    assert np.array_equal(snapped.positions[1], path.positions[1])
    kept = snap_key_to(path, 0, drive, turn_too=False)
    assert np.array_equal(kept.quaternions_wxyz, path.quaternions_wxyz)
