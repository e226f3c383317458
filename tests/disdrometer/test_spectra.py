from dataclasses import replace

import numpy as np
import pytest

from gsrain_engine.disdrometer.spectra import DropSpectra


def spectra(records: int = 2) -> DropSpectra:
    counts = np.zeros((records, 2, 2))
    counts[0, 1, 0] = 60
    return DropSpectra(
        instrument="test",
        times=np.datetime64("2018-10-29T00:00:00", "ms") + 60_000 * np.arange(records).astype("timedelta64[ms]"),
        seconds=np.full(records, 60.0),
        diameter_edges_mm=np.array([0.5, 1.5, 2.5]),
        velocity_edges_m_s=np.array([0.0, 5.0, 10.0]),
        counts=counts,
        area_m2=np.array([0.006, 0.005]),
        reported_mm_h=np.full(records, np.nan),
    )


def test_rate_is_the_water_over_area_and_time():
    # One drop of 2 mm a second on 50 cm^2: 4.18879 mm^3 / 5000 mm^2 a second, 3600 times an hour.
    np.testing.assert_allclose(spectra().rate_mm_h, [np.pi / 6 * 8 / 5000 * 3600, 0])


def test_records_are_picked_and_joined():
    both = spectra()
    again = DropSpectra.concatenate([both[:1], both[np.array([False, True])]])
    assert len(again) == 2
    np.testing.assert_array_equal(again.counts, both.counts)
    np.testing.assert_array_equal(again.times, both.times)
    with pytest.raises(ValueError, match="differ in area_m2"):
        DropSpectra.concatenate([both, replace(both, area_m2=2 * both.area_m2)])


def test_velocity_classes_need_bounds():
    with pytest.raises(ValueError, match="without their bounds"):
        replace(spectra(), velocity_edges_m_s=None)
