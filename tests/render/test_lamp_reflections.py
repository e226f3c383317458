"""Reflections of lamps in wet ground: their place in the picture, their length, and headlights' pools on dry ground."""

import numpy as np
import pytest

from gsrain_engine.rain.simulation import OVERCAST
from gsrain_engine.render.cpu.renderer import CpuRenderer
from gsrain_engine.render.draw import draw
from gsrain_engine.render.frame_input import FrameInput
from gsrain_engine.render.passes.lamp_pools import lamp_reflections
from gsrain_engine.render.view import RenderView
from gsrain_engine.scene.camera import Camera, look_at
from gsrain_engine.scene.gaussians import Gaussians
from gsrain_engine.scene.geometry import srgb_to_linear
from gsrain_engine.scene.lamps import Lamp, lit_lamps
from gsrain_engine.scene.scene import Layer, Scene

NONE = lit_lamps([])
EYE = np.array([0.0, 0.0, 1.5])


def camera():
    pose = look_at(EYE, EYE + [10.0, 0, -0.6], np.array([0.0, 0, 1.0]))
    return Camera.from_fov(240, 160, 40.0, pose)


def lit(*lamps):
    return lit_lamps([(lamp, np.eye(4)) for lamp in lamps])


def picture(item):
    renderer = CpuRenderer()
    renderer.draw([item], camera())
    return renderer.read().rgba[..., :3].astype(np.float64)


def mirrored_px(lamp):
    """Pixel of the lamp's image in still water."""
    below = camera().world_to_camera @ np.array([*lamp.position[:2], -lamp.position[2], 1.0])
    view = camera()
    return view.fx * below[0] / below[2] + view.cx, view.fy * below[1] / below[2] + view.cy


@pytest.mark.parametrize("y", [0.0, 2.5, -3.0])
def test_a_lantern_is_a_long_upright_streak_below_itself(y):
    lamp = Lamp(position=(22.0, y, 6.0), intensity_m2=40.0, color=(1.0, 0.6, 0.3))
    item = lamp_reflections(lit(lamp), NONE, camera(), 0.0, 1.0)
    assert item is not None
    light = srgb_to_linear(picture(item)[..., 0])
    rows, columns = np.mgrid[:160, :240]
    x, row = ((light * each).sum() / light.sum() for each in (columns + 0.5, rows + 0.5))
    spread = [
        np.sqrt((light * (each - middle) ** 2).sum() / light.sum())
        for each, middle in ((columns + 0.5, x), (rows + 0.5, row))
    ]
    at, height = mirrored_px(lamp)
    assert abs(x - at) < 4 and abs(row - height) < 40
    assert spread[1] > 1.6 * spread[0]
    display = picture(item).sum(axis=(0, 1))
    assert display[0] > display[1] > display[2]


def test_a_reflection_is_as_bright_in_a_coarse_picture():
    item = lamp_reflections(lit(Lamp(position=(22.0, 0.0, 6.0), intensity_m2=40.0)), NONE, camera(), 0.0, 1.0)
    means = []
    for share in (1, 8):
        renderer, view = CpuRenderer(), camera()
        renderer.draw([item], view.resized(view.width // share, view.height // share))
        means.append(float(renderer.read().rgba[..., 0].mean()))
    assert means[0] > 0.002 and means[1] == pytest.approx(means[0], rel=0.3)


def test_dry_ground_reflects_only_lamps_that_move():
    lantern = Lamp(position=(22.0, 0.0, 6.0), intensity_m2=40.0)
    assert lamp_reflections(lit(lantern), NONE, camera(), 0.0, 0.0) is None
    beam = Lamp(position=(0.0, 0.0, 0.7), direction=(1.0, 0.0, -0.05), intensity_m2=400.0, inner_deg=5, outer_deg=25)
    item = lamp_reflections(NONE, lit(beam), camera(), 0.0, 0.0)
    assert item is not None
    ahead = item.gaussians.means
    assert (np.abs(np.degrees(np.arctan2(ahead[:, 1], ahead[:, 0]))) < 26).all()


def test_brighter_lamps_have_brighter_reflections_up_to_white():
    weak, strong = (
        picture(lamp_reflections(lit(Lamp(position=(22.0, 0.0, 6.0), intensity_m2=m2)), NONE, camera(), 0.0, 1.0))
        for m2 in (2.0, 20.0)
    )
    assert strong.max() <= 1.0 and strong.sum() > 2 * weak.sum() > 0


def test_a_camera_below_ground_or_straight_down_sees_none():
    lamp = Lamp(position=(22.0, 0.0, 6.0), intensity_m2=40.0)
    assert lamp_reflections(lit(lamp), NONE, camera(), 3.0, 1.0) is None
    down = Camera.from_fov(64, 48, 40.0, look_at(EYE, EYE - [0, 0, 1.0], np.array([1.0, 0, 0])))
    assert lamp_reflections(lit(lamp), NONE, down, 0.0, 1.0) is None


def test_lamps_of_the_scene_itself_do_not_light_dry_ground_twice():
    far = Layer("far", one_far_gaussian())
    beam = Lamp(position=(2.0, 0.0, 0.7), direction=(1.0, 0.0, -0.05), intensity_m2=400.0, inner_deg=5, outer_deg=25,
                mount="scene")  # fmt: skip
    dark = []
    for lamps in ((), (beam,)):
        renderer = CpuRenderer()
        scene = Scene("road", (far,), ground_m=0.0, lamps=lamps)
        draw(renderer, FrameInput.of(scene, None, OVERCAST, RenderView(camera())))
        dark.append(renderer.read().rgba.sum())
    assert dark[0] == dark[1]  # baked into the scene's colors


def one_far_gaussian():
    one = np.ones((1, 3), np.float32)
    return Gaussians(
        60 * one, 0.1 * one, np.array([[1, 0, 0, 0]], np.float32), one[:, 0], np.zeros((1, 1, 3), np.float32)
    )
