"""Measures the frame rate of the window while a capture is reconstructed. Prints JSON, then a line.

The built-in street is drawn frame by frame by a turning camera, as the window does it: alone, then while the job
"Reconstruct" trains on a capture in its own process, then alone again.
"""

import argparse
import json
from pathlib import Path
from statistics import median, quantiles

from swap_stall import FrameCost, Turning

from gsrain_engine.editor.editor import Editor
from gsrain_engine.editor.jobs.training import reconstruction_job
from gsrain_engine.rain.settings import load_preset
from gsrain_engine.render.opengl.context import open_context
from gsrain_engine.render.renderer import describe_machine
from gsrain_engine.scene.open import load_scene
from gsrain_engine.training.settings import load_settings


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("capture", type=Path)
    parser.add_argument("--frames", type=int, default=150)
    parser.add_argument("--size", default="960x640", help="of the viewport in pixels")
    arguments = parser.parse_args()
    width, height = map(int, arguments.size.split("x"))
    with open_context() as context:
        session = Editor(load_scene("street"), load_preset("8.5"))
        turning = Turning(context, session, "auto", (width, height))
        turning.settle()
        found = {"alone": _summary([turning.frame() for _ in range(arguments.frames)])}
        session.start(reconstruction_job(session, arguments.capture, load_settings("laptop", measured_every=0)))
        (job,) = session.jobs
        while job.state == "running" and not job.progress.message.startswith("Step"):
            turning.frame()
        message = job.progress.message
        found["during training"] = _summary([turning.frame() for _ in range(arguments.frames)])
        steps = f"{message} ... {job.progress.message}"
        job.cancel()
        session.close()
    context.release()
    print(json.dumps({"frames": found, "job": steps, "error": job.error, "machine": describe_machine()}, indent=1))
    ratio = found["during training"]["median_ms"] / found["alone"]["median_ms"]
    print(f"a frame during training takes {ratio:.2f} times as long as alone")


def _summary(frames: list[FrameCost]) -> dict[str, float]:
    walls = [each.wall_ms for each in frames]
    return {
        "median_ms": round(median(walls), 1),
        "percentile_95_ms": round(quantiles(walls, n=20)[-1], 1),
        "longest_ms": round(max(walls), 1),
    }


if __name__ == "__main__":
    main()
