"""Pictures in bands of rows: the same pixels as drawn at once."""

from dataclasses import replace

import numpy as np
import pytest

from gsrain_engine.backends import open_renderer
from gsrain_engine.rain.settings import RainSettings
from gsrain_engine.rain.simulation import RainSimulation
from gsrain_engine.render import bands
from gsrain_engine.render.sequence import FrameSequence
from gsrain_engine.scene.camera import Camera, look_at
from gsrain_engine.water.mirror import Mirror
from small_scene import small_scene

LEVELS = 1.5 / 255
WIDTH, HEIGHT = 160, 104


def drawn(backend, rain, **options):
    """Colors and depth of a frame, and its bytes."""
    pose = look_at(np.array([0.0, 0.0, 1.5]), np.array([20.0, 1.0, 1.0]), np.array([0.0, 0.0, 1.0]))
    camera = Camera.from_fov(WIDTH, HEIGHT, 50.0, pose)
    sequence = FrameSequence(small_scene(), RainSimulation.start(rain), camera, WIDTH, HEIGHT, **options)
    with open_renderer(backend) as renderer:
        sky = sequence.sky(renderer)
        return sequence.frame(renderer, 0, sky, with_depth=True), sequence.request(renderer, 0, sky)()


@pytest.mark.parametrize(
    ("backend", "options"),
    [("cpu", {}), ("cpu", {"supersampling": 3}), ("opengl-quads", {}), ("opengl-tiles", {})],
)
def test_bands_show_no_seam(backend, options, monkeypatch):
    rain = RainSettings(intensity_mm_h=30.0, seed=3, exposure_s=0.01)
    whole, whole_bytes = drawn(backend, rain, **options)
    side = options.get("supersampling", 1)
    monkeypatch.setattr(bands, "MAX_SAMPLES", 40 * WIDTH * side**2)
    camera = Camera.from_fov(side * WIDTH, side * HEIGHT, 50.0, np.eye(4))
    assert [rows // side for _, rows in bands.bands_of(camera, side)] == [32, 32, 32, 8]
    banded, banded_bytes = drawn(backend, rain, **options)
    assert np.abs(banded.rgba - whole.rgba).max() < LEVELS
    assert np.abs(banded_bytes.astype(int) - whole_bytes).max() <= 1
    assert np.mean(banded_bytes != whole_bytes) < 0.01
    is_there = (whole.depth > 0) & (banded.depth > 0)
    assert is_there.mean() > 0.3 and np.mean((whole.depth > 0) != (banded.depth > 0)) < 1e-3
    assert np.abs(banded.depth / np.where(is_there, whole.depth, 1) - 1)[is_there].max() < 5e-3


def test_a_band_is_part_of_its_picture():
    camera = Camera(64, 48, 40.0, 50.0, 30.0, 20.0)
    band = camera.band(16, 20).band(4, 8)
    assert (band.height, band.cy, band.rows_outside) == (8, 0.0, (20, 20))
    whole = band.whole
    assert (whole.height, whole.cy, whole.rows_outside) == (48, 20.0, (0, 0)) and camera.whole is camera


def test_a_band_of_a_mirror_reflects_as_the_whole():
    random = np.random.default_rng(1)
    mirror = Mirror(6, random.random((20, 40, 2, 3), np.float32))
    film = random.random((104, 80, 2), np.float32)
    band = replace(mirror, first_row=mirror.first_row - 12)
    assert np.array_equal(band.reflected(film[48:80]), mirror.reflected(film)[48:80])
