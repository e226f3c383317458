"""Time of a rainy frame of the built-in street by number of lamps: light of lamps costs by lamps and pixels.

Prints JSON: the least of some frames, which take turns, in ms of time and of processor time. Lamps stand on both
sides of the road, half of them with a cone.
"""

import argparse
import json
import time
from dataclasses import replace

import numpy as np

from gsrain_engine.backends import open_renderer
from gsrain_engine.editor.viewport.camera import default_path
from gsrain_engine.rain.frame import SkyLight
from gsrain_engine.rain.settings import load_preset
from gsrain_engine.rain.simulation import RainSimulation
from gsrain_engine.render.draw import draw
from gsrain_engine.render.frame_input import FrameInput
from gsrain_engine.render.renderer import Renderer
from gsrain_engine.render.sequence import FrameSequence
from gsrain_engine.render.view import RenderView
from gsrain_engine.scene.lamps import Lamp
from gsrain_engine.scene.open import load_built_in
from gsrain_engine.scene.scene import Scene

NIGHT = SkyLight.uniform((0.05, 0.05, 0.06))


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--backend", default="cpu")
    parser.add_argument("--sizes", default="320x200,1280x800")
    parser.add_argument("--lamps", default="0,8,64")
    parser.add_argument("--frames", type=int, default=5)
    chosen = parser.parse_args()
    street, rows = load_built_in(), []
    for size in chosen.sizes.split(","):
        width, height = map(int, size.split("x"))
        path = default_path(street, width, height)
        rainfall = RainSimulation.start(load_preset("8.5"))
        shot = FrameSequence(street, rainfall, path, width, height, start_s=2.0).shot(0)
        counts = map(int, chosen.lamps.split(","))
        scenes = {count: replace(street, lamps=lamps_before(shot, count)) for count in counts}
        with open_renderer(chosen.backend) as renderer:
            for count, shortest in shortest_ms(renderer, scenes, rainfall, shot, chosen.frames).items():
                rows.append({"size": size, "lamps": count, "ms": shortest[0], "processor_ms": shortest[1]})
    print(json.dumps({"backend": chosen.backend, "rows": rows}, indent=1))


def lamps_before(shot: RenderView, count: int) -> tuple[Lamp, ...]:
    """Lamps at both sides of the road ahead, from 5 to 85 m."""
    eye, ahead = shot.camera.position, shot.camera.world_to_camera[2, :3]
    side = np.cross(ahead, (0.0, 0.0, 1.0))
    lamps: list[Lamp] = []
    for k in range(count):
        x, y, z = (eye + (5 + 80 * k / count) * ahead + (6 if k % 2 else -6) * side).tolist()
        cone = 40.0 if k % 4 < 2 else 180.0
        lamps.append(Lamp(position=(x, y, z + 2), intensity_m2=40.0, inner_deg=cone / 2, outer_deg=cone))
    return tuple(lamps)


def shortest_ms(
    renderer: Renderer, scenes: dict[int, Scene], rainfall: RainSimulation, shot: RenderView, frames: int
) -> dict[int, tuple[float, float]]:
    """Shortest time and processor time of a frame of each scene that is read, after one that compiles the kernels."""
    times: dict[int, list[tuple[float, float]]] = {count: [] for count in scenes}
    for _ in range(frames + 1):
        for count, scene in scenes.items():
            start, used = time.perf_counter(), time.process_time()
            draw(renderer, FrameInput.of(scene, rainfall, NIGHT, shot))
            renderer.read_uint8()
            times[count].append((time.perf_counter() - start, time.process_time() - used))
    shortest = {count: np.min(drawn[1:], axis=0) for count, drawn in times.items()}
    return {
        count: (round(1000 * float(each[0]), 1), round(1000 * float(each[1]), 1)) for count, each in shortest.items()
    }


if __name__ == "__main__":
    main()
