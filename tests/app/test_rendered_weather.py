"""`gsrain render` of a scene that was saved with a weather."""

import json
from dataclasses import replace

import msgspec
import numpy as np
import pytest

from app.main import run
from gsrain_engine.rain.keyframes import RainKeyframe, RainKeyframes
from gsrain_engine.rain.settings import RainSettings
from gsrain_engine.scene.formats.scene_files import write_scene
from small_scene import small_scene


@pytest.fixture(scope="module")
def shower(tmp_path_factory):
    """The small scene, from 0 to 10 mm/h within 2 s."""
    keys = (RainKeyframe(time_s=0.0, intensity_mm_h=0.0), RainKeyframe(time_s=2.0, intensity_mm_h=10.0))
    rain, weather = RainSettings(intensity_mm_h=50.0, seed=4), RainKeyframes(keys=keys)
    scene = replace(small_scene(), rain=msgspec.to_builtins(rain), weather=msgspec.to_builtins(weather))
    folder = tmp_path_factory.mktemp("shower") / "shower"
    write_scene(scene, folder)
    return folder


def frame(scene, folder, *options):
    out = folder / f"still{len(list(folder.iterdir()))}.npy"
    numbers = out.with_suffix(".json")
    arguments = ["render", str(scene), "-o", str(out), "--size", "96x64", "--backend", "cpu", "--json", str(numbers)]
    assert run([*arguments, *options]) == 0
    return np.load(out), json.loads(numbers.read_text())


def test_the_weather_of_the_scene_is_used_and_told(shower, tmp_path, capsys):
    dry, _ = frame(shower, tmp_path, "--time", "0")
    wet, report = frame(shower, tmp_path, "--time", "1.5")
    assert report["intensity_mm_h"] == pytest.approx(7.5)
    assert report["drops"] > 0
    assert "a weather with 2 keys" in capsys.readouterr().out
    clear, _ = frame(shower, tmp_path, "--time", "0", "--rain", "0")
    assert np.array_equal(dry, clear)
    assert not np.array_equal(wet, frame(shower, tmp_path, "--time", "1.5", "--rain", "0")[0])


def test_rain_and_preset_take_the_place_of_the_weather(shower, tmp_path):
    assert frame(shower, tmp_path, "--time", "1", "--rain", "3")[1]["intensity_mm_h"] == 3.0
    assert frame(shower, tmp_path, "--time", "1", "--preset", "1.2")[1]["intensity_mm_h"] == 1.2
    assert frame(shower, tmp_path, "--time", "1", "--seed", "9")[1]["intensity_mm_h"] == pytest.approx(5.0)
