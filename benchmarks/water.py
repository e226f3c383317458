"""Cost of the mirror of wet ground and of water on glass: frames of the built-in street at 8.5 mm/h, in turn.

Prints JSON: the shortest time of each frame and the shortest processor time of all threads in ms, means over frames,
without both, with the mirror, and with a windshield. Interleaved, so that the load of the machine acts on all alike.

    .venv/bin/python -m benchmarks.water [--backend cpu] [--size 960x640] [--rounds 7]
"""

import argparse
import json
import time

import msgspec
import numpy as np

from gsrain_engine.backends import open_renderer
from gsrain_engine.editor.viewport.camera import default_path
from gsrain_engine.rain.settings import load_preset
from gsrain_engine.rain.simulation import RainSimulation
from gsrain_engine.render.sequence import FrameSequence
from gsrain_engine.scene.open import load_drawable_scene

FRAMES = 0, 60, 120, 180
KINDS = {
    "neither": {"mirror": False, "glass": "none"},
    "mirror": {"mirror": True, "glass": "none"},
    "glass": {"mirror": False, "glass": "windshield"},
}


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--backend", default="cpu")
    parser.add_argument("--scene", default="street")
    parser.add_argument("--size", default="960x640")
    parser.add_argument("--rounds", type=int, default=7)
    chosen = parser.parse_args()
    width, height = map(int, chosen.size.split("x"))
    scene = load_drawable_scene(chosen.scene)
    path = default_path(scene, width, height)
    sequences: dict[str, FrameSequence] = {}
    for name, changes in KINDS.items():
        rainfall = RainSimulation.start(msgspec.structs.replace(load_preset("8.5"), **changes))
        sequences[name] = FrameSequence(scene, rainfall, path, width, height)
    times = {name: np.full((2, len(FRAMES)), np.inf) for name in KINDS}
    with open_renderer(chosen.backend) as renderer:
        sky = sequences["neither"].sky(renderer)
        for round_ in range(chosen.rounds + 1):
            for k, number in enumerate(FRAMES):
                for name, sequence in sequences.items():
                    # The past of a frame's glass is that of the frame before: a video's frames follow each other.
                    if name == "glass":
                        sequence.image(renderer, number - 1 if number else 0, sky)
                    start = np.array([time.perf_counter(), time.process_time()])
                    sequence.image(renderer, number, sky)
                    spent = np.array([time.perf_counter(), time.process_time()]) - start
                    if round_ > 0:
                        times[name][:, k] = np.minimum(times[name][:, k], spent)
    ms, processor_ms = ({name: 1000 * float(each[row].mean()) for name, each in times.items()} for row in range(2))
    print(
        json.dumps(
            {
                "scene": chosen.scene, "backend": chosen.backend, "size": chosen.size,
                "frame_ms": {name: round(each, 1) for name, each in ms.items()},
                "frame_processor_ms": {name: round(each, 1) for name, each in processor_ms.items()},
                "mirror_over_neither": round(ms["mirror"] / ms["neither"], 3),
                "glass_ms": round(ms["glass"] - ms["neither"], 1),
                "glass_processor_ms": round(processor_ms["glass"] - processor_ms["neither"], 1),
            },
            indent=1,
        )
    )  # fmt: skip


if __name__ == "__main__":
    main()
