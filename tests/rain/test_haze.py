import numpy as np
import pytest

from gsrain_engine.rain.calibration import load_calibration
from gsrain_engine.rain.haze import LIFETIME_S, RAMP_M, make_haze
from gsrain_engine.rain.rain import Rain
from gsrain_engine.rain.rain_state import rain_state

ANCHOR = np.eye(4)
FAR_AWAY = np.array([-1000.0, 0, 0])


def haze(time_s=0.0, count=20_000, camera=FAR_AWAY, anchor=ANCHOR, **fields):
    return make_haze(Rain(intensity_mm_h=8.5, **fields), count, time_s, anchor, camera)


@pytest.mark.parametrize("reset", ["fade", "paper"])
@pytest.mark.parametrize("time_s", [0.0, 2.9, 1234.5])
def test_opacity_in_the_region_is_that_of_m_gaussians(reset, time_s):
    """Sum of opacities inside the region is M alpha_m at any moment: 20,000 of them count to 1 %."""
    rain = Rain(haze_reset=reset)
    made = haze(time_s, haze_reset=reset)
    inside = np.all((made.means >= rain.haze_region.minimum_m) & (made.means <= rain.haze_region.maximum_m), axis=1)
    assert made.opacities[inside].sum() == pytest.approx(20_000 * rain.haze_opacity, rel=0.03)


def test_haze_comes_and_goes_slowly_and_stays_where_it_is():
    before, after = haze(10.0), haze(10.0 + 1e-3)
    places = {tuple(p): o for p, o in zip(before.means, before.opacities, strict=True)}
    shared = [(places[tuple(p)], o) for p, o in zip(after.means, after.opacities, strict=True) if tuple(p) in places]
    assert len(shared) > 0.99 * len(before.means)
    changes = np.array([abs(a - b) for a, b in shared])
    assert changes.max() < 1.6e-3 * 0.05  # a smoothstep of 1 s is at most 1.5 / s steep


def test_a_life_later_everything_is_elsewhere():
    before, after = haze(10.0), haze(10.0 + LIFETIME_S)
    assert not {tuple(p) for p in before.means} & {tuple(p) for p in after.means}


def test_haze_does_not_move_with_the_car():
    moved = np.eye(4)
    moved[0, 3] = 5.0
    here, there = haze(3.0), haze(3.0, anchor=moved)
    places = {tuple(np.round(p, 3)) for p in here.means}
    kept = sum(tuple(np.round(p, 3)) in places for p in there.means)
    assert kept > 0.85 * len(there.means)  # 5 m of 73 are new


def test_the_paper_resets_every_frame():
    assert not {tuple(p) for p in haze(1.0, haze_reset="paper").means} & {
        tuple(p) for p in haze(1.04, haze_reset="paper").means
    }


def test_near_haze_leaves_room_for_streaks():
    made = haze(camera=np.zeros(3))
    assert np.linalg.norm(made.means, axis=1).min() > RAMP_M[0]


def haze_at(intensity_mm_h, **fields):
    """Haze of an intensity, M and beta as they follow from it."""
    state = rain_state(Rain(intensity_mm_h=intensity_mm_h), load_calibration("published"))
    return haze(count=state.haze_gaussians, **fields), state


@pytest.mark.parametrize(("intensity_mm_h", "relative"), [(1.2, 0.45), (8.5, 0.26), (12.0, 0.24)])
def test_haze_is_even(intensity_mm_h, relative):
    """Over 70 m of the region, optical depth varies by less than that share from ray to ray; its mean is beta L.

    M Gaussians of alpha_m would vary by sqrt(alpha_m / (2 beta L)): 1.0, 0.44 and 0.38.
    """
    depths = []
    for seed in range(4):
        made, state = haze_at(intensity_mm_h, seed=seed)
        across = np.stack(np.meshgrid(np.arange(-8.0, 8.1, 2), np.arange(0.0, 19, 2)), axis=-1).reshape(-1, 1, 2)
        distance2 = np.sum((across - made.means[:, 1:]) ** 2, axis=-1)
        depths.append(np.exp(-distance2 / (2 * 0.5**2)) @ made.opacities)
    mean = np.mean(depths)
    assert mean == pytest.approx(state.extinction_per_m * 70, rel=0.1)
    assert np.std(depths) < relative * mean


def test_more_rain_is_more_haze_gaussians():
    counts = [len(haze_at(intensity)[0].means) for intensity in (0.1, 1.2, 8.5, 12.0, 100.0)]
    assert counts == sorted(set(counts))


def test_a_number_that_a_person_set_is_drawn_as_it_is():
    made = haze(count=500, haze_count=500)
    assert made.opacities.max() == np.float32(0.05)
    assert len(made.means) < 1500  # with the margin around the region, and those that come and go
