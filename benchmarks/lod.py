"""Time, exactness and memory of the level-of-detail cut of a large scene."""

import argparse
import json
import resource
import time

import numpy as np

from gsrain_engine.backends import open_renderer
from gsrain_engine.render.draw import draw
from gsrain_engine.render.frame_input import FrameInput, Quality
from gsrain_engine.render.level_of_detail import LodCut
from gsrain_engine.render.renderer import Frame, describe_machine
from gsrain_engine.render.view import RenderView
from gsrain_engine.scene.camera import Camera
from gsrain_engine.scene.lod_tree import PIXEL
from gsrain_engine.scene.open import load_scene, with_lod_trees
from gsrain_engine.scene.rig import rig_camera
from gsrain_engine.scene.scene import Scene

WIDTH, HEIGHT = 960, 640
BLACK = (0.0, 0.0, 0.0)


def camera_at(scene: Scene, time_s: float) -> Camera:
    rig, cameras = next(iter(scene.rigs.items()))
    return rig_camera(scene, rig, cameras[0].name, time_s).resized(WIDTH, HEIGHT)


def psnr_db(a: Frame, b: Frame) -> float:
    difference = np.clip(a.over(), 0, 1) - np.clip(b.over(), 0, 1)
    return float(-10 * np.log10(max(np.mean(difference**2), 1e-12)))


def resident_mb() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def measured(name: str, times_s: list[float], backend: str, frames: int, pixel: float) -> dict[str, object]:
    """Times of frames with the cut and without, at several times of the drive; peak memory before the latter."""
    empty_mb = resident_mb()
    started = time.perf_counter()
    scene = with_lod_trees(load_scene(name))
    loaded_s = time.perf_counter() - started
    rows: list[dict[str, object]] = []
    with open_renderer(backend) as renderer:

        def frame_ms(camera: Camera, time_s: float, cut: LodCut | None, repeats: int) -> list[float]:
            taken: list[float] = []
            for _ in range(repeats):
                start = time.perf_counter()
                draw(renderer, FrameInput.of(scene, None, BLACK, RenderView(camera, time_s), Quality(thinning=cut)))
                renderer.read()
                taken.append(1000 * (time.perf_counter() - start))
            return taken

        cameras = [camera_at(scene, time_s) for time_s in times_s]
        cuts: list[Frame] = []
        for camera, time_s in zip(cameras, times_s, strict=True):
            taken = frame_ms(camera, time_s, LodCut(pixel), frames + 2)[2:]
            cuts.append(renderer.read())
            rows.append(
                {
                    "time_s": time_s,
                    "frame_ms_median": float(np.median(taken)),
                    "frame_ms_min": min(taken),
                    "splats": renderer.statistics.splats_drawn,
                    "stages_ms": dict(renderer.statistics.stages_ms),
                }
            )
        peak_mb = resident_mb()
        for camera, time_s, row, image in zip(cameras, times_s, rows, cuts, strict=True):
            taken = frame_ms(camera, time_s, None, 2)
            row |= {"all_ms": min(taken), "all_splats": renderer.statistics.splats_drawn}
            row["psnr_db"] = psnr_db(image, renderer.read())
    size_mb = ply_mb(scene)
    return {
        "gaussians": scene.gaussian_count,
        "ply_mb": size_mb,
        "peak_over_ply": peak_mb / size_mb,
        "loaded_s": loaded_s,
        "imports_mb": empty_mb,
        "peak_mb": peak_mb,
        "pixel": pixel,
        "rows": rows,
    }


def ply_mb(scene: Scene) -> float:
    """Size of the scene as PLY files of float32, one for each layer and actor."""
    return sum(4 * len(g) * (14 + 3 * g.sh.shape[1]) for g in (each.gaussians for each in scene.members)) / 2**20


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scene", default="street:long")
    parser.add_argument("--times", default="5,15,25,35,45", help="times of the drive in s")
    parser.add_argument("--backend", default="cpu")
    parser.add_argument("--frames", type=int, default=20)
    parser.add_argument("--pixel", type=float, default=PIXEL, help="error of the cut in pixels")
    arguments = parser.parse_args()
    times_s = [float(each) for each in arguments.times.split(",")]
    result = measured(arguments.scene, times_s, arguments.backend, arguments.frames, arguments.pixel)
    result |= {"machine": describe_machine()}
    print(json.dumps(result, indent=1))


if __name__ == "__main__":
    main()
