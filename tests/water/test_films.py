"""Films and dips: balance of water, steady rain, drying, and depths that are functions of time and place alone."""

import numpy as np
import pytest
import scipy

from gsrain_engine.rain.keyframes import RainKeyframe, RainKeyframes, shower_keyframes
from gsrain_engine.rain.settings import RainSettings
from gsrain_engine.rain.simulation import RainSimulation
from gsrain_engine.rain.wetness import water_depth_mm
from gsrain_engine.scene.ground_water import GroundWater
from gsrain_engine.water.films import CATCHMENT, DIP_MM, WaterFilms, drainage_mm_h, evaporation_mm_h

CELLS_M = 0.5


def ground(dips=0.1):
    """Map of 10 x 10 m with a part in dips."""
    cover = np.zeros((20, 20, 2), np.uint8)
    cover[:, : round(20 * dips), 1] = 255
    return GroundWater((0.0, 0.0), CELLS_M, cover)


def films(*keys, water=None, between="linear"):
    weather = RainKeyframes(keys=tuple(RainKeyframe(time_s=t, intensity_mm_h=r) for t, r in keys), between=between)
    return WaterFilms.of(RainSimulation.start(RainSettings(), weather=weather), ground() if water is None else water)


def stored_mm(of, time_s):
    """Mean depth over the map."""
    centers = np.stack(np.meshgrid(*(np.arange(20) * CELLS_M + CELLS_M / 2,) * 2), axis=-1).reshape(-1, 2)
    return of.depth_mm(centers, time_s).mean()


@pytest.mark.parametrize("dips", [0.1, 0.5])
def test_what_falls_is_stored_or_drains_or_dries(dips):
    """Over a storm and the hours after it, from fluxes at 6,000 moments."""
    keys = ((0, 0.0), (600, 25.0), (1500, 40.0), (1800, 2.0), (3000, 0.4), (3600, 0.0), (36000, 0.0))
    of = films(*keys, water=ground(dips))
    run_in = min(CATCHMENT, (1 - dips) / dips)
    times = np.unique(np.concatenate([np.linspace(0, 4000, 5000), np.linspace(4000, 40000, 1000)]))
    rows = []
    for t in times:
        rain, now = float(of.intensity.at(t)[0]), of.at(t)
        dries, drains = evaporation_mm_h(rain), drainage_mm_h(now.film_mm)
        is_full = now.dip_mm >= DIP_MM
        over = max(rain - dries, 0) + run_in * drains if is_full else 0.0
        from_film, from_dip = (dries if depth > 1e-6 else min(dries, rain) for depth in now)
        out = (1 - dips) * (drains + from_film) + dips * (over + from_dip - run_in * drains)
        rows.append((rain, out))
    fell, left = (scipy.integrate.trapezoid(np.array(each), times) / 3600 for each in zip(*rows, strict=True))
    held = stored_mm(of, times[-1])
    assert fell > 10 and held > 0
    assert abs(fell - left - held) < 0.01 * fell


@pytest.mark.parametrize(("dips", "run_in"), [(0.1, 3.0), (0.5, 1.0)])
def test_dips_fill_with_rain_and_what_three_times_their_area_drains(dips, run_in):
    of = films((0, 0.0), (1, 20.0), (7200, 20.0), water=ground(dips))
    before, now, after = (of.at(t) for t in (119.0, 120.0, 121.0))
    filling_mm_h = (after.dip_mm - before.dip_mm) / 2 * 3600
    assert now.dip_mm < DIP_MM and drainage_mm_h(now.film_mm) > 1
    assert filling_mm_h == pytest.approx(20 - evaporation_mm_h(20.0) + run_in * drainage_mm_h(now.film_mm), rel=0.02)


def test_steady_rain_has_the_depth_of_the_wet_look_and_full_dips():
    rates = 1.0, 8.5, 60.0
    for rate in rates:
        steady = WaterFilms.of(RainSimulation.start(RainSettings(intensity_mm_h=rate)), ground()).at(5.0)
        assert steady == (water_depth_mm(rate), DIP_MM) and steady.filled == 1
        long = films((0, 0.0), (1, rate)).at(7200.0)
        assert long == pytest.approx(steady, rel=0.01)
    assert films((0, 0.2)).at(1e4) == (0, 0)  # dries where it falls


def test_a_film_drains_in_minutes_and_dips_dry_in_hours():
    of = films((0, 0.0), (60, 20.0), (3600, 20.0), (3601, 0.0))
    wet, soon, later, dry = (of.at(t) for t in (3600, 3600 + 600, 3 * 3600, 24 * 3600))
    assert soon.film_mm < 0.4 * wet.film_mm and later.film_mm == 0
    assert wet.dip_mm == DIP_MM and 0.7 * DIP_MM < later.dip_mm < 0.9 * DIP_MM
    assert dry == (0, 0)
    assert 0 < films((0, 0.0), (60, 20.0)).at(120.0).filled < 1


def test_a_depth_is_a_function_of_time_and_place_alone():
    times = np.linspace(-5, 90, 24)
    shower, water = RainSimulation.start(RainSettings(), weather=shower_keyframes()), ground()
    forth = [WaterFilms.of(shower, water).at(t) for t in times]
    alone = [WaterFilms(shower.weather.curves["intensity_mm_h"], water).at(t) for t in times[::-1]]
    assert forth == alone[::-1]
    assert max(abs(np.diff([each.film_mm for each in forth]))) < 0.05
    film, dip = forth[12]
    points = np.array([[0.2, 5.0], [5.0, 5.0], [-9.0, 5.0]])
    assert WaterFilms.of(shower, water).depth_mm(points, times[12]).tolist() == [dip, film, film]
    assert WaterFilms.of(shower).depth_mm(points, times[12]).tolist() == pytest.approx([film] * 3, rel=1e-9)
