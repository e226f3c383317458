"""Airlight behind the scene, on all back ends."""

from dataclasses import replace

import numpy as np

from gsrain_engine.rain.frame import RainCamera, SkyLight
from gsrain_engine.rain.settings import RainSettings
from gsrain_engine.rain.simulation import RainSimulation
from gsrain_engine.scene.camera import Camera, look_at


def test_gaps_in_the_ground_show_no_air_from_beyond_it(any_renderer):
    """Without anything drawn, rays that go down end at the floor, those that go up don't."""
    pose = look_at(np.array([0.0, 0, 2]), np.array([1.0, 0.3, 1.9]), np.array([0.0, 0, 1]))
    camera = Camera.from_fov(60, 40, 50.0, pose)
    rain = RainSimulation.start(RainSettings(intensity_mm_h=50.0, streaks=False))
    view = RainCamera(camera, np.eye(4), np.zeros(3), floor_m=0.5)
    frame = rain.frame(0.0, view, SkyLight.uniform((0.8, 0.8, 0.8)))
    any_renderer.draw([], camera, frame)
    alpha = any_renderer.read().rgba[..., 3]
    x, y = np.meshgrid((np.arange(60) + 0.5 - camera.cx) / camera.fx, (np.arange(40) + 0.5 - camera.cy) / camera.fy)
    rays = np.stack([x, y, np.ones_like(x)], axis=-1) @ camera.world_to_camera[:3, :3]
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    length = np.where(rays[..., 2] < 0, 1.5 / np.maximum(-rays[..., 2], 1e-9), np.inf)
    np.testing.assert_allclose(alpha, 1 - np.exp(-frame.extinction_per_m * length), atol=2e-3)
    assert alpha[-1].max() < 0.1 < 0.99 < alpha[0].min()
    any_renderer.draw([], camera, replace(frame, view=replace(view, floor_m=None)))
    np.testing.assert_allclose(any_renderer.read().rgba[..., 3], 1, atol=1e-3)
