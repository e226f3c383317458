"""Pictures that the window shows while the camera moves: likeness and time. Prints JSON, then a line for each level.

Each level of quality, with fewer Gaussians and with merged details, is compared with the full picture, in 960 x 640
from six places: along the drive of a scene with an ego vehicle, or on an orbit around any other. They are enlarged and
sharpened as on the screen. Time is that of the processor, on one thread, all levels in turns.
"""

import argparse
import json
import time
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float32
from street_sharpness import gradient_energy

from gsrain_engine.editor.drawing.live_trees import LiveCut, LiveTrees
from gsrain_engine.editor.drawing.live_view import SHARPNESS
from gsrain_engine.editor.viewport.camera import OrbitCamera
from gsrain_engine.editor.viewport.options import CUT_LEVELS, FULL_QUALITY, LEVELS, QualityLevel
from gsrain_engine.rain.settings import load_preset
from gsrain_engine.rain.simulation import RainSimulation
from gsrain_engine.render.cpu.renderer import CpuRenderer
from gsrain_engine.render.draw import draw
from gsrain_engine.render.frame_input import FrameInput, Quality
from gsrain_engine.render.level_of_detail import LodSubset
from gsrain_engine.render.renderer import describe_machine
from gsrain_engine.render.sky_color import sky_color
from gsrain_engine.render.view import RenderView
from gsrain_engine.render.view_reuse import ViewReuse
from gsrain_engine.scene.open import load_sorted_scene
from gsrain_engine.scene.rig import rig_camera
from gsrain_engine.scene.scene import Scene, core_bounds
from gsrain_engine.threads import half_of_cores

WIDTH, HEIGHT, PLACES = 960, 640, 6
_BLOCK = 32  # px: side of the blocks whose mean colors are compared
_MIRROR_EVERY = 3
Image = Float32[np.ndarray, "h w 3"]


def views_of(scene: Scene) -> list[RenderView]:
    if scene.ego is not None and scene.rigs:
        rig, cameras = next(iter(scene.rigs.items()))
        times = np.linspace(scene.ego.times[0], scene.ego.times[-1], PLACES + 2)[1:-1].tolist()
        return [RenderView(rig_camera(scene, rig, cameras[0].name, t).resized(WIDTH, HEIGHT), t) for t in times]
    orbit, views = OrbitCamera(), list[RenderView]()
    orbit.frame(core_bounds(scene.parts()))
    for place in range(PLACES):
        orbit.orbit(2 * np.pi / PLACES, 0.0)
        views.append(RenderView(orbit.camera(WIDTH, HEIGHT), 0.1 * place))
    return views


class Pictures:
    """Pictures of a scene in rain, by quality."""

    def __init__(self, scene: Scene, preset: str, place: RenderView) -> None:
        self.scene, self.trees, self.renderer = scene, LiveTrees(), CpuRenderer()
        started = time.perf_counter()
        self.trees.follow([scene], at_once=True)
        self.trees.wait()
        self.trees.follow([scene])
        self.built_s = time.perf_counter() - started
        self._rainfall = RainSimulation.start(load_preset(preset))
        self._sky = sky_color(self.renderer, scene, place.camera).at(self._rainfall.overcast_at(0.0))
        self._subsets = {each.gaussians: LodSubset(each.gaussians) for each in LEVELS if each.gaussians < 1}

    def draw(self, quality: QualityLevel, view: RenderView, reuse: ViewReuse) -> Image:
        whole, scale = view.camera, quality.scale
        camera = whole.resized(round(scale * WIDTH), round(scale * HEIGHT))
        view = replace(view, camera=camera, focal_px=quality.focal_share * whole.fx)
        cut = LiveCut(quality.error_px, self.trees, self._subsets[1 / 8]) if quality.error_px else None
        thinning, reuses = cut or self._subsets.get(quality.gaussians), None if quality.is_exact else reuse
        drawn = Quality(thinning=thinning, reflected=cut and cut.reflected, reuse=reuses)
        draw(self.renderer, FrameInput.of(self.scene, self._rainfall, self._sky, view, drawn))
        return self.renderer.read().over()[..., :3]


def on_the_screen(image: Image, quality: QualityLevel) -> Image:
    """Sharpen and enlarge a picture as the window does."""
    if quality.scale == 1:
        return np.clip(image, 0, 1)
    padded = np.pad(image, ((1, 1), (1, 1), (0, 0)), "edge")
    around = padded[:-2, 1:-1] + padded[2:, 1:-1] + padded[1:-1, :-2] + padded[1:-1, 2:]
    sharp = np.clip(image + np.float32(SHARPNESS) * (image - around / 4), 0, 1)
    return cv2.resize(sharp, (WIDTH, HEIGHT), interpolation=cv2.INTER_LINEAR)


def compared(image: Image, full: Image) -> dict[str, float]:
    """PSNR, gradient energy relative to the full picture, and the difference of mean colors of blocks in levels."""
    difference = image - full
    blocks = difference.reshape(HEIGHT // _BLOCK, _BLOCK, WIDTH // _BLOCK, _BLOCK, 3).mean(axis=(1, 3))
    return {
        "psnr_db": float(-10 * np.log10(max(np.mean(difference**2), 1e-12))),
        "gradient_energy": gradient_energy(image) / gradient_energy(full),
        "block_levels": float(255 * np.sqrt(np.mean(blocks**2))),
    }


def measured(name: str, preset: str, folder: Path | None) -> dict[str, object]:
    scene = load_sorted_scene(name)
    views = views_of(scene)
    pictures = Pictures(scene, preset, views[0])
    levels = [*LEVELS[1:], *CUT_LEVELS[1:]]
    rows: list[list[dict[str, float]]] = [[] for _ in levels]
    for number, view in enumerate(views):
        full = on_the_screen(pictures.draw(FULL_QUALITY, view, ViewReuse(_MIRROR_EVERY)), FULL_QUALITY)
        reuses, times = [ViewReuse(_MIRROR_EVERY) for _ in levels], [list[float]() for _ in levels]
        shown = {"full": full}
        with half_of_cores():
            for _ in range(2 * _MIRROR_EVERY):
                for level, reuse, own in zip(levels, reuses, times, strict=True):
                    started = time.thread_time()
                    image = pictures.draw(level, view, reuse)
                    own.append(1000 * (time.thread_time() - started))
                    shown[str(level)] = on_the_screen(image, level)
        for level, row, own in zip(levels, rows, times, strict=True):
            fastest = float(np.mean([min(own[turn::_MIRROR_EVERY]) for turn in range(_MIRROR_EVERY)]))
            row.append({"processor_ms": fastest, **compared(shown[str(level)], full)})
        for title, image in shown.items() if folder is not None else ():
            file = folder / f"{number}-{title.replace(' ', '_').replace('/', '-')}.png"
            cv2.imwrite(str(file), np.round(255 * image[..., ::-1]).astype(np.uint8))
    found = [
        {"level": str(level), **{key: float(np.mean([each[key] for each in row])) for key in row[0]},
         "worst_psnr_db": min(each["psnr_db"] for each in row)}
        for level, row in zip(levels, rows, strict=True)
    ]  # fmt: skip
    return {
        "scene": name, "gaussians": scene.gaussian_count, "built_s": pictures.built_s,
        "trees_mb": 1e-6 * pictures.trees.nbytes, "rows": found,
    }  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scene", default="street")
    parser.add_argument("--preset", default="8.5", help="of the rain")
    parser.add_argument("--pictures", type=Path, help="folder for the pictures")
    arguments = parser.parse_args()
    if arguments.pictures is not None:
        arguments.pictures.mkdir(parents=True, exist_ok=True)
    result = measured(arguments.scene, arguments.preset, arguments.pictures)
    print(json.dumps(result | {"machine": describe_machine()}, indent=1))
    for row in result["rows"]:
        print(
            f"{row['level']:50} {row['processor_ms']:6.1f} ms {row['psnr_db']:6.2f} dB "
            f"(worst {row['worst_psnr_db']:.2f}), gradient energy {row['gradient_energy']:.2f}, "
            f"blocks {row['block_levels']:.2f}"
        )


if __name__ == "__main__":
    main()
