"""Records become minutes; drops counted become drops in the air."""

import numpy as np
import pytest

from gsrain_engine.disdrometer.fit_models import sum_minutes
from gsrain_engine.disdrometer.spectra import DropSpectra
from gsrain_engine.rain.calibration import atlas_velocity


def spectra(times, seconds, counts, velocity_edges=(0.0, 2.0, 6.0)):
    return DropSpectra(
        instrument="test",
        times=np.array(times, "datetime64[ms]"),
        seconds=np.array(seconds, np.float64),
        diameter_edges_mm=np.array([0.5, 1.5, 2.5]),
        velocity_edges_m_s=None if velocity_edges is None else np.array(velocity_edges),
        counts=np.array(counts, np.float64),
        area_m2=np.array([0.005, 0.004]),
        reported_mm_h=np.array([6.0, 12.0, np.nan][: len(seconds)]),
    )


THREE = [[[1, 2], [0, 4]], [[3, 0], [0, 0]], [[0, 0], [0, 8]]]


def test_records_of_a_minute_are_summed():
    """A record that ends at 10:01:00 belongs to the minute from 10:00."""
    given = spectra(["2024-05-01T10:00:20", "2024-05-01T10:01:00", "2024-05-01T10:01:30"], [20, 40, 30], THREE)
    minutes = sum_minutes(given)
    assert minutes.seconds.tolist() == [60, 30]
    assert minutes.records.tolist() == [2, 1]
    assert minutes.drops.tolist() == [[6, 4], [0, 8]]
    assert minutes.density_seconds[0] == pytest.approx([(4 / 1 + 2 / 4) / 0.005, 4 / 4 / 0.004])
    assert minutes.speed_sum[0] == pytest.approx([4 * 1 + 2 * 4, 4 * 4])
    assert minutes.rate_mm_h[0] == pytest.approx((20 * given.rate_mm_h[0] + 40 * given.rate_mm_h[1]) / 60)
    assert minutes.reported_mm_h[0] == pytest.approx((20 * 6 + 40 * 12) / 60)
    assert np.isnan(minutes.reported_mm_h[1])


def test_records_without_a_time_stand_alone():
    minutes = sum_minutes(spectra(["NaT", "NaT", "2024-05-01T10:00:30"], [30, 30, 30], THREE))
    assert minutes.records.tolist() == [1, 1, 1]
    assert sorted(minutes.drops.sum(axis=1)) == [3, 7, 8]


def test_without_measured_speeds_drops_fall_as_atlas_says():
    counts = np.array([[[5.0], [0.0]]])
    minutes = sum_minutes(spectra(["NaT"], [60], counts, velocity_edges=None))
    assert minutes.density_seconds[0, 0] == pytest.approx(5 / (0.005 * float(atlas_velocity(np.array([1.0]))[0])))
