"""Every option of the rain on every kind of source: it changes what is drawn, or is refused by its name."""

from collections import deque
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import msgspec
import numpy as np
import pytest

from appearance.sunny_street import capture_of, street_photo
from gsrain_engine.appearance.capture_photos import CapturePhotos
from gsrain_engine.editor.viewport.camera import find_scene_core
from gsrain_engine.evaluation.lidar.results import rain_runs
from gsrain_engine.evaluation.lidar.scan import scene_turns
from gsrain_engine.evaluation.lidar.sensor import SENSORS
from gsrain_engine.fields import fields_of, option_names
from gsrain_engine.publish.page import write_page
from gsrain_engine.rain.available import UNAVAILABLE, check_available
from gsrain_engine.rain.frame import SkyLight
from gsrain_engine.rain.settings import RainSettings
from gsrain_engine.rain.simulation import RainSimulation
from gsrain_engine.render.cpu.renderer import CpuRenderer
from gsrain_engine.render.draw import draw
from gsrain_engine.render.frame_input import FrameInput
from gsrain_engine.render.photograph import Distances, Photograph
from gsrain_engine.render.sequence import FrameSequence
from gsrain_engine.render.view import rain_camera
from gsrain_engine.scene.ground_water import GroundWater
from gsrain_engine.scene.lamps import Lamp
from gsrain_engine.scene.orthographic import orientation, scaled_camera
from gsrain_engine.scene.scene import Layer, Scene
from small_scene import patch
from water.test_spray import VIEW, street, track

SKY = SkyLight((0.7, 0.75, 0.8), (0.5, 0.55, 0.6))
OPTIONS = {each.name for each in fields_of(RainSettings) if {"render", "export-rain"} & {*each.commands}}
BASE = RainSettings(intensity_mm_h=25.0, exposure_s=0.01, seed=1, glass_wet_s=4.0)
CHANGES = {
    "intensity_mm_h": 5.0, "exposure_s": 0.03, "seed": 2, "streaks": False, "haze": "none", "visibility_m": 60.0,
    "roofs": True, "wind_speed_m_s": 15.0, "wind_from_deg": 90.0, "gust_m_s": 8.0, "turbulence_m_s": 3.0,
    "calibration": "marshall_palmer", "closure": "published", "diameter_scale": 2.0, "haze_gain": 3.0,
    "streak_gain": 5.0, "sensor": "waymo_front", "glass": "windshield", "wiper": "high", "glass_wet_s": 2.0,
    "glass_dirt": 1.0, "contact_angle_deg": 90.0, "glass_distance_m": 0.3, "lamps": "none", "lamp_gain": 4.0,
    "wetness": 0.3, "mirror": False, "splashes": False, "spray": False, "keep_light": True,
}  # fmt: skip
"""Another value of each option."""

BEHIND_GLASS = {"wiper", "glass_wet_s", "glass_dirt", "contact_angle_deg", "glass_distance_m"}
ASKING = {"mirror": True, "splashes": True, "spray": True, "lamps": "headlights"}
"""Values that ask for what the base has already, or for what another value switches off."""


def everything() -> Scene:
    """A wet street with a puddle, a lamp, a roof before the camera and a fast car."""
    scene = street()
    soaked = tuple(replace(layer, wet_sh=layer.gaussians.sh - np.float32(0.1)) for layer in scene.layers)
    wall = patch((30, -20, 0), np.array([0, 40.0, 0]), np.array([0, 0, 12.0]), 24, (0.8, 0.7, 0.6))
    roof = patch((1, -4, 4), np.array([6.0, 0, 0]), np.array([0, 8.0, 0]), 24, (0.3, 0.3, 0.3))
    cover = np.full((48, 120, 2), 200, np.uint8)
    cover.flags.writeable = False
    layers = (*soaked, Layer("wall", wall, wet_sh=wall.sh.copy()), Layer("roof", roof, wet_sh=roof.sh.copy()))
    lamp = Lamp(position=(10.0, 3.0, 3.0), intensity_m2=8.0)
    return replace(scene, layers=layers, water=GroundWater((0.0, -12.0), 0.5, cover), lamps=(lamp,))


SCENE = everything()
PHOTO = np.random.default_rng(3).integers(0, 255, (VIEW.camera.height, VIEW.camera.width, 3), np.uint8)
DEPTH = np.full(PHOTO.shape[:2], 25.0, np.float32)
PHOTOS = {
    "measured": Photograph(PHOTO, Distances(VIEW.camera, DEPTH, np.ones(DEPTH.shape, bool))),
    "level road": Photograph(PHOTO, Distances(VIEW.camera, DEPTH)),
}
SUNNY = capture_of(street_photo())


def of_scene(rain: RainSettings) -> bytes:
    frame = FrameInput.of(SCENE, RainSimulation.start(rain), SKY, VIEW)
    return draw(CpuRenderer(), frame).read_uint8().tobytes()


def of_plan(rain: RainSettings) -> bytes:
    core = find_scene_core(SCENE)
    camera = scaled_camera(core, orientation(SCENE, "ortho"), core.middle, (192, 128), 3.0)
    frame = FrameInput.of(SCENE, RainSimulation.start(rain), SKY, replace(VIEW, camera=camera))
    return draw(CpuRenderer(), frame).read_uint8().tobytes()


def of_photograph(kind: str):
    def drawn(rain: RainSettings) -> bytes:
        world = Scene("world")
        frame = FrameInput.of(world, RainSimulation.start(rain), SKY, VIEW, photograph=PHOTOS[kind])
        return draw(CpuRenderer(), frame).read_uint8().tobytes()

    return drawn


def of_capture(rain: RainSettings) -> bytes:
    frame = CapturePhotos(SUNNY).frame(SUNNY[0], RainSimulation.start(rain))
    return draw(CpuRenderer(), frame).read_uint8().tobytes()


def of_gaussians(rain: RainSettings) -> bytes:
    simulation = RainSimulation.start(rain.without_medium)
    frame = simulation.frame(VIEW.time_s, rain_camera(SCENE, simulation, VIEW), SKY.at(1.0))
    found = frame.gaussians
    return b"".join(each.tobytes() for each in (found.means, found.scales, found.opacities, found.sh))


def of_page(rain: RainSettings) -> bytes:
    camera = VIEW.camera
    sequence = FrameSequence(SCENE, RainSimulation.start(rain), camera, camera.width, camera.height)
    with TemporaryDirectory() as folder:
        deque(write_page(CpuRenderer(), SCENE, rain, sequence, "Path", Path(folder, "page.html")), maxlen=0)
        return Path(folder, "page.html").read_bytes()


RINGS = msgspec.structs.replace(SENSORS["32"], azimuth_step_deg=3.0, azimuth_limit_deg=60.0)
TURN = next(scene_turns(replace(SCENE, ego=track([0.0, 10.0], [(0, 0, 1.5), (1, 0, 1.5)])), RINGS, [VIEW.time_s]))


def of_lidar(rain: RainSettings) -> bytes:
    (run,) = rain_runs(TURN, rain, (rain.intensity_mm_h,), (rain.seed,), answer="strongest", wet_road=True)
    return run.rainy.sweep.points_m.tobytes()


SOURCES = {
    "scene": ("scene", of_scene),
    "orthographic pictures of a scene": ("plan", of_plan),
    "photographs with distances": ("photographs", of_photograph("measured")),
    "photographs without": ("photographs", of_photograph("level road")),
    "sunny photographs of a capture": ("photographs", of_capture),
    "Gaussians": ("Gaussians", of_gaussians),
    "page": ("page", of_page),
    "lidar": ("lidar", of_lidar),
}


def test_every_option_of_the_rain_is_in_the_table():
    assert set(CHANGES) == OPTIONS
    for reasons in UNAVAILABLE.values():
        assert set(reasons) <= set(RainSettings.__struct_fields__)


@pytest.mark.parametrize("source", SOURCES)
def test_no_option_is_taken_and_ignored(source):
    kind, drawn = SOURCES[source]
    as_lit = {"keep_light"} if drawn is not of_capture else set()  # the others are in their own light anyway
    before: dict[RainSettings, bytes] = {}
    silent = []
    for field, value in CHANGES.items():
        base = BASE
        if field in BEHIND_GLASS and kind not in ("Gaussians",):
            base = msgspec.structs.replace(BASE, glass="windshield")
        elif field == "haze" and kind == "Gaussians":
            base = msgspec.structs.replace(BASE, haze="gaussians")
        rain = msgspec.structs.replace(base, **{field: value})
        asked = {field: ASKING.get(field, value)}
        try:
            check_available(asked, msgspec.structs.replace(base, **asked), kind)
        except ValueError as error:
            assert str(error).startswith(f"{option_names(RainSettings)[field]}: ")
            continue
        if base not in before:
            before[base] = drawn(base)
        try:
            if drawn(rain) == before[base]:
                silent.append(field)
        except ValueError as error:  # a value that the source can't have, where it has others
            assert str(error).startswith(field)
    assert set(silent) == (as_lit if kind == "photographs" else set())


def test_what_asks_for_nothing_is_no_error():
    for field in ("mirror", "splashes", "spray", "roofs"):
        check_available({field: False}, BASE, "photographs")
    check_available({"glass": "none", "lamps": "none"}, BASE, "page")


@pytest.mark.parametrize(
    ("changes", "words"),
    [({"wiper": "low"}, "--wiper: only a windshield"), ({"glass_dirt": 0.5}, "--glass-dirt: there is no glass"),
     ({"streak_gain": 2.0, "streaks": False}, "--streak-gain: no streaks")],
)  # fmt: skip
def test_what_needs_another_setting_says_which(changes, words):
    with pytest.raises(ValueError, match=words):
        check_available(changes, msgspec.structs.replace(BASE, **changes))
    wiped = msgspec.structs.replace(BASE, glass="windshield", wiper="low")
    check_available({"wiper": "low"}, wiped)
