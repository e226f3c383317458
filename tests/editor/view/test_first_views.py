"""First views of scenes, and the commands that return to them."""

import numpy as np
import pytest

from gsrain_engine.editor.clock import PlaybackClock
from gsrain_engine.editor.document import Document, DocumentState
from gsrain_engine.editor.edits.members import set_visible
from gsrain_engine.editor.status import StatusBus
from gsrain_engine.editor.timeline import Playback
from gsrain_engine.editor.viewport.camera import (
    OrbitCamera,
    find_scene_core,
    home_camera,
    is_in_view,
)
from gsrain_engine.editor.viewport_state import ViewportState
from gsrain_engine.rain.settings import RainSettings
from gsrain_engine.render.cpu.renderer import CpuRenderer
from gsrain_engine.scene.gaussians import Gaussians, sh_from_color
from gsrain_engine.scene.open import load_street
from gsrain_engine.scene.scene import Layer, Scene
from gsrain_engine.scene.transforms import FILE_UP, flatten_scene

WIDTH, HEIGHT = 96, 64


def blob(means, sigma=0.02):
    f, n = np.float32, len(means)
    turns = np.tile(np.array([1, 0, 0, 0], f), (n, 1))
    colors = sh_from_color(np.linspace(0.1, 0.9, 3 * n).reshape(n, 3).astype(f))
    return Gaussians(np.asarray(means, f), np.full((n, 3), sigma, f), turns, np.full(n, 0.9, f), colors)


def cube(count=1000, at=(0, 0, 0), side=2.0):
    return np.random.default_rng(3).uniform(-side / 2, side / 2, (count, 3)) + at


def dome(radius=40.0, count=400):
    """A blue half sphere of large Gaussians."""
    rng = np.random.default_rng(4)
    ways = rng.normal(size=(count, 3))
    ways[:, 2] = np.abs(ways[:, 2])
    sky = blob(radius * ways / np.linalg.norm(ways, axis=1, keepdims=True), 0.12 * radius)
    return sky.with_sh(sh_from_color(np.tile(np.array([0.3, 0.5, 0.9], np.float32), (count, 1))))


def scene_of(*gaussians, **fields):
    return Scene("scene", tuple(Layer(f"{k}", each) for k, each in enumerate(gaussians)), **fields)


def surrounded():
    return scene_of(Gaussians.concatenate([blob(cube()), dome()]))


def viewport_of(scene):
    clock = PlaybackClock()
    document = Document(DocumentState(scene, RainSettings()), clock, StatusBus())
    return ViewportState(document, Playback(document, clock))


def seen(scene, camera):
    """Picture over black."""
    renderer = CpuRenderer()
    renderer.draw(scene.parts(), camera)
    return renderer.read().rgba[..., :3]


@pytest.fixture(scope="module")
def street():
    return load_street()


def test_a_street_in_a_single_file_is_framed_as_in_its_folder(street):
    flat = Scene("flat", (Layer("flat", flatten_scene(street)),), up=FILE_UP)
    core, layered = find_scene_core(flat), find_scene_core(street)
    np.testing.assert_allclose([core.low, core.high], [layered.low, layered.high], atol=1.5)
    for shell in (core.shell, layered.shell):
        assert 850 < shell.radius_m < 950
    camera = home_camera(flat, WIDTH, HEIGHT)
    assert np.linalg.norm(camera.position - core.middle) < 250
    picture = seen(flat, camera)
    assert picture[20:50].std(axis=(0, 1)).min() > 0.03  # it was nothing but sky, 0.01
    hidden = scene_of(blob(cube()), dome()).with_member("layers/0", visible=False)
    assert np.isfinite(home_camera(hidden, WIDTH, HEIGHT).world_to_camera).all()


SHAPES = {
    "one": blob(np.array([[5.0, 6, 7]]), 2.0),
    "plane": blob(cube() * [1, 1, 0]),
    "line": blob(cube() * [1, 0, 0]),
    "strays": blob(np.concatenate([cube(), cube(30, (0, 0, 0), 4000.0)])),
    "in a dome": Gaussians.concatenate([blob(cube()), dome()]),
    "two clusters": blob(np.concatenate([cube(500), cube(500, (60, 0, 0))])),
    "not numbers": blob(np.concatenate([cube(), np.full((40, 3), np.nan)])),
    "stacked": blob(np.zeros((50, 3)), 0.5),
}


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("size", [(WIDTH, HEIGHT), (HEIGHT, 2 * HEIGHT)])
def test_first_views_show_what_is_there(shape, size):
    scene = scene_of(SHAPES[shape])
    core = find_scene_core(scene)
    camera = home_camera(scene, *size)
    clean = scene_of(SHAPES[shape].take(np.isfinite(SHAPES[shape].means).all(axis=1).nonzero()[0]))
    picture = seen(clean, camera)
    lit = picture.max(axis=2) > 0.05 if core.shell is None else picture[..., 0] - picture[..., 2] > -0.2
    rows, columns = np.flatnonzero(lit.any(axis=1)), np.flatnonzero(lit.any(axis=0))
    assert max(np.ptp(rows) / size[1], np.ptp(columns) / size[0]) > 0.45
    assert core.radius_m < (40 if shape == "two clusters" else 8)
    assert (core.shell is not None) == (shape == "in a dome")


def test_f_frames_the_layer_that_is_chosen():
    """A large layer of few Gaussians around a small one of many: the scene's core is the small one."""
    viewport = viewport_of(scene_of(blob(cube(3000, side=0.3)), blob(cube(300, at=(40, 0, 0), side=30), sigma=1)))
    viewport.frame_scene()
    assert viewport.navigation.distance_m < 2
    viewport.options.member = viewport.document.scene.layers[1].key
    viewport.frame_scene()
    eye = viewport.navigation
    assert 15 < eye.distance_m < 100
    assert np.linalg.norm(eye.position + eye.distance_m * eye.forward - [40, 0, 0]) < 3
    viewport.options.member = "layers/none"
    viewport.frame_scene()
    assert viewport.navigation.distance_m < 2


PLACES = {
    "far away": (np.array([4e4, -3e4, 500.0]), 2.0, 0.3),
    "outside of the dome, looking away": (np.array([90.0, 0, 5]), 0.0, 0.0),
    "inside of the dome, looking up": (np.array([-20.0, 10, 3]), 1.0, 1.5),
    "below": (np.array([0.0, 0, -25]), 0.0, -1.5),
    "in the middle": (np.array([0.1, 0, 0]), -2.0, 0.5),
    "no number": (np.array([np.nan, 0, 0]), np.nan, 0.0),
    "beyond all numbers": (np.array([1e300, 0, 0]), 0.5, np.inf),
}


@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize("key", ["F", "Home", "wheel in", "wheel out"])
def test_keys_and_wheel_lead_back_from_everywhere(place, key):
    viewport = viewport_of(surrounded())
    eye, core = OrbitCamera(*PLACES[place]), viewport.core
    viewport.navigation = eye
    for _ in range(200 if "wheel" in key else 1):
        {
            "F": viewport.frame_scene,
            "Home": viewport.go_home,
            "wheel in": lambda: viewport.dolly(1.0),
            "wheel out": lambda: viewport.dolly(-1.0),
        }[key]()
    eye = viewport.navigation
    distance = np.linalg.norm(eye.position - core.middle)
    assert np.isfinite([*eye.position, eye.heading, eye.pitch, eye.distance_m]).all()
    assert is_in_view(core, eye.position, eye.forward, eye.vertical_fov_deg)
    if key != "wheel out":  # which does not go on outside of the dome, nor come back
        assert distance < 0.8 * core.shell.radius_m
    elif place not in ("far away", "outside of the dome, looking away"):
        assert distance <= core.farthest_m


def test_the_core_is_looked_for_once_while_nothing_else_is_to_be_seen(monkeypatch):
    calls = []
    real = find_scene_core
    monkeypatch.setattr(
        "gsrain_engine.editor.viewport_state.find_scene_core", lambda scene: calls.append(1) or real(scene)
    )
    viewport = viewport_of(surrounded())
    for _ in range(5):
        viewport.dolly(1.0)
    assert len(calls) == 1
    viewport.document.edit("Hide", set_visible, "layers/0", False)
    viewport.dolly(1.0)
    assert len(calls) == 2
