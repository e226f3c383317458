"""Pictures over the backdrop of a still scene: close to exact ones, and what stands still is drawn once for all."""

from dataclasses import replace

import msgspec
import numpy as np
import pytest

from gsrain_engine.rain.keyframes import NO_KEYFRAMES
from gsrain_engine.rain.settings import load_preset
from gsrain_engine.rain.simulation import OVERCAST, RainSimulation
from gsrain_engine.render.cpu.renderer import CpuRenderer
from gsrain_engine.render.draw import draw
from gsrain_engine.render.frame_input import FrameInput, Quality
from gsrain_engine.render.still_scene import StillScene
from gsrain_engine.render.view import RenderView
from gsrain_engine.scene.camera import Camera, look_at
from gsrain_engine.scene.ground_water import GroundWater
from gsrain_engine.scene.lamps import Lamp
from gsrain_engine.scene.scene import Actor, Layer, PoseTrack, Scene
from small_scene import patch

UP = np.array([0.0, 0.0, 1.0])


def street(speed_m_s=2.0):
    """A wet road with a puddle before a wall, and a red board, also wet, that drives from left to right."""
    surfaces = {
        "road": patch((0, -6, 0), np.array([40.0, 0, 0]), np.array([0, 12.0, 0]), 90, (0.35, 0.33, 0.30)),
        "wall": patch((40, -12, 0), np.array([0, 24.0, 0]), np.array([0, 0, 9.0]), 40, (0.7, 0.45, 0.3)),
        "sky": patch((120, -150, 0), np.array([0, 300.0, 0]), np.array([0, 0, 150.0]), 20, (0.4, 0.6, 0.9)),
    }
    layers = [Layer(name, each, wet_sh=each.sh) for name, each in surfaces.items()]
    board = patch((0.0, -0.8, 0.0), np.array([0, 1.6, 0.0]), np.array([0, 0, 1.5]), 16, (1.0, 0.0, 0.0))
    times, none = np.array([0.0, 5.0]), np.zeros(2)
    positions = np.stack([none + 12.0, speed_m_s * (2.5 - times), none + 0.05], axis=1)
    track = PoseTrack(times, positions, np.tile([1.0, 0, 0, 0], (2, 1)), np.ones(2, bool))
    car = Actor("board", "car", (0.2, 1.6, 1.5), board, track, wet_sh=board.sh)
    cover = np.zeros((12, 40, 2), np.uint8)
    cover[..., 0], cover[3:9, 4:10, 1] = 255, 255
    water = GroundWater((0.0, -6.0), 1.0, cover)
    return Scene("street", tuple(layers), actors=(car,), ground_m=0.0, water=water)


def view(time_s, width=160, height=100, x=0.0):
    eye = np.array([x, 0.0, 1.5])
    camera = Camera.from_fov(width, height, 50.0, look_at(eye, eye + np.array([1.0, 0, -0.12]), UP))
    return RenderView(camera, time_s)


@pytest.fixture
def renderer(monkeypatch):
    """A CPU renderer that counts the parts of each backdrop, and of what is drawn over them."""
    drawn = CpuRenderer()
    drawn.backdrops, drawn.over = [], []
    draw_backdrop, draw_over = drawn.draw_backdrop, drawn.draw_over

    def backdrop(parts, *rest):
        drawn.backdrops.append(len(parts))
        return draw_backdrop(parts, *rest)

    def over(behind, moving, *rest):
        drawn.over.append(len(moving))
        return draw_over(behind, moving, *rest)

    monkeypatch.setattr(drawn, "draw_backdrop", backdrop)
    monkeypatch.setattr(drawn, "draw_over", over)
    return drawn


def rain(**changes):
    return RainSimulation.start(msgspec.structs.replace(load_preset("8.5"), **changes))


def shown(renderer, scene, rainfall, shot, still=None):
    draw(renderer, FrameInput.of(scene, rainfall, OVERCAST, shot, Quality(still=still)))
    return renderer.read().rgba


@pytest.mark.parametrize("changes", [{}, {"mirror": False, "splashes": False}, {"visibility_m": 500.0}], ids=str)
def test_a_picture_over_a_backdrop_is_close_to_an_exact_one(renderer, changes):
    scene, rainfall, still = street(), rain(**changes), StillScene()
    dry = shown(renderer, scene, rain(intensity_mm_h=0.0, wetness=1.0, **changes), view(1.2))
    for time_s in (1.0, 1.2):
        over = shown(renderer, scene, rainfall, view(time_s), still)
    exact = shown(renderer, scene, rainfall, view(1.2))
    error = np.abs(over - exact).mean()
    assert 0 < error < 2e-3
    assert error < 0.1 * np.abs(exact - dry).mean()  # the rain is there
    empty = shown(renderer, replace(scene, actors=()), rainfall, view(1.2))
    board = np.abs(exact - empty).max(axis=2) > 0.05
    assert board.sum() > 200
    assert np.abs(over - exact)[board].mean() < 0.2 * np.abs(exact - empty)[board].mean()  # and the board at its place


def test_what_stands_still_is_drawn_once(renderer):
    scene, rainfall, still = street(), rain(), StillScene()
    for k in range(5):
        shown(renderer, scene, rainfall, view(1 + 0.1 * k), still)
    assert renderer.backdrops == [3]  # road, wall, sky
    assert renderer.over == [1] * 5  # the board
    assert still.built_ms == 0
    assert renderer.statistics.gaussians == scene.gaussian_count
    shown(renderer, scene, rainfall, view(1.5, x=0.2), still)
    assert still.built_ms > 0
    shown(renderer, scene, rain(seed=7), view(1.6, x=0.2), still)
    shown(renderer, scene, rain(intensity_mm_h=20.0), view(1.7, x=0.2), still)
    hidden = scene.with_member("layers/wall", visible=False)
    shown(renderer, hidden, rainfall, view(1.8, x=0.2), still)
    assert renderer.backdrops == [3, 3, 3, 3, 2]


def test_a_backdrop_follows_keyframes_of_the_rain_in_a_quarter_of_the_time(renderer):
    now_s = 0.0
    keys = NO_KEYFRAMES.with_key(0.0, intensity_mm_h=2.0).with_key(10.0, intensity_mm_h=20.0)
    scene, rainfall = street(), RainSimulation.start(load_preset("8.5"), weather=keys)
    draw_backdrop = renderer.draw_backdrop

    def slow_backdrop(*arguments):
        nonlocal now_s
        now_s += 0.1  # s, on the clock below
        return draw_backdrop(*arguments)

    renderer.draw_backdrop = slow_backdrop
    still = StillScene(lambda: now_s)
    for k in range(40):
        over = shown(renderer, scene, rainfall, view(1 + 0.05 * k), still)
        now_s += 0.05
    assert 5 <= len(renderer.backdrops) <= 7  # 2 s of pictures, and 0.1 s for a backdrop every 0.4 s
    exact = shown(renderer, scene, rainfall, view(1 + 0.05 * 39))
    assert 0 < np.abs(over - exact).mean() < 3e-3
    before = len(renderer.backdrops)
    other = replace(rainfall, weather=keys.with_key(20.0, intensity_mm_h=1.0))
    shown(renderer, scene, other, view(3.0), still)  # an edit is there at once
    assert len(renderer.backdrops) == before + 1
    windy = RainSimulation.start(
        load_preset("8.5"), weather=NO_KEYFRAMES.with_key(0.0, wind_m_s=(0.0, 0.0)).with_key(9.0, wind_m_s=(5.0, 0.0))
    )
    for k in range(20):
        shown(renderer, scene, windy, view(1 + 0.1 * k), still)
        now_s += 1.0
    assert len(renderer.backdrops) == before + 2  # wind moves drops alone


def test_a_board_that_stands_is_part_of_the_backdrop_and_one_that_stops_stays_out_of_it(renderer):
    rainfall = rain()
    shown(renderer, street(0.0), rainfall, view(1.0), StillScene())
    assert (renderer.backdrops, renderer.over) == ([4], [0])
    still, scene = StillScene(), street(-1.0)
    for time_s in (4.0, 4.95, 5.0):  # its track ends at 5 s
        shown(renderer, scene, rainfall, view(time_s), still)
    assert (renderer.backdrops[1:], renderer.over[1:]) == ([3], [1, 1, 1])


def test_mirrors_are_shared_while_their_rings_are_new(renderer, monkeypatch):
    drawn, draw_exact = [], renderer.draw
    monkeypatch.setattr(renderer, "draw", lambda *rest, **options: (drawn.append(1), draw_exact(*rest, **options)))
    scene, rainfall, still = street(), rain(streaks=False), StillScene()
    pictures = [shown(renderer, scene, rainfall, view(1 + 0.05 * k), still) for k in range(4)]
    assert len(drawn) == 1  # the mirror's own picture
    puddle = np.s_[60:, 40:120]
    assert np.abs(pictures[2] - pictures[1])[puddle].max() > 1e-3
    for k in range(4, 16):
        shown(renderer, scene, rainfall, view(1 + 0.05 * k), still)
    assert len(drawn) == 2  # with the board where it is now


def test_rain_in_the_light_of_lamps_or_mixed_as_display_colors_is_drawn_exactly(renderer):
    night = replace(street(), lamps=(Lamp(position=(6.0, 2.0, 4.0), intensity_m2=1.0),))
    for scene, rainfall in ((street(), rain(model="paper")), (night, rain())):
        over = shown(renderer, scene, rainfall, view(1.2), StillScene())
        assert np.array_equal(over, shown(renderer, scene, rainfall, view(1.2)))
    assert renderer.backdrops == []
