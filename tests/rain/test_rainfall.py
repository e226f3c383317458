import msgspec
import numpy as np
import pytest

from given_rain import gaussians_of
from gsrain_engine.rain.frame import RainCamera
from gsrain_engine.rain.settings import RainSettings, load_preset
from gsrain_engine.rain.simulation import RainSimulation, mean_linear_color
from gsrain_engine.scene.camera import Camera, look_at

UP = np.array([0.0, 0, 1])


def view(position=(0.0, 0, 1.5), heading=0.0, velocity=(0.0, 0, 0), anchor_at=None):
    eye = np.array(position)
    pose = look_at(eye, eye + [np.cos(heading), np.sin(heading), 0], UP)
    anchor = np.eye(4)
    anchor[:2, :2] = [[np.cos(heading), -np.sin(heading)], [np.sin(heading), np.cos(heading)]]
    anchor[:3, 3] = eye if anchor_at is None else anchor_at
    return RainCamera(Camera.from_fov(960, 640, 36.0, pose), anchor, np.array(velocity))


def test_same_seed_and_time_same_bytes():
    def means(**changes):
        rain = msgspec.structs.replace(load_preset("8.5"), **changes)
        return gaussians_of(RainSimulation.start(rain).frame(4.2, view())).means.tobytes()

    assert means() == means() != means(seed=1)
    assert means(intensity_mm_h=0.0) == b""


def test_paper_preset_has_exactly_its_drops_in_the_region():
    rainfall = RainSimulation.start(load_preset("paper"))
    assert drops_in_region(rainfall, 0.7, view()) == 257_040
    assert drops_in_region(rainfall, 31.0, view((12.0, 3, 2), 1.0)) == 257_040


def test_gusts_integrate_to_their_displacement():
    rainfall = RainSimulation.start(RainSettings(intensity_mm_h=5.0, wind_m_s=(3.0, -1.0), gust_m_s=2.0, seed=5))
    wind = rainfall.motion.wind
    t = np.linspace(0, 20, 20_001)
    velocity = np.stack([wind.velocity(x) for x in t])
    integral = np.sum((velocity[1:] + velocity[:-1]) / 2 * np.diff(t)[:, None], axis=0)
    assert wind.displacement(20.0) == pytest.approx(integral, rel=1e-5)


def test_cameras_of_a_rig_see_the_same_drops():
    """Two cameras on one anchor: streaks that both draw stand at the same places."""
    rainfall = RainSimulation.start(msgspec.structs.replace(load_preset("8.5"), haze=False))
    left, right = (rainfall.frame(2.0, view((0.0, y, 1.5), anchor_at=(0.0, 0, 1.5))) for y in (0.05, -0.05))
    places = [{tuple(np.round(p, 4)) for p in gaussians_of(each).means} for each in (left, right)]
    assert len(places[0] & places[1]) > 0.5 * len(places[0])


def test_reduced_preview_keeps_the_same_drops():
    rainfall = RainSimulation.start(msgspec.structs.replace(load_preset("8.5"), haze=False))
    full = view()
    half = RainCamera(full.camera.resized(480, 320), full.anchor_to_world, full.velocity_m_s, focal_px=full.camera.fx)
    a, b = rainfall.frame(1.0, full), rainfall.frame(1.0, half)
    assert np.array_equal(a.visible_drops().numbers, b.visible_drops().numbers)


def test_sky_is_averaged_in_linear_light():
    color = mean_linear_color(np.array([[0.0, 0.0, 0.0], [1.0, 1.0, 1.0]]))
    assert color == pytest.approx((0.7354,) * 3, abs=1e-3)  # enc(1/2)


def drops_in_region(rainfall, time_s, view):
    return len(rainfall.frame(time_s, view).visible_drops(in_view=False).numbers)
