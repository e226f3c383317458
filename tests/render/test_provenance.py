"""PictureProvenance of pictures: what was drawn, in plain values, and the same bytes drawn from it."""

from dataclasses import replace

import msgspec
import numpy as np
import pytest

from appearance.sunny_street import capture_of, street_photo
from gsrain_engine.appearance.capture_photos import CapturePhotos
from gsrain_engine.rain.frame import SkyLight
from gsrain_engine.rain.keyframes import RainKeyframe, RainKeyframes
from gsrain_engine.rain.settings import RainSettings, load_preset
from gsrain_engine.rain.simulation import RainSimulation
from gsrain_engine.render.cpu.renderer import CpuRenderer
from gsrain_engine.render.draw import draw
from gsrain_engine.render.frame_input import FALLING, FrameInput
from gsrain_engine.render.passes.registry import PASSES
from gsrain_engine.render.photograph import Distances, Photograph
from gsrain_engine.render.provenance import PictureProvenance, frame_of, provenance_of
from gsrain_engine.render.sky_color import SkyColor
from gsrain_engine.render.view import RenderView
from gsrain_engine.scene.camera import Camera
from small_scene import small_scene

AHEAD = np.array([[0.0, -1, 0, 0], [0, 0, -1, 1.5], [1, 0, 0, 0], [0, 0, 0, 1]])
VIEW = RenderView(Camera(96, 64, 80.0, 80.0, 48.0, 32.0, AHEAD, 0.008), 0.7, np.array([5.0, 0.0, 0.0]))
SKY = SkyColor(SkyLight((0.7, 0.75, 0.8), (0.6, 0.65, 0.7)), True, SkyLight((0.5, 0.5, 0.55), (0.4, 0.45, 0.5)))
WEATHER = RainKeyframes(
    keys=(RainKeyframe(time_s=0.0, intensity_mm_h=2.0), RainKeyframe(time_s=1.0, intensity_mm_h=40.0))
)
RAINS = {
    "medium": (RainSettings(intensity_mm_h=25, seed=3), None, {}),
    "paper": (load_preset("paper"), None, {}),
    "fog": (RainSettings(visibility_m=100.0), None, {}),
    "glass and sensor": (RainSettings(intensity_mm_h=25, glass="lens", sensor="automotive"), None, {}),
    "weather": (RainSettings(), WEATHER, {}),
    "clear": (RainSettings(intensity_mm_h=25, sensor="automotive"), None, {"is_clear": True}),
    "light alone": (RainSettings(intensity_mm_h=25), None, {"without": FALLING}),
}


def read_back(frame: FrameInput) -> PictureProvenance:
    return msgspec.json.decode(msgspec.json.encode(provenance_of(frame)), type=PictureProvenance)


@pytest.mark.parametrize("name", RAINS)
def test_the_same_bytes_are_drawn_from_the_provenance(name):
    rain, weather, more = RAINS[name]
    scene, renderer = small_scene(), CpuRenderer()
    frame = FrameInput.of(scene, RainSimulation.start(rain, weather=weather), SKY, VIEW, **more)
    again = frame_of(read_back(frame), scene)
    assert draw(renderer, again).read_uint8().tobytes() == draw(renderer, frame).read_uint8().tobytes()


def test_it_says_what_was_drawn_and_not_what_was_asked_for():
    scene = small_scene()
    found = {
        name: read_back(FrameInput.of(scene, RainSimulation.start(rain, weather=weather), SKY, VIEW, **more))
        for name, (rain, weather, more) in RAINS.items()
    }
    for each in found.values():
        assert {*each.passes, *each.left_out} == {every.name for every in PASSES}
    assert found["medium"].passes == ("scene", "streaks", "medium") and found["medium"].haze == "medium"
    assert "glass" in found["glass and sensor"].passes and "sensor" in found["glass and sensor"].passes
    assert found["paper"].haze == "gaussians"
    assert found["weather"].intensity_mm_h == pytest.approx(2 + 0.7 * 38, rel=0.3)
    assert found["clear"].passes == ("scene", "sensor")
    for name in ("clear", "light alone"):
        assert found[name].haze == "none" and found[name].extinction_per_m == 0
    assert found["light alone"].light.overcast == 1.0 and found["clear"].light.overcast == 0.0


@pytest.mark.parametrize("measured", [True, False])
def test_a_photograph_is_drawn_again_and_says_whose_its_distances_are(measured):
    photo = np.random.default_rng(0).integers(0, 255, (64, 96, 3), np.uint8)
    depth = np.full((64, 96), 30.0, np.float32)
    photograph = Photograph(photo, Distances(VIEW.camera, depth, np.ones_like(depth, bool) if measured else None))
    rain = RainSimulation.start(RainSettings(intensity_mm_h=50))
    world, renderer = replace(small_scene(), layers=(), actors=()), CpuRenderer()
    frame = FrameInput.of(world, rain, SKY, VIEW, photograph=photograph)
    found = read_back(frame)
    assert found.distances == ("measured" if measured else "level road (assumed)")
    again = frame_of(found, world, photograph)
    drawn = draw(renderer, frame).read_uint8()
    assert draw(renderer, again).read_uint8().tobytes() == drawn.tobytes() != photo.tobytes()


@pytest.mark.parametrize("keeps", [False, True])
def test_a_photograph_under_clouds_is_drawn_again_and_says_what_was_done_to_its_light(keeps):
    capture, rain = capture_of(street_photo()), RainSettings(intensity_mm_h=8, keep_light=keeps)
    frame = CapturePhotos(capture).frame(capture[0], RainSimulation.start(rain))
    found = read_back(frame)
    assert found.photo_light == ("kept (--keep-light)" if keeps else "softened to overcast (sun 1.00)")
    settings = msgspec.convert(found.rain, RainSettings)
    photographs = CapturePhotos(capture).frame(capture[0], RainSimulation.start(settings)).photograph
    again = draw(CpuRenderer(), frame_of(found, frame.scene, photographs)).read_uint8()
    assert again.tobytes() == draw(CpuRenderer(), frame).read_uint8().tobytes()
    assert provenance_of(frame_of(found, frame.scene, photographs)).photo_light == found.photo_light
