import numpy as np
import pytest

from gsrain_engine.rain.calibration import load_calibration
from gsrain_engine.rain.haze import make_haze
from gsrain_engine.rain.properties import rain_properties
from gsrain_engine.rain.settings import RainSettings

ANCHOR = np.eye(4)
FAR_AWAY = np.array([-1000.0, 0, 0])


def haze(time_s=0.0, count=20_000, camera=FAR_AWAY, anchor=ANCHOR, **fields):
    return make_haze(RainSettings(intensity_mm_h=8.5, **fields), count, time_s, anchor, camera, np.ones(3))


@pytest.mark.parametrize("model", ["physical", "paper"])
@pytest.mark.parametrize("time_s", [0.0, 2.9, 1234.5])
def test_haze_fills_the_region_of_a_car_that_has_turned_and_driven_on(model, time_s):
    """In the car's own axes all of it is within 3 sigma of the region; the sum of opacities is M alpha_m.

    Each eighth of the region holds its eighth.
    """
    rain, anchor = RainSettings(model=model), np.eye(4)
    cosine, sine = np.cos(0.7), np.sin(0.7)
    anchor[:2, :2], anchor[:3, 3] = [[cosine, -sine], [sine, cosine]], (300.0, -20.0, 2.0)
    made = haze(time_s, anchor=anchor, model=model)
    local = (made.means - anchor[:3, 3]) @ anchor[:3, :3] - rain.haze_box.center_m
    half = np.array(rain.haze_box.size_m) / 2
    assert np.all(np.abs(local) <= half + 3 * rain.haze_sigma_m + 1e-3)
    inside = np.all(np.abs(local) <= half, axis=1)
    eighths = np.bincount((local[inside] > 0) @ [1, 2, 4], made.opacities[inside], minlength=8)
    assert eighths == pytest.approx(np.full(8, 20_000 * rain.haze_opacity / 8), rel=0.1)
    assert eighths.sum() == pytest.approx(20_000 * rain.haze_opacity, rel=0.03)
    reach = half + 3 * rain.haze_sigma_m
    assert np.all(np.abs(local).max(axis=0) > reach - 0.1)  # all the way to each face


@pytest.mark.parametrize(("count", "shares"), [(16_000, 1), (1000, 4), (160, 10), (10, 16)])
def test_few_gaussians_are_split_up_into_the_geometric_mean_with_16000(count, shares):
    made = haze(count=count)
    assert made.opacities.max() == pytest.approx(RainSettings().haze_opacity / shares, rel=1e-3)
    rain = RainSettings()
    inside = np.all(np.abs(made.means - rain.haze_box.center_m) <= np.array(rain.haze_box.size_m) / 2, axis=1)
    assert made.opacities[inside].sum() == pytest.approx(count * rain.haze_opacity, rel=0.5)
    assert len(haze(count=0).means) == 0
    assert haze(count=count, haze_count=count).opacities.max() == np.float32(rain.haze_opacity)  # as a person set it


def test_haze_begins_3_m_from_the_camera_and_is_whole_at_5_m():
    camera = np.array([10.0, 2.0, 1.0])
    made = haze(1.0, camera=camera, count=60_000, model="paper")
    x = np.clip((np.linalg.norm(made.means - camera, axis=1) - 3) / 2, 0, 1)
    assert made.opacities == pytest.approx(RainSettings().haze_opacity * x**2 * (3 - 2 * x), abs=1e-6)
    assert x.min() < 0.3 and np.sum(x < 1) > 20


def test_a_haze_gaussian_comes_in_a_second_stays_two_and_goes_in_a_second():
    lives = {}
    for tick in range(1, 100):
        made = haze(0.1 * tick, haze_count=80, count=80)
        for place, opacity in zip(map(tuple, made.means), made.opacities, strict=True):
            lives.setdefault(place, {})[tick] = float(opacity)
    whole = [life for life in lives.values() if min(life) > 1 and max(life) < 99]
    assert len(whole) > 100
    for life in whole:
        values = np.array([life[tick] for tick in range(min(life), max(life) + 1)]) / max(life.values())
        assert len(values) in (39, 40) and 19 <= np.sum(values > 1 - 1e-4) <= 22
        assert values == pytest.approx(values[::-1], abs=0.16)  # a smoothstep there and back
        assert np.all(np.diff(values[:10]) > 0)


@pytest.mark.parametrize(("model", "share"), [("physical", 0.85), ("paper", 0.0)])
def test_haze_stays_in_its_places_while_the_car_drives_on_but_the_paper_resets_every_frame(model, share):
    """5 m of 73 are new to a car that has driven on."""
    moved = np.eye(4)
    moved[0, 3] = 5.0 if model == "physical" else 0.0
    here, there = haze(3.0, model=model), haze(3.04 if model == "paper" else 3.0, anchor=moved, model=model)
    places = {tuple(np.round(p, 3)) for p in here.means}
    common = sum(tuple(np.round(p, 3)) in places for p in there.means)
    assert share * len(there.means) <= common and (common > 0) == (share > 0)


def haze_at(intensity_mm_h, **fields):
    """Haze of an intensity, M and beta as they follow from it."""
    state = rain_properties(
        RainSettings(intensity_mm_h=intensity_mm_h, haze="gaussians"), load_calibration("published")
    )
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
