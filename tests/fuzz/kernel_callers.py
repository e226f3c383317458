"""Callers of compiled kernels with hostile numbers in scenes, cameras, rain and times.

A kernel checks no index, so that one beyond an array ends the process, or reads what is there. By hand, with checks:
NUMBA_BOUNDSCHECK=1 NUMBA_CACHE_DIR=out/checked python -m tests.fuzz --pictures 1000
"""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from random import Random
from typing import Any

import numpy as np
from msgspec import structs

from gsrain_engine.backends import open_renderer
from gsrain_engine.editor.viewport.camera import home_camera
from gsrain_engine.evaluation.lidar.scan import scan_in_rain, scan_scene
from gsrain_engine.evaluation.lidar.sensor import SENSORS
from gsrain_engine.rain.settings import RainSettings
from gsrain_engine.rain.simulation import RainSimulation
from gsrain_engine.render.renderer import Renderer
from gsrain_engine.render.sequence import render_image
from gsrain_engine.scene.lamps import Lamp
from gsrain_engine.scene.scene import Scene
from tests.publish.test_page import rainy_scene

HOSTILE = (np.nan, np.inf, -np.inf, 0.0, 1e308, -1e308, 1e30, 1e12, 1e-308, -1.0, 2.0**31, 2.0**63)
_SIZE = 48, 32
_RAINS = (
    RainSettings(intensity_mm_h=8.5, seed=1), RainSettings(intensity_mm_h=50.0, visibility_m=200.0),
    RainSettings(intensity_mm_h=20.0, glass="windshield", sensor="automotive"), RainSettings(haze="gaussians"),
)  # fmt: skip
_NUMBERS = tuple(name for name in structs.fields(RainSettings) if isinstance(name.default, float))
_REFUSALS = (ValueError, OverflowError, MemoryError, TypeError)


class KernelCallers:
    """A wet scene with lamps, and what is computed of it."""

    def __init__(self, renderer: Renderer) -> None:
        self.renderer = renderer
        lamp = Lamp(name="lamp", position=(6.0, 1.0, 4.0), intensity_m2=50.0)
        self._scenes = (rainy_scene(), replace(rainy_scene(), lamps=(lamp,)))
        self._camera = home_camera(self._scenes[0], *_SIZE)

    def call(self, chance: Random) -> str:
        """Draw, or scan, with one to three hostile numbers; returns "drawn", or the refusal's first words.

        With checked kernels, raises `SystemError` or `IndexError` for an index beyond an array.
        """
        scene, rain, camera, time_s = chance.choice(self._scenes), chance.choice(_RAINS), self._camera, chance.random()
        with np.errstate(all="ignore"):
            try:
                if chance.random() < 0.6:
                    scene = _hostile_scene(scene, chance)
                if chance.random() < 0.4:
                    camera = _hostile_camera(camera, chance)
                if chance.random() < 0.3:
                    rain = structs.replace(rain, **{chance.choice(_NUMBERS).name: chance.choice(HOSTILE)})
                if chance.random() < 0.1:
                    time_s = chance.choice(HOSTILE)
                if chance.random() < 0.2:
                    self._scan(scene, rain, time_s, chance)
                else:
                    render_image(self.renderer, scene, rain, camera, time_s, with_depth=True)
            except _REFUSALS as error:
                return str(error)[:40] or type(error).__name__
        return "drawn"

    def _scan(self, scene: Scene, rain: RainSettings, time_s: float, chance: Random) -> None:
        pose = np.eye(4)
        pose[:3, 3] = 2.0, 0.0, 2.0
        if chance.random() < 0.3:
            pose[chance.randrange(3), chance.randrange(4)] = chance.choice(HOSTILE)
        sensor = next(iter(SENSORS.values()))
        own = np.array([[1.0, 0, 0], [0, 1, 0], [-1, 0, 0], [0.8, 0, -0.6], [0, 0, 1]])
        if chance.random() < 0.3:
            own[chance.randrange(len(own)), chance.randrange(3)] = chance.choice(HOSTILE)
        scan_in_rain(scan_scene(scene, time_s, pose, sensor, own=own), sensor, RainSimulation.start(rain), pose)


def _hostile_scene(scene: Scene, chance: Random) -> Scene:
    """A scene some of whose Gaussians have a hostile number, as arrays of a program may."""
    layers = [*scene.layers]
    at = chance.randrange(len(layers))
    gaussians = layers[at].gaussians
    name = chance.choice(("means", "scales", "quaternions", "opacities", "sh"))
    values = getattr(gaussians, name).copy()
    rows = values.reshape(len(values), -1)
    for _ in range(chance.choice((1, 20))):
        rows[chance.randrange(len(rows)), chance.randrange(rows.shape[1])] = chance.choice(HOSTILE)
    changes: dict[str, Any] = {name: values}
    layers[at] = replace(layers[at], gaussians=replace(gaussians, **changes))
    return replace(scene, layers=tuple(layers))


def _hostile_camera(camera: Any, chance: Random) -> Any:
    name = chance.choice(("world_to_camera", "fx", "fy", "cx", "cy", "exposure_s"))
    if name != "world_to_camera":
        return replace(camera, **{name: chance.choice(HOSTILE)})
    pose = camera.world_to_camera.copy()
    pose[chance.randrange(3), chance.randrange(4)] = chance.choice(HOSTILE)
    return replace(camera, world_to_camera=pose)


@contextmanager
def kernel_callers() -> Iterator[KernelCallers]:
    """Callers, drawn by the processor."""
    with open_renderer("cpu") as renderer:
        yield KernelCallers(renderer)
