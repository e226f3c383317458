"""The rain of the built-in street, as a person sees it: against its own still without rain, over seeds."""

import re

import msgspec
import numpy as np
import pytest

from benchmarks.rain_visibility import StreetStills
from gsrain_engine.editor.viewport.camera import default_path
from gsrain_engine.rain.settings import load_preset
from gsrain_engine.rain.simulation import RainSimulation
from gsrain_engine.render.cpu.renderer import CpuRenderer
from gsrain_engine.render.sequence import FrameSequence
from gsrain_engine.render.view import rain_camera
from gsrain_engine.scene.open import load_built_in
from repository import REPOSITORY

SEEDS, INTENSITIES = range(5), ("1.2", "8.5", "12.0")
STREAKS, HAZE = {"haze": "none"}, {"streaks": False}


class Stills:
    """Stills of the street 2 s into the default drive, with one sky color."""

    def __init__(self):
        self.renderer, self.street = CpuRenderer(), load_built_in()
        path = default_path(self.street, 960, 640)
        self.sequence = FrameSequence(
            self.street, RainSimulation.start(load_preset("clear")), path, 960, 640, start_s=2.0
        )
        self.sky = self.sequence.sky(self.renderer).light
        self.shot = self.sequence.shot(0)
        self.clear = self.picture("clear")

    def falling(self, preset, **fields):
        rain = RainSimulation.start(msgspec.structs.replace(load_preset(preset), **fields))
        return rain.frame(self.shot.time_s, rain_camera(self.street, rain, self.shot), self.sky)

    def picture(self, preset, **fields):
        self.renderer.draw(self.street.parts(2.0), self.shot.camera, self.falling(preset, **fields))
        return self.renderer.read()

    def changed_share(self, preset, **fields):
        rainy = self.picture(preset, **fields)
        levels = np.abs(rainy.to_uint8().astype(int) - self.clear.to_uint8()).max(axis=-1)
        return np.mean(levels > 4)

    def change(self, preset, **fields):
        return np.mean(np.abs(self.picture(preset, **fields).rgba - self.clear.rgba)[..., :3])


@pytest.fixture(scope="module")
def stills():
    return Stills()


@pytest.mark.parametrize("seed", SEEDS)
def test_streaks_change_more_pixels_as_it_rains_harder(stills, seed):
    shares = [stills.changed_share(preset, seed=seed, **STREAKS) for preset in INTENSITIES]
    assert shares[0] < shares[1] < shares[2]
    assert shares[1] >= 0.01


def test_haze_takes_more_light_as_it_rains_harder(stills):
    depths = [stills.change(preset, **HAZE) for preset in INTENSITIES]  # of any seed the same
    assert depths[0] < depths[1] < depths[2]


def test_the_paper_s_streaks_are_far_fainter(stills):
    difference = np.abs(stills.picture("paper", **STREAKS).rgba - stills.clear.rgba)[..., :3] * 255
    physical = np.abs(stills.picture("8.5", **STREAKS).rgba - stills.clear.rgba)[..., :3] * 255
    assert 0 < difference.max() < 4 < physical.max()


def test_advice_on_faint_rain_is_measured(stills):
    documented = re.findall(r"^\| (.+) \| ([\d.]+) \|$", (REPOSITORY / "docs" / "faq.md").read_text(), re.MULTILINE)
    measured = StreetStills(stills.street).advice()
    assert len(documented) == len(measured) == 8
    for (advice, percent), (name, value) in zip(documented, measured.items(), strict=True):
        assert value == pytest.approx(float(percent), rel=0.1, abs=0.01), (advice, name)
    assert measured["exposure 0.001"] > measured["as it is"] > measured["exposure 0.02"]
