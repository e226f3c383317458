"""Fog: extinction without drops, alone and in rain, on all back ends (docs/physics/extinction.md)."""

import numpy as np
import pytest

from gsrain_engine.evaluation.lidar.sensor import SENSORS
from gsrain_engine.rain.settings import RainSettings, RegionBox, load_preset
from gsrain_engine.rain.simulation import RainSimulation
from gsrain_engine.render.cpu.renderer import CpuRenderer
from gsrain_engine.scene.geometry import srgb_to_linear

from .test_medium import AIRLIGHT, SKY, camera_at, directions, frame_of, wall


@pytest.mark.parametrize("visibility_m", [30.0, 200.0, 5000.0])
def test_5_percent_of_the_contrast_is_left_at_the_visibility(visibility_m):
    frame = frame_of(visibility_m=visibility_m)
    assert frame.count == 0 and not frame.is_clear and not frame.draws_drops
    kept = frame.medium.transmittance(visibility_m * directions())
    assert kept == pytest.approx(np.full(len(kept), 0.05), rel=1e-4)
    assert RainSimulation.start(frame.rain).state.visibility_m == pytest.approx(visibility_m)


@pytest.mark.parametrize("haze", ["medium", "gaussians", "none"])
def test_fog_adds_to_the_extinction_of_rain(haze):
    fog, rain, both = (
        RainSimulation.start(RainSettings(haze=haze, intensity_mm_h=intensity, visibility_m=visibility_m)).state
        for intensity, visibility_m in ((0.0, 300.0), (25.0, None), (25.0, 300.0))
    )
    assert both.extinction_per_m == pytest.approx(fog.extinction_per_m + rain.extinction_per_m)
    assert both.fog_extinction_per_m == fog.extinction_per_m > 0 == rain.fog_extinction_per_m
    assert both.haze_gaussians == rain.haze_gaussians and fog.haze_gaussians == 0


def test_with_haze_of_another_kind_the_medium_is_fog_alone():
    rays = 80.0 * directions()
    alone = frame_of(visibility_m=100.0).medium.transmittance(rays)
    for haze in ("gaussians", "none"):
        both = frame_of(visibility_m=100.0, intensity_mm_h=50.0, haze=haze)
        assert both.medium.transmittance(rays) == pytest.approx(alone, rel=1e-5)
    rain = frame_of(intensity_mm_h=50.0).medium.transmittance(rays)
    both = frame_of(visibility_m=100.0, intensity_mm_h=50.0).medium.transmittance(rays)
    assert both == pytest.approx(alone * rain, rel=1e-4)


@pytest.mark.parametrize("model", ["physical", "paper"])
def test_a_wall_in_fog_keeps_its_share_of_contrast(model):
    camera, renderer, dark = camera_at(size=(24, 16), fov_deg=6.0), CpuRenderer(), 0.02
    frame = frame_of(camera, visibility_m=100.0, model=model)
    renderer.draw([wall(50.0, np.full(3, dark))], camera, frame)
    image = renderer.read().rgba[..., :3].astype(float)
    if model == "physical":
        image, ends = srgb_to_linear(image), (AIRLIGHT, dark)
    else:
        ends = np.array(SKY), 0.1521  # display value of 0.02
    contrast = (ends[0] - image) / (ends[0] - ends[1])
    assert contrast == pytest.approx(np.full(contrast.shape, np.sqrt(0.05)), rel=0.01)


def test_a_region_limits_fog():
    box = RegionBox(minimum_m=(-10.0, -50.0, -50.0), maximum_m=(20.0, 50.0, 50.0))
    medium = frame_of(visibility_m=100.0, haze_region=box).medium
    inside, behind = medium.transmittance(np.array([[0.0, 0, 10.0], [0.0, 0, 90.0]]))
    assert inside == pytest.approx(0.05**0.1, rel=1e-3) and behind == pytest.approx(0.05**0.2, rel=1e-3)


def test_lidar_has_the_beta_of_fog():
    state, sensor = RainSimulation.start(RainSettings(visibility_m=150.0)).state, SENSORS["64"]
    clear, foggy = (sensor.signal(np.array([75.0]), np.array([0.2]), each) for each in (0.0, state.extinction_per_m))
    assert foggy / clear == pytest.approx(0.05, rel=1e-6)  # there and back


def test_thick_fog_closes_the_sky():
    shares = [RainSimulation.start(RainSettings(visibility_m=each)).overcast_at(0.0) for each in (5e3, 1500.0, 900.0)]
    assert shares == [0.0, 0.5, 1.0]
    assert RainSimulation.start(RainSettings(visibility_m=100.0, wetness=0.0)).overcast_at(0.0) == 0
    assert RainSimulation.start(RainSettings(visibility_m=100.0)).wetness_at(0.0) == 0


def test_thick_fog_has_the_colors_under_clouds_without_being_rain():
    """Soaked colors are the only ones without the sun's shadows; roads stay dry for lidar and tires."""
    fog = [RainSimulation.start(RainSettings(visibility_m=each)) for each in (5e3, 1500.0, 300.0)]
    assert [each.soaked_share_at(0.0) for each in fog] == [0.0, 0.5, 1.0]
    assert [each.wetness_at(0.0) for each in fog] == [0.0, 0.0, 0.0]
    as_lit = RainSimulation.start(RainSettings(visibility_m=300.0, wetness=0.0))
    assert as_lit.soaked_share_at(0.0) == 0
    rainy = RainSimulation.start(RainSettings(visibility_m=1500.0, intensity_mm_h=8.5))
    assert rainy.soaked_share_at(0.0) == rainy.wetness_at(0.0) > 0.9


def test_without_fog_nothing_changes():
    rain = RainSettings(visibility_m=100.0)
    assert rain.without_rain == RainSettings() and rain.without_medium.visibility_m is None
    assert RainSimulation.start(rain).can_rain and not RainSimulation.start(RainSettings()).can_rain
    assert load_preset("paper").visibility_m is None


@pytest.mark.parametrize("visibility_m", [0.0, 9.9, 2e5, float("nan")])
def test_the_visibility_has_bounds(visibility_m):
    with pytest.raises(ValueError, match="visibility_m must be within 10..100000 m"):
        RainSettings(visibility_m=visibility_m)
