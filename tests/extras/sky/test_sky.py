"""Skies put up around scenes: computed ones and panoramas, in any axes and units; pictures that are none."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

import gsrain as gr
from app.main import BAD_INPUT, run
from gsrain_engine.scene.formats import read_scene, write_scene
from gsrain_engine.scene.gaussians import SH_C0
from gsrain_engine.scene.scene import Layer, Scene
from small_scene import small_scene
from tests.scene.formats.sample_files import sample_gaussians


def sky_towards(scene: Scene, *directions: tuple[float, float, float]) -> np.ndarray:
    """Display colors of the only sky, in directions of the world."""
    (sky,) = (each for each in scene.layers if each.kind == "sky")
    to_world = scene.scene_to_world @ sky.to_scene
    means = sky.gaussians.means @ to_world[:3, :3].T + to_world[:3, 3]
    away = means - means.mean(axis=0)
    away /= np.linalg.norm(away, axis=1, keepdims=True)
    nearest = (away @ np.array(directions).T).argmax(axis=0)
    return sky.gaussians.sh[nearest, 0] * SH_C0 + 0.5


@pytest.fixture
def panorama(tmp_path: Path) -> Path:
    """Red ahead, in the middle; green on the left; blue overhead; gray elsewhere."""
    picture = np.full((180, 360, 3), 128, np.uint8)
    picture[80:100, 170:190], picture[80:100, 80:100], picture[:10] = (255, 0, 0), (0, 255, 0), (0, 0, 255)
    Image.fromarray(picture).save(tmp_path / "sky.png")
    return tmp_path / "sky.png"


RED, GREEN, BLUE, GRAY = [1, 0, 0], [0, 1, 0], [0, 0, 1], [0.5, 0.5, 0.5]


@pytest.mark.parametrize(("up", "unit"), [((0.0, 0.0, 1.0), 1.0), ((0.0, -1.0, 0.0), 0.25)])
def test_a_panorama_replaces_the_sky_in_any_axes(up: Any, unit: float, panorama: Path) -> None:
    before = replace(small_scene(), up=up, metres_per_unit=unit)
    scene = gr.edit(before, "sky", picture=str(panorama))
    assert [each.name for each in scene.layers] == ["road", "wall", "sky"]
    assert scene.layers[0] is before.layers[0]
    found = sky_towards(scene, (1, 0, 0), (0, 1, 0), (0, 0, 1), (-1, 0, 0))
    np.testing.assert_allclose(found, [RED, GREEN, BLUE, GRAY], atol=0.01)
    turned = gr.edit(before, "sky", picture=str(panorama), turn_deg=90.0)
    np.testing.assert_allclose(sky_towards(turned, (0, 1, 0), (1, 0, 0)), [RED, GRAY], atol=0.01)


def test_a_scene_without_a_sky_gets_one_that_is_blue_by_day_and_dark_by_night(tmp_path: Path) -> None:
    plain = Scene("plant", (Layer("plant", sample_gaussians(300)),), up=(0.0, -1.0, 0.0))
    write_scene(plain, tmp_path / "scene")
    steps = [str(tmp_path / "scene"), "sky", "-o", str(tmp_path / "clear")]
    assert run(["edit", *steps]) == 0
    (zenith,) = sky_towards(read_scene(tmp_path / "clear"), (0, 0, 1))
    assert zenith[2] > 0.6 > zenith[0]
    (dark,) = sky_towards(gr.edit(plain, "sky", look="night"), (0, 0, 1))
    assert dark.max() < 0.2


@pytest.mark.parametrize(
    ("size", "told"),
    [((300, 300), "twice as wide as high, not 300 x 300"), (None, "no such picture"), ((0, 0), "sky.png")],
)
def test_other_pictures_are_refused(
    size: tuple[int, int] | None, told: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_scene(small_scene(), tmp_path / "scene")
    if size == (0, 0):
        (tmp_path / "sky.png").write_bytes(b"no picture")
    elif size is not None:
        Image.new("RGB", size).save(tmp_path / "sky.png")
    step = f"sky picture={tmp_path / 'sky.png'}"
    assert run(["edit", str(tmp_path / "scene"), step, "-o", str(tmp_path / "out")]) == BAD_INPUT
    error = capsys.readouterr().err
    assert told.lower() in error.lower() and error.count("\n") == 1
    assert not (tmp_path / "out").exists()
