"""Impacts on the ground: as many as the flux of the rain brings, the same ones from any side and in stronger rain."""

import numpy as np
import pytest

from gsrain_engine.rain.keyframes import RainKeyframe, RainKeyframes
from gsrain_engine.rain.settings import RainSettings
from gsrain_engine.rain.simulation import RainSimulation
from gsrain_engine.water.impacts import CELL_M, GroundImpacts, cells_around

CELLS = cells_around(np.array([-3.0, 2.0]), np.array([-0.01, 3.99]))


def impacts(rain=8.5, seed=0, weather=None, **changes):
    return GroundImpacts(RainSimulation.start(RainSettings(intensity_mm_h=rain, seed=seed, **changes), weather=weather))


@pytest.mark.parametrize("rain", [1.0, 8.5, 50.0])
def test_drops_land_as_often_as_their_flux_says(rain):
    """Over 20 seeds: numbers of all and of splashing sizes within 3 sigma, and the mean of them; mass is the rain's."""
    area, seconds = len(CELLS) * CELL_M**2, 0.4
    away, water_mm = [], []
    for seed in range(20):
        of = impacts(rain, seed)
        flux, found = of.flux_at(10.0), of.land(CELLS, 10.3, 10.3 + seconds)
        for diameter in (0.0, 1.3):
            expected = area * seconds * (flux.larger_than(diameter) if diameter else flux.per_m2_s)
            away.append((np.sum(found.diameters_mm > diameter) - expected) / np.sqrt(expected))
        water_mm.append(np.sum(np.pi / 6 * found.diameters_mm**3) * 1e-6 / area)
    # 40 draws: one in 10 such sets has one beyond 3 sigma by chance, these have none
    assert np.abs(away).max() < 3 and abs(np.mean(away)) < 3 / np.sqrt(len(away))
    assert np.mean(water_mm) == pytest.approx(rain * seconds / 3600, rel=0.05)


def test_the_flux_of_a_rain_is_that_of_the_drops_in_the_air():
    """N E[V] of the field's own classes, and the energy that they bring."""
    rainfall = RainSimulation.start(RainSettings(intensity_mm_h=8.5))
    flux = GroundImpacts(rainfall).flux_at(0.0)
    speeds, diameters = rainfall.motion.fall_speed_m_s, rainfall.diameters_mm
    assert flux.per_m2_s == pytest.approx(rainfall.state.density_m3 * speeds.mean(), rel=1e-3)
    joules = 998 * np.pi / 12 * (1e-3 * diameters) ** 3 * speeds**2
    assert flux.power_w_m2[-1] == pytest.approx(rainfall.state.density_m3 * (speeds * joules).mean(), rel=2e-3)


def test_an_impact_is_a_function_of_seed_place_and_time():
    of = impacts(seed=7)
    whole = of.land(CELLS, 3.0, 4.0)
    part = of.land(CELLS[5:8], 3.4, 3.6)
    low, high = CELLS[5:8].min(axis=0) * CELL_M, (CELLS[5:8].max(axis=0) + 1) * CELL_M
    inside = ((whole.places_m >= low) & (whole.places_m < high)).all(axis=1)
    inside &= (whole.times_s >= 3.4) & (whole.times_s < 3.6)
    cells = {tuple(cell) for cell in CELLS[5:8].tolist()}
    inside &= [tuple(cell) in cells for cell in np.floor(whole.places_m / CELL_M).astype(int).tolist()]
    assert len(part.times_s) > 50
    for a, b in zip(whole.only(inside), part, strict=True):
        np.testing.assert_array_equal(a, b)
    assert not np.isin(impacts(seed=8).land(CELLS, 3.0, 4.0).hashes, whole.hashes[:50]).any()


def test_the_largest_come_first_and_stay_in_stronger_rain():
    of = impacts()
    whole, largest = of.land(CELLS, 0.0, 0.5), of.land(CELLS, 0.0, 0.5, 100.0)
    kept = whole.only(whole.larger_per_m2_s < 100.0)
    np.testing.assert_array_equal(kept.hashes, largest.hashes)
    np.testing.assert_allclose(kept.diameters_mm, largest.diameters_mm, rtol=2e-3)
    assert largest.diameters_mm.min() > 1.5 > np.median(whole.diameters_mm)
    more = impacts(9.0).land(CELLS, 0.0, 0.5)
    assert np.isin(whole.hashes, more.hashes).all() and len(more.hashes) > len(whole.hashes)


def test_keyframes_change_the_flux_and_a_dry_hour_has_no_impacts():
    keys = tuple(RainKeyframe(time_s=t, intensity_mm_h=r) for t, r in ((0, 0.0), (10, 0.0), (20, 40.0)))
    of = impacts(weather=RainKeyframes(keys=keys))
    assert len(of.land(CELLS, 5.0, 6.0).times_s) == 0
    counts = [len(of.land(CELLS, t, t + 0.5).times_s) for t in (12.0, 15.0, 25.0)]
    steady = impacts(40.0).land(CELLS, 25.0, 25.5)
    assert 0 < counts[0] < counts[1] < counts[2] == len(steady.times_s)
    assert impacts(0.0).flux_at(0.0).per_m2_s == 0 == len(impacts(0.0).land(CELLS, 0.0, 1.0).times_s)
    assert impacts(wind_speed_m_s=20.0).flux_at(0.0) is impacts().flux_at(0.0)  # the same drops, more aslant
