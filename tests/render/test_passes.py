"""Passes of a picture: one file and one row add an effect everywhere, and their times sum to that of the picture."""

import inspect
import time

import numpy as np
import pytest

from gsrain_engine.backends import open_renderer
from gsrain_engine.evaluation.attribution.factors import RainFactors
from gsrain_engine.evaluation.detection.attribution import rain_attributions
from gsrain_engine.rain.frame import SkyLight
from gsrain_engine.rain.settings import RainSettings
from gsrain_engine.rain.simulation import RainSimulation
from gsrain_engine.render.cpu.renderer import CpuRenderer
from gsrain_engine.render.draw import draw
from gsrain_engine.render.frame_input import FALLING, FILTERS, FrameInput, Quality
from gsrain_engine.render.passes import glass, registry
from gsrain_engine.render.passes.base import Factor, Pass
from gsrain_engine.render.provenance import provenance_of
from gsrain_engine.render.renderer import PictureFilter
from gsrain_engine.render.view_reuse import ViewReuse
from rain.test_available import SCENE, SKY, VIEW
from small_scene import small_scene

RAIN = RainSettings(intensity_mm_h=25.0, glass="windshield", glass_wet_s=4.0, sensor="automotive")


class Vignette:
    """An effect that no setting knows: it halves the left column of the picture."""

    name = "vignette"
    factor = Factor(name, "vignette")

    def active(self, frame):
        return frame.falling is not None

    def add(self, frame, parts):
        def darker(picture):
            picture = picture.copy()
            picture[:, 0] //= 2
            return picture

        parts.filters.append(PictureFilter(self.name, darker))


def frame_in(rain: RainSettings, scene=None, **more) -> FrameInput:
    light = SkyLight.uniform((0.7, 0.7, 0.7))
    return FrameInput.of(scene or small_scene(), RainSimulation.start(rain), light, VIEW, **more)


def test_draw_is_short_and_takes_a_renderer_and_a_frame():
    lines = inspect.getsource(draw).splitlines()
    assert len(lines) <= 30 and list(inspect.signature(draw).parameters) == ["renderer", "frame"]


def test_every_pass_has_a_name_of_its_own():
    names = [each.name for each in registry.PASSES]
    assert len(set(names)) == len(names) and all(isinstance(each, Pass) for each in registry.PASSES)
    assert set(names) >= FALLING | FILTERS


def test_a_new_effect_is_a_class_and_a_row(monkeypatch):
    rain = RainSettings(intensity_mm_h=25.0)
    before = draw(CpuRenderer(), frame_in(rain)).read_uint8()
    monkeypatch.setattr(registry, "PASSES", (*registry.PASSES, Vignette()))
    picture = draw(CpuRenderer(), frame_in(rain))
    changed = picture.read_uint8()
    np.testing.assert_array_equal(changed[:, 1:], before[:, 1:])
    np.testing.assert_array_equal(changed[:, 0], before[:, 0] // 2)
    assert picture.rows_ms["vignette"] > 0
    assert "vignette" in provenance_of(frame_in(rain)).passes
    assert "vignette" in provenance_of(frame_in(rain, without={"vignette"})).left_out
    found = RainFactors.of(rain, ("all",), "small")
    assert "vignette" in found.names
    assert found.weather(frozenset({"streaks"})).without == {"vignette"}
    assert found.weather(frozenset(found.names)).without == frozenset()
    (part,) = rain_attributions(rain, ("streaks", "vignette"), None, small_scene(), (25.0,), (0,), in_front=False)
    assert part.factors.names == ("streaks", "vignette")


def test_fast_pictures_share_the_view_behind_wet_glass_and_others_do_not(monkeypatch):
    rain, drawn, sample = RainSettings(intensity_mm_h=25.0, glass="windshield", glass_wet_s=4.0), [], glass.LodSample
    monkeypatch.setattr(glass, "LodSample", lambda *share: (drawn.append(share), sample(*share))[1])
    for quality, count in ((Quality(), 4), (Quality(reuse=ViewReuse(1)), 2)):
        drawn.clear()
        frame = frame_in(rain, quality=quality)
        pictures = [draw(CpuRenderer(), frame).read_uint8() for _ in range(4)]
        assert len(drawn) == count
        assert all(np.array_equal(each, pictures[0]) for each in pictures)


@pytest.mark.parametrize("backend", ["cpu", "opengl-quads", "opengl-tiles"])
def test_times_of_rows_sum_to_that_of_the_picture(backend):
    shares = []
    with open_renderer(backend) as renderer:
        for number in range(4):
            frame = FrameInput.of(SCENE, RainSimulation.start(RAIN), SKY, VIEW)
            started = time.perf_counter()
            picture = draw(renderer, frame)
            picture.read_uint8()
            whole_ms = 1000 * (time.perf_counter() - started)
            if number:  # the first one compiles
                shares.append(sum(picture.rows_ms.values()) / whole_ms)
        assert {"scene", "mirror", "streaks", "glass", "sensor", "project", "draw"} <= set(picture.rows_ms)
    assert np.median(shares) == pytest.approx(1.0, abs=0.05)
