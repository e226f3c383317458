"""Cost of water where it lands, in frames of the built-in street: mirror; rings, splashes and spray; water on glass.

Each frame is drawn without water, with the mirror, and with rings, splashes and spray as well, in turn, so that the
load of the machine acts on all alike; then what glass adds to the last one is measured by itself, as it is far less
than such a load. Prints JSON: for each rain rate, means over frames of their shortest times over all rounds, of the
wall and of the processor (all threads).

    .venv/bin/python -m benchmarks.water [--rain 8.5,50] [--threads 1] [--rounds 12]
"""

import argparse
import json
import os
import time
from collections.abc import Generator, Sequence
from contextlib import contextmanager
from typing import Any

import cv2
import msgspec
import numpy as np

from gsrain_engine.backends import open_renderer
from gsrain_engine.editor.viewport.camera import default_path
from gsrain_engine.rain.settings import RainSettings, load_preset
from gsrain_engine.rain.simulation import RainSimulation
from gsrain_engine.render.draw import filters_of
from gsrain_engine.render.frame_input import FrameInput
from gsrain_engine.render.renderer import Renderer
from gsrain_engine.render.sequence import FrameSequence
from gsrain_engine.scene.open import load_drawable_scene

FRAMES = range(60, 64)
"""Frames of a video. The first one is a warm-up: the water on its glass comes from far, that of others from the one
before."""

NO_WATER = {"mirror": False, "splashes": False, "spray": False, "glass": "none"}
PICTURES = {
    "no water": NO_WATER,
    "mirror": NO_WATER | {"mirror": True},
    "mirror, rings, splashes, spray": {"mirror": True, "splashes": True, "spray": True, "glass": "none"},
}
GLASS = "windshield", "lens"


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--backend", default="cpu")
    parser.add_argument("--scene", default="street")
    parser.add_argument("--size", default="960x640")
    parser.add_argument("--rain", default="8.5", help="rain rates in mm/h")
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--rounds", type=int, default=12)
    chosen = parser.parse_args()
    os.environ["NUMBA_NUM_THREADS"] = str(chosen.threads)
    cv2.setNumThreads(chosen.threads)
    rows: list[dict[str, object]] = []
    with open_renderer(chosen.backend) as renderer:
        for intensity in map(float, chosen.rain.split(",")):
            rain = msgspec.structs.replace(load_preset("8.5"), intensity_mm_h=intensity)
            shortest = shortest_ms(renderer, rain, chosen.scene, tuple(map(int, chosen.size.split("x"))), chosen.rounds)
            rows.append({"intensity_mm_h": intensity, **costs(shortest)})
    options = {name: getattr(chosen, name) for name in ("scene", "backend", "size", "threads", "rounds")}
    print(json.dumps({**options, "rows": rows}, indent=1))


def shortest_ms(
    renderer: Renderer, rain: RainSettings, scene_name: str, size: tuple[int, ...], rounds: int
) -> dict[str, np.ndarray]:
    """Shortest times of each frame (columns), of wall and processor (rows), by kind of picture and of glass."""
    scene = load_drawable_scene(scene_name)
    width, height = size
    path = default_path(scene, width, height)

    def sequence_of(changes: dict[str, Any]) -> FrameSequence:
        rainfall = RainSimulation.start(msgspec.structs.replace(rain, **changes))
        return FrameSequence(scene, rainfall, path, width, height)

    pictures = {kind: sequence_of(changes) for kind, changes in PICTURES.items()}
    behind = {kind: sequence_of({"glass": kind}) for kind in GLASS}
    sky = pictures["no water"].sky(renderer)
    clock = Clock((*pictures, *behind))
    for clock.round in range(rounds + 1):
        for clock.column, number in enumerate(FRAMES):
            image = np.zeros((height, width, 3), np.uint8)
            for kind, sequence in pictures.items():
                with clock.measured(kind):
                    image = sequence.image(renderer, number, sky)
            for kind, sequence in behind.items():
                frame = sequence.frame_input(sequence.shot(number), sky)  # which a picture without glass needs, too
                with clock.measured(kind):
                    through_glass(renderer, frame, image)
    return {kind: each[:, 1:] for kind, each in clock.shortest.items()}


class Clock:
    """Shortest times in ms of wall and processor (rows) of each frame (columns), by kind."""

    def __init__(self, kinds: Sequence[str]) -> None:
        self.shortest = {kind: np.full((2, len(FRAMES)), np.inf) for kind in kinds}
        self.round = self.column = 0

    @contextmanager
    def measured(self, kind: str) -> Generator[None]:
        """Measure what is done in the context; the first round compiles, and does not count."""
        before = np.array([time.perf_counter(), time.process_time()])
        yield
        if self.round > 0:
            spent = 1000 * (np.array([time.perf_counter(), time.process_time()]) - before)
            times = self.shortest[kind]
            times[:, self.column] = np.minimum(times[:, self.column], spent)


def through_glass(renderer: Renderer, frame: FrameInput, image: np.ndarray) -> np.ndarray:
    """All that glass adds to a frame: water on it up to its time, the view behind drops, and the picture through it."""
    (glass,) = filters_of(renderer, frame)
    return glass.picture(image)


def costs(shortest: dict[str, np.ndarray]) -> dict[str, object]:
    """Pictures in ms, what water adds to the first of them in percent, and what glass adds in ms."""
    found: dict[str, object] = {}
    for row, clock in enumerate(("wall", "processor")):
        ms = {kind: float(each[row].mean()) for kind, each in shortest.items()}
        plain, mirror, landed = (ms[kind] for kind in PICTURES)
        found[clock] = {
            "picture_ms": {kind: round(ms[kind], 1) for kind in PICTURES},
            "mirror_percent": round(100 * (mirror - plain) / plain, 1),
            "rings_splashes_spray_percent": round(100 * (landed - mirror) / plain, 1),
            "glass_ms": {kind: round(ms[kind], 2) for kind in GLASS},
        }
    return found


if __name__ == "__main__":
    main()
