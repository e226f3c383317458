"""Time to select among 1 M Gaussians, by tool. Prints JSON, and a line per tool on the way."""

import argparse
import json
import sys
import time
from collections.abc import Callable, Mapping

import numpy as np

from gsrain_engine.compile_cache import use_kernel_cache

use_kernel_cache()

from gsrain_engine.editor.edits.gaussians import CropBox  # noqa: E402
from gsrain_engine.editor.selection import screen  # noqa: E402
from gsrain_engine.editor.selection.attributes import (  # noqa: E402
    ATTRIBUTES,
    AttributeHistogram,
    select_attribute_range,
)
from gsrain_engine.editor.selection.candidates import (  # noqa: E402
    base_color,
    combine_selection,
    inverted,
    select_similar_colors,
)
from gsrain_engine.editor.selection.screen import (  # noqa: E402
    ALL_THROUGH,
    DepthMode,
    select_in_screen_shape,
)
from gsrain_engine.editor.selection.volume import (  # noqa: E402
    Sphere,
    flood_select,
    in_volume,
    near_selection,
)
from gsrain_engine.editor.viewport.picking import (  # noqa: E402
    PickResult,
    pick,
    pick_point,
)
from gsrain_engine.render.view import RenderView  # noqa: E402
from gsrain_engine.scene.flags import BitMask  # noqa: E402
from gsrain_engine.scene.open import (  # noqa: E402
    random_scene,
    random_scene_camera,
)
from gsrain_engine.scene.scene import Scene  # noqa: E402

WIDTH, HEIGHT = 1280, 800
TOLERANCE, REACH, NEAR_M = 0.15, 2.0, 0.05


def least_ms(work: Callable[[], object], repeats: int) -> float:
    work()  # compiles, or loads what was compiled
    times: list[float] = []
    for _ in range(repeats):
        start = time.perf_counter()
        work()
        times.append(time.perf_counter() - start)
    return 1000 * min(times)


def tools(scene: Scene, shot: RenderView) -> dict[str, Callable[[], Mapping[str, BitMask]]]:
    angles = np.linspace(0, 2 * np.pi, 400)
    lasso = [(640 + (300 + 60 * np.sin(9 * a)) * np.cos(a), 400 + 250 * np.sin(a)) for a in angles.tolist()]
    stroke = [(200 + 4 * k, 400 + 100 * np.sin(k / 20)) for k in range(200)]
    middle = (np.array([0.0, 0, 14, 1]) @ scene.scene_to_world.T)[:3]
    center = (float(middle[0]), float(middle[1]), float(middle[2]))
    picked = under_the_middle(scene, shot)
    color = base_color(scene.parts()[0], picked.gaussian)

    def rectangle() -> np.ndarray:
        return screen.rectangle((300, 200), (1000, 700), WIDTH, HEIGHT)

    def by_shape(
        pixels: Callable[[], np.ndarray], reach: DepthMode = ALL_THROUGH
    ) -> Callable[[], Mapping[str, BitMask]]:
        return lambda: select_in_screen_shape(scene, shot, pixels(), reach)

    found: dict[str, Callable[[], Mapping[str, BitMask]]] = {
        "rectangle": by_shape(rectangle),
        "lasso": by_shape(lambda: screen.polygon(lasso, WIDTH, HEIGHT)),
        "brush": by_shape(lambda: screen.stroke(stroke, 24, WIDTH, HEIGHT)),
        "rectangle to a depth": by_shape(rectangle, DepthMode("to a depth", 10.0)),
        "rectangle touching": by_shape(rectangle, DepthMode(touching=True)),
        "rectangle front-most": by_shape(rectangle, DepthMode("front-most")),
        "sphere": lambda: in_volume(scene, 0.0, Sphere(center, 4.0)),
        "box": lambda: in_volume(scene, 0.0, CropBox(center, (6.0, 4.0, 3.0), 30.0)),
        "color pick": lambda: select_similar_colors(scene, 0.0, color, TOLERANCE),
        "flood": lambda: flood_select(scene, 0.0, picked.key, picked.gaussian, TOLERANCE, REACH),
    }
    for name in ATTRIBUTES:
        found[f"range of {name}"] = lambda name=name: select_attribute_range(scene, 0.0, shot.camera, name, 0.1, 0.6)
    return found


def under_the_middle(scene: Scene, shot: RenderView) -> PickResult:
    picked = pick(scene, shot, WIDTH / 2, HEIGHT / 2)
    assert picked is not None, "the random scene fills the picture"
    return picked


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scene", default="random-1m", help="a random scene by name")
    parser.add_argument("--repeats", type=int, default=5)
    arguments = parser.parse_args()
    scene = random_scene(arguments.scene)
    shot = RenderView(random_scene_camera(scene, WIDTH, HEIGHT))
    rows: dict[str, dict[str, float]] = {}

    def measure(name: str, work: Callable[[], object], count: int | None = None) -> None:
        rows[name] = {"ms": round(least_ms(work, arguments.repeats), 1)}
        if count is not None:
            rows[name]["found"] = count
        found = "" if count is None else f"  {count:>9,} Gaussians"
        print(f"{name:24} {rows[name]['ms']:8.1f} ms{found}", file=sys.stderr, flush=True)

    for name, find in tools(scene, shot).items():
        found = find()
        measure(
            name, lambda find=find: combine_selection(scene, find(), "set"), sum(mask.size for mask in found.values())
        )
    balled = combine_selection(scene, tools(scene, shot)["sphere"](), "set")
    measure("invert", lambda: inverted(balled))
    measure("grow", lambda: near_selection(balled, 0.0, NEAR_M))
    measure("shrink", lambda: near_selection(balled, 0.0, NEAR_M, inside=True))
    measure("histogram", lambda: AttributeHistogram().of(balled, shot, "hue"))
    measure("pick a point", lambda: pick_point(scene, shot, WIDTH / 2, HEIGHT / 2))
    print(json.dumps({"scene": arguments.scene, "gaussians": scene.gaussian_count, "tools": rows}))


if __name__ == "__main__":
    main()
