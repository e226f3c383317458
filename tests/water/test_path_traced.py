"""Water against Mitsuba 3: a drop on glass against its dielectric, a mirrored road against its rough dielectric.

The stored pictures are those of `tests/oracles/make_references.py`.
"""

from pathlib import Path

import numpy as np
import pytest

from gsrain_engine.scene.camera import Camera, look_at
from gsrain_engine.scene.geometry import linear_to_srgb
from gsrain_engine.scene.lamps import Lamp, lit_lamps
from gsrain_engine.scene.sensor import ThinLens
from gsrain_engine.water.glass_drops import RADIUS, SHAPE
from gsrain_engine.water.mirror import make_mirror, mirrored_camera
from gsrain_engine.water.pane import pane_of
from gsrain_engine.water.refraction import GlassView, WetGlass, wide_camera
from oracles import water_scenes as scenes

REFERENCES = Path(__file__).parents[1] / "oracles"
CHANNEL = {"smooth": 1, "rough": 0}


def decibels(difference):
    """Peak signal-to-noise ratio of linear light, white being 1."""
    return -10 * np.log10(np.mean(difference**2))


def test_a_drop_on_glass_refracts_as_a_path_tracers_dielectric():
    side, window = scenes.DROP_PX, scenes.DROP_WINDOW_PX
    f = side / 2 / scenes.DROP_TANGENT
    camera = Camera(side, side, f, f, side / 2, side / 2)
    wide = wide_camera(camera)
    y, x = np.mgrid[: wide.height, : wide.width] + 0.5
    x, y = (x - wide.cx) / wide.fx, (y - wide.cy) / wide.fy
    behind = np.rint(255 * linear_to_srgb(scenes.surroundings(x, y, np.ones_like(x)))).astype(np.uint8)
    drop = np.zeros((1, 10))
    drop[0, [RADIUS, SHAPE]] = scenes.DROP_RADIUS_M, 0.5
    pane = pane_of("lens", camera, scenes.PANE_M)
    assert pane is not None
    glass = WetGlass(pane, drop, np.zeros((1, 1), np.float32), 0.002, scenes.CONTACT_DEG, None, 0.0, 1)
    layer, cell_px, margin = GlassView(glass, camera, ThinLens(), behind).layer(np.zeros((side, side, 3), np.uint8))
    assert cell_px == 1
    first = (side - window) // 2 + margin
    light = layer[first : first + window, first : first + window, :3]
    y, x = np.mgrid[:window, :window] + 0.5 - window / 2
    disk = np.hypot(x, y) / f * scenes.PANE_M < 0.97 * scenes.DROP_RADIUS_M
    traced = np.load(REFERENCES / "drop.npz")["drop"].astype(np.float64)
    assert decibels((light - traced)[disk]) > 38
    assert decibels((light[::-1] - traced)[disk]) < 25  # it is upside down, and that matters


def road_camera():
    width, height = scenes.ROAD_PX
    f, eye = width / 2 / scenes.ROAD_TANGENT, np.array(scenes.EYE_M)
    pose = look_at(eye, eye + (1.0, 0.0, -scenes.DOWN), np.array([0.0, 0.0, 1.0]))
    return Camera(width, height, f, f, width / 2, height / 2, pose)


def rays(camera):
    y, x = np.mgrid[: camera.height, : camera.width] + 0.5
    local = np.stack([(x - camera.cx) / camera.fx, (y - camera.cy) / camera.fy, np.ones_like(x)], axis=-1)
    return local.reshape(-1, 3) @ camera.camera_to_world[:3, :3].T


@pytest.mark.parametrize("smoothness", CHANNEL)
def test_a_wet_road_mirrors_boxes_as_a_path_tracers_rough_dielectric(smoothness):
    camera = road_camera()
    below = mirrored_camera(camera, 0.0)
    light, depth = scenes.boxes_hit(below.position, rays(below))
    size = below.height, below.width
    mirror = make_mirror(
        light.reshape(*size, 3).astype(np.float32), depth.reshape(size).astype(np.float32), camera, 0.0, 1.0
    )
    film = np.zeros((camera.height, camera.width, 2), np.float32)
    film[..., CHANNEL[smoothness]] = 1
    toward = rays(camera)
    _, first_box = scenes.boxes_hit(camera.position, toward)
    to_road = np.where(toward[:, 2] < 0, camera.position[2] / np.maximum(-toward[:, 2], 1e-9), np.inf)
    road = (to_road < np.where(first_box > 0, first_box, np.inf)).reshape(film.shape[:2])
    assert 0.3 < road.mean() < 0.7
    traced = np.load(REFERENCES / "road.npz")[smoothness].astype(np.float64)
    assert decibels((mirror.reflected(film) - traced)[road]) > 37


@pytest.mark.parametrize("smoothness", CHANNEL)
@pytest.mark.parametrize("bulb", scenes.BULBS)
def test_a_wet_road_mirrors_lamps_where_and_as_brightly_as_a_path_tracer(smoothness, bulb):
    camera = road_camera()
    below = mirrored_camera(camera, 0.0)
    dark = np.zeros((below.height, below.width, 3), np.float32)
    lamps = lit_lamps([(Lamp(position=each.center, intensity_m2=each.intensity), np.eye(4)) for each in scenes.BULBS])
    mirror = make_mirror(dark, dark[..., 0], camera, 0.0, 1.0, lamps=lamps)
    film = np.zeros((camera.height, camera.width, 2), np.float32)
    film[..., CHANNEL[smoothness]] = 1
    own = mirror.reflected(film)[..., 1].astype(np.float64)
    traced = np.load(REFERENCES / "road.npz")[f"{smoothness} bulbs"][..., 1].astype(np.float64)
    x, _, z = (camera.world_to_camera @ (*bulb.center[:2], -bulb.center[2], 1.0))[:3]
    column = round(camera.fx * x / z + camera.cx)
    part = np.s_[70:, column - 25 : column + 25]  # below what is visible of the lamps themselves

    def center(light):
        rows, columns = np.indices(light.shape)
        return np.array([(light * rows).sum(), (light * columns).sum()]) / light.sum()

    np.testing.assert_allclose(center(own[part]), center(traced[part]), atol=2)
    assert own[part].sum() == pytest.approx(traced[part].sum(), rel=0.1)
