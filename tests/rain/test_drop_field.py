import numpy as np
import pytest

from given_rain import HERE, STILL, found_drops
from gsrain_engine.rain.drop_field import CLASS_STRIDE, DropCulling, drop_phases, place_drops
from gsrain_engine.rain.drop_motion import DropMotion, Wind
from gsrain_engine.rain.pcg_hash import pcg4d, pcg4d_scalar
from gsrain_engine.rain.properties import CLASSES
from gsrain_engine.rain.settings import RainSettings
from gsrain_engine.rain.simulation import RainSimulation
from oracles.drop_phases import displacement, phases_of
from oracles.placed_drops import reference_drops

PERIOD = np.array([8.0, 8.0, 6.0])
FALL = np.linspace(1.0, 8.0, CLASSES)  # m/s by class


def displaced(time_s, wind=(0.0, 0.0)):
    moved = np.zeros((CLASSES, 3))
    moved[:, 0], moved[:, 1], moved[:, 2] = wind[0] * time_s, wind[1] * time_s, -FALL * time_s
    return moved


def positions_at(time_s, center=(0.0, 0.0, 0.0), wind=(0.0, 0.0), count=20_000):
    center = np.array(center, float)
    drops = place_drops(np.arange(count), 7, phases_of(displaced(time_s, wind), center, PERIOD))
    return drops.positions(PERIOD) + center, drops


def culling(camera=(-1.0, 0.3, 0.2), far=2.0, yaw=0.4, half=(2.8, 2.8, 3.0)):
    c, s = np.cos(yaw), np.sin(yaw)
    return DropCulling(
        region_rotation=np.array([[c, s], [-s, c]]),
        region_half=np.array(half),
        camera_position=np.array(camera),
        cell_to_camera=np.array([[s, -c, 0.0], [0.0, 0.0, -1.0], [c, s, 0.0]]),
        slopes=np.array([-0.5, 0.6, -0.4, 0.3]),
        class_margin_m=np.linspace(0.05, 0.1, CLASSES),
        class_far_m=np.linspace(0.5, far, CLASSES),
    )


def test_hash_is_pcg4d():
    """Against the published lines, in Python's own integers."""

    def reference(v):
        mask = 0xFFFFFFFF
        x, y, z, w = ((e * 1664525 + 1013904223) & mask for e in v)
        for last in (False, True):
            x = (x + y * w) & mask
            y = (y + z * x) & mask
            z = (z + x * y) & mask
            w = (w + y * z) & mask
            if not last:
                x, y, z, w = (e ^ (e >> 16) for e in (x, y, z, w))
        return x, y, z, w

    rng = np.random.default_rng(1)
    inputs = rng.integers(0, 2**32, (50, 4), dtype=np.uint32)
    ours = np.stack(pcg4d(*inputs.T), axis=1)
    for row, out in zip(inputs, ours, strict=True):
        assert tuple(int(v) for v in out) == reference([int(v) for v in row])
        assert tuple(int(v) for v in pcg4d_scalar(*row)) == reference([int(v) for v in row])


def test_every_class_comes_once_in_a_round():
    classes = (np.arange(CLASSES) * CLASS_STRIDE) % CLASSES
    assert len(np.unique(classes)) == CLASSES
    # and any prefix is spread evenly: no class quantile is far off
    prefix = np.sort(classes[:500]) / CLASSES
    assert np.abs(prefix - np.arange(500) / 500).max() < 0.01


@pytest.mark.parametrize("time_s", [0.0, 12.3, 9_999.9])
def test_compiled_search_finds_what_the_reference_places(time_s):
    where = phases_of(displaced(time_s, (1.0, -2.0)), np.array([1.0, 2.0, 3.0]), PERIOD)
    cull = culling()
    found = found_drops(50_000, 7, where, PERIOD, cull)
    every = reference_drops(np.arange(50_000), 7, where)
    p = (every.fractions * 2.0**-32 - 0.5) * PERIOD
    in_region = np.all(np.abs(p[:, :2] @ cull.region_rotation.T) <= cull.region_half[:2], axis=1)
    in_region &= np.abs(p[:, 2]) <= cull.region_half[2]
    u, v, depth = ((p - cull.camera_position) @ cull.cell_to_camera.T).T
    m, s = cull.class_margin_m[every.class_index], cull.slopes
    seen = in_region & (depth >= 0) & (depth <= cull.class_far_m[every.class_index])
    seen &= (u >= s[0] * depth - m) & (u <= s[1] * depth + m) & (v >= s[2] * depth - m) & (v <= s[3] * depth + m)
    assert seen.sum() > 50
    assert np.array_equal(found, np.flatnonzero(seen))
    assert len(found_drops(50_000, 7, where, PERIOD, cull, in_view=False)) == in_region.sum()


@pytest.mark.parametrize("air", [{}, {"wind_speed_m_s": 20.0, "gust_m_s": 6.0, "turbulence_m_s": 3.0}, STILL])
def test_places_and_velocities_are_those_of_the_reference_in_every_bit(air):
    field = RainSimulation.start(RainSettings(intensity_mm_h=8.5, **air)).frame(1234.5, HERE)
    numbers = np.arange(200_000)
    ours, expected = place_drops(numbers, 5, field.where), reference_drops(numbers, 5, field.where)
    np.testing.assert_array_equal(ours.class_index, expected.class_index)
    np.testing.assert_array_equal(ours.fractions, expected.fractions)
    np.testing.assert_array_equal(ours.air_velocity_m_s, expected.air_velocity_m_s)


def test_compiled_search_places_drops_to_the_last_bit_far_and_late():
    """At 10,000 s and 10 km a drop is found in a box that ends exactly on it, but in none a rounding step smaller."""
    where = phases_of(displaced(10_000.0, (2.0, -1.5)), np.array([8_000.0, -6_000.0, 120.0]), PERIOD)
    distance = np.abs(place_drops(np.arange(CLASSES), 3, where).positions(PERIOD))
    for number in range(0, CLASSES, 2048):
        for smaller in (None, 0, 1, 2):
            half = distance[number].copy()
            if smaller is not None:
                half[smaller] = np.nextafter(half[smaller], 0)
            found = found_drops(CLASSES, 3, where, PERIOD, culling(yaw=0.0, half=half), in_view=False)
            np.testing.assert_array_equal(found, np.flatnonzero(np.all(distance <= half, axis=1)))
            assert (number in found) == (smaller is None)


def test_a_wrap_draws_the_later_axes_anew_but_no_earlier_one():
    """A drop that leaves through an x face keeps its height; one that falls through the floor gets a new x and y."""
    before, _ = positions_at(10.0, (0, 0, 0))
    sideways, _ = positions_at(10.0, (PERIOD[0], 0, 0))  # a whole period further: every drop wraps once in x
    assert np.allclose(sideways[:, 2], before[:, 2])
    assert np.allclose(sideways[:, 0] - PERIOD[0], before[:, 0])
    new_y = np.abs(sideways[:, 1] - before[:, 1])
    assert np.mean(new_y < 0.1) < 0.05
    below, _ = positions_at(10.0, (0, 0, -PERIOD[2]))
    assert np.allclose(below[:, 2] + PERIOD[2], before[:, 2])
    for axis in (0, 1):
        correlation = np.corrcoef(below[:, axis], before[:, axis])[0, 1]
        assert abs(correlation) < 5 / np.sqrt(len(before))


def test_a_motion_gives_the_offsets_of_its_displacement_to_the_bit():
    center = np.array([3.0, -2.0, 0.5])
    motion = DropMotion(Wind((1.3, -0.4), 2.0, 5), FALL)
    for moving in (motion, motion.changed(7.0, Wind((4.0, 0.0)), 2 * FALL), motion.without_drift()):
        ours = drop_phases(moving, 1234.5, center, PERIOD)
        expected = phases_of(displacement(moving, 1234.5), center, PERIOD)
        np.testing.assert_array_equal(ours.wraps, expected.wraps)
        np.testing.assert_array_equal(ours.fractions, expected.fractions)
