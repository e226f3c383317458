"""All back ends draw the light of lamps that the CPU's does."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from gsrain_engine.rain.frame import SkyLight
from gsrain_engine.rain.settings import RegionBox
from gsrain_engine.rain.simulation import RainSimulation
from gsrain_engine.render.cpu.renderer import CpuRenderer
from gsrain_engine.render.draw import draw
from gsrain_engine.render.frame_input import FrameInput
from gsrain_engine.scene.geometry import srgb_to_linear
from gsrain_engine.scene.lamps import Lamp
from render.test_backends_agree import raining, small_scene, small_shot

HEADLIGHTS = tuple(
    Lamp(position=(1.0, y, 1.2), direction=(1.0, 0, -0.05), intensity_m2=60.0, inner_deg=15, outer_deg=40)
    for y in (-0.7, 0.7)
)
BULBS = (
    Lamp(position=(12.0, 2.0, 4.0), color=(1.0, 0.7, 0.3), intensity_m2=20.0),
    Lamp(position=(25.0, -4.0, 1.0), direction=(-1.0, 0, 0), intensity_m2=90.0, inner_deg=20, outer_deg=45),
    Lamp(position=(-3.0, 0.0, 3.0), intensity_m2=5.0),
)
NIGHT = SkyLight.uniform((0.05, 0.05, 0.06))


def light_of(renderer, lamps, shot, **changes):
    """Linear light of a picture with lamps less that without, and that without."""
    scene, images = small_scene(), []
    for each in (lamps, ()):
        rainfall = RainSimulation.start(raining(**changes))
        draw(renderer, FrameInput.of(replace(scene, lamps=each), rainfall, NIGHT, shot))
        images.append(srgb_to_linear(renderer.read().over().astype(float)))
    return images[0] - images[1], images[1]


@pytest.fixture(scope="module")
def on_the_cpu():
    """Light by size and settings, computed once for all back ends."""
    return cache(lambda width, height, **changes: light_of(
        CpuRenderer(), HEADLIGHTS + BULBS, small_shot(width, height), **changes
    ))  # fmt: skip


@pytest.mark.parametrize("kind", ["opengl", "opengl-tiles"])
@pytest.mark.parametrize(
    "changes",
    [
        {"intensity_mm_h": 25.0},
        {"intensity_mm_h": 80.0, "streaks": False},
        {"intensity_mm_h": 80.0, "haze": "none"},
        {"intensity_mm_h": 25.0, "haze": "gaussians"},
        {"intensity_mm_h": 0.0, "visibility_m": 60.0},
        {"intensity_mm_h": 50.0, "haze_region": RegionBox(minimum_m=(-2, -9, -1), maximum_m=(18, 9, 7))},
    ],
)
def test_light_of_lamps_agrees(open_kind, on_the_cpu, kind, changes):
    size = 240, 150
    ours, clear = light_of(open_kind(kind), HEADLIGHTS + BULBS, small_shot(*size), **changes)
    expected, _ = on_the_cpu(*size, **changes)
    assert np.linalg.norm(expected) > 1e-3 * np.linalg.norm(clear)
    assert np.linalg.norm(ours - expected) <= 0.05 * np.linalg.norm(expected)


@pytest.mark.parametrize("kind", ["cpu", "opengl", "opengl-tiles"])
def test_light_in_display_values_has_no_lamps(open_kind, kind):
    shot = small_shot(64, 40)
    light, _ = light_of(open_kind(kind), BULBS, shot, model="paper")
    assert np.all(light == 0)


@pytest.mark.parametrize("kind", ["cpu", "opengl", "opengl-tiles"])
def test_a_lamp_without_intensity_adds_nothing(open_kind, kind):
    light, clear = light_of(open_kind(kind), (Lamp(position=(12.0, 2.0, 4.0), intensity_m2=0.0),), small_shot(64, 40))
    assert clear.max() > 0.05
    assert np.abs(light).max() < 1e-5
