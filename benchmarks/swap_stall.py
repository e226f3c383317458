"""Does the picture stall when other Gaussians take a scene's place? Prints JSON, then a line.

A scene of random Gaussians is drawn frame by frame by a turning camera that sees a small part of it. Meanwhile its
Gaussians are swapped as jobs do it: for as many in other colors, for a number of others, and back by undo; then they
get wet colors. A frame is what a window would wait for: the editor's update, drawing, and the picture in its texture.
Beside its wall time stands the processor's time of all threads, which other programs on the same cores disturb less.
"""

import argparse
import json
import time
from dataclasses import replace
from statistics import median
from typing import Any, NamedTuple

import moderngl
import numpy as np

from gsrain_engine.editor.drawing.live_view import LiveView
from gsrain_engine.editor.editor import Editor, WindowBackend
from gsrain_engine.editor.edits.members import replace_scene
from gsrain_engine.editor.viewport_state import PendingScene
from gsrain_engine.rain.settings import load_preset
from gsrain_engine.render.opengl.context import open_context
from gsrain_engine.render.renderer import describe_machine
from gsrain_engine.scene.gaussians import COEFFICIENTS_OF_DEGREE
from gsrain_engine.scene.open import random_scene, random_scene_camera
from gsrain_engine.scene.scene import Scene
from gsrain_engine.scene.transforms import with_wet_colors_of

_BEFORE, _AFTER = 15, 12
"""Frames before each swap, and after it."""
_LONGEST_S = 60.0
_BACKENDS: tuple[WindowBackend, ...] = ("opengl", "cpu")
_FORWARD_M, _FOV_DEG = 18.0, 30.0
"""Inside the scene, close to its far end."""
_TURN_RAD = 0.002


class FrameCost(NamedTuple):
    """Milliseconds on the wall, and of all threads together on the processor."""

    wall_ms: float
    work_ms: float


class Turning:
    """A live view whose camera turns a little each frame."""

    def __init__(self, context: moderngl.Context, editor: Editor, backend: WindowBackend, size: tuple[int, int]):
        self.context, self.editor, self.size = context, editor, size
        self.view = LiveView(context, backend)

    def frame(self) -> "FrameCost":
        """Go on by one frame; what it took."""
        self.editor.viewport.navigation.turn(_TURN_RAD, 0.0)
        start, start_of_work = time.perf_counter(), time.process_time()
        self.editor.tick(1 / 30)
        self.editor.apply(self.view.draw(self.editor.render_input(*self.size)))
        self.context.finish()
        return FrameCost(1000 * (time.perf_counter() - start), 1000 * (time.process_time() - start_of_work))

    def settle(self) -> None:
        """Go on until the back end that was asked for has drawn some frames, and nothing is awaited."""
        until = time.perf_counter() + _LONGEST_S
        while not (self.view.is_settled and not self.editor.is_working):
            self.frame()
            if time.perf_counter() > until:
                raise SystemExit("the live view does not settle")
        for _ in range(_BEFORE):
            self.frame()


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--gaussians", default="1m", help="how many, such as 200k or 1m")
    parser.add_argument("--degree", type=int, default=1, choices=range(4), help="of the spherical harmonics")
    parser.add_argument("--size", default="480x320", help="of the viewport in pixels")
    parser.add_argument("--backends", default=",".join(_BACKENDS))
    parser.add_argument("--budget", action="store_true", help="let detail give way while the camera moves")
    arguments = parser.parse_args()
    width, height = map(int, arguments.size.split("x"))
    scene = with_degree(random_scene(f"random-{arguments.gaussians}"), arguments.degree)
    rows: list[dict[str, object]] = []
    for backend in arguments.backends.split(","):
        for rain in ("clear", "8.5"):
            with open_context() as context:
                rows += measured(context, scene, backend, rain, (width, height), budget=arguments.budget)
            context.release()
    print(json.dumps({"gaussians": scene.gaussian_count, "rows": rows, "machine": describe_machine()}, indent=1))
    worst = max(rows, key=lambda row: float(str(row["work_longest_over_median"])))
    print(
        f"longest frame of a swap over the median one: {worst['wall_longest_over_median']} on the wall, "
        f"{worst['work_longest_over_median']} in work ({worst['backend']}, {worst['rain']}, {worst['swap']})"
    )


def with_degree(scene: Scene, degree: int) -> Scene:
    """The scene with harmonics up to a degree, 0 where it had none."""
    (layer,) = scene.layers
    sh = np.zeros((len(layer.gaussians), COEFFICIENTS_OF_DEGREE[degree], 3), np.float32)
    known = min(sh.shape[1], layer.gaussians.sh.shape[1])
    sh[:, :known] = layer.gaussians.sh[:, :known]
    return replace(scene, layers=(replace(layer, gaussians=layer.gaussians.with_sh(sh)),))


def measured(
    context: moderngl.Context, scene: Scene, backend: WindowBackend, rain: str, size: tuple[int, int], *, budget: bool
) -> list[dict[str, object]]:
    """Times of four swaps with one back end and rain."""
    editor = Editor(scene, load_preset(rain))
    editor.playback.clock.playing = False
    editor.viewport.navigation.look_like(random_scene_camera(scene, *size))
    editor.viewport.navigation.position = (
        editor.viewport.navigation.position + _FORWARD_M * editor.viewport.navigation.forward
    )
    editor.viewport.navigation.vertical_fov_deg = _FOV_DEG
    editor.viewport.budget.enabled = budget
    turning = Turning(context, editor, backend, size)
    g = scene.layers[0].gaussians
    colors = g.with_sh((g.sh * np.float32(0.8)).astype(np.float32))
    fewer = g.take(np.flatnonzero(np.arange(len(g)) % 10))
    swaps: list[tuple[str, dict[str, Any] | None]] = [
        ("other colors", {"gaussians": colors}),
        ("other count", {"gaussians": fewer}),
        ("undo", None),
        ("wet colors", {"wet_sh": g.sh * np.float32(0.5)}),
    ]
    rows: list[dict[str, object]] = []
    try:
        for swap, fields in swaps:
            turning.settle()
            before = [turning.frame() for _ in range(_BEFORE)]
            during = costs_of_swap(turning, fields)
            row: dict[str, object] = {"backend": backend, "rain": rain, "swap": swap, "frames": len(during)}
            for number, clock in enumerate(FrameCost._fields):
                calm, swapping = ([cost[number] for cost in costs] for costs in (before, during))
                name = clock.removesuffix("_ms")
                row |= {
                    f"{name}_before_ms": [round(median(calm), 1), round(max(calm), 1)],
                    f"{name}_during_ms": [round(median(swapping), 1), round(max(swapping), 1)],
                    f"{name}_longest_over_median": round(max(swapping) / median(swapping), 2),
                }
            rows.append(row | {"longest_at": during.index(max(during, key=lambda cost: cost.work_ms))})
    finally:
        editor.close()
    return rows


def costs_of_swap(turning: Turning, fields: dict[str, Any] | None) -> list[FrameCost]:
    """Costs of all frames from the moment a swap of a layer's fields begins (none is undo) until some after its end."""
    editor = turning.editor
    if fields is None:
        editor.document.undo()
    else:
        changed = editor.document.scene.with_member(editor.document.scene.members[0].key, **fields)
        editor.viewport.staged = PendingScene(
            "swap", changed, change=with_wet_colors_of if "wet_sh" in fields else replace_scene
        )
    costs: list[FrameCost] = []
    until, after = time.perf_counter() + _LONGEST_S, 0
    while after < _AFTER and time.perf_counter() < until:
        after = 0 if editor.is_working else after + 1
        costs.append(turning.frame())
    return costs


if __name__ == "__main__":
    main()
