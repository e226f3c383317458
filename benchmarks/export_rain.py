"""Seconds of a picture of `gsrain export-rain`, by stage and with all cores, and how well haze meets lidar.

Depth completed over all pixels is compared with SciPy's own interpolation over the same triangles, which searches the
triangle of each pixel. For accuracy a fifth of the measured pixels is left out of the distances. Prints JSON.

    .venv/bin/python -m benchmarks.export_rain RECORDING [--pictures 6] [--rain 12]
"""

import argparse
import json
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
from scipy.interpolate import LinearNDInterpolator

from gsrain_engine.appearance import capture_photos, overcast_photos
from gsrain_engine.appearance.capture_photos import CapturePhotos
from gsrain_engine.datasets.capture import CaptureFrame
from gsrain_engine.datasets.depth_maps import completed_depth
from gsrain_engine.rain.settings import RainSettings
from gsrain_engine.rain.simulation import RainSimulation
from gsrain_engine.recordings.pictures import PhotoRain
from gsrain_engine.recordings.rainy_recording import open_recording
from gsrain_engine.render.cpu.renderer import CpuRenderer
from gsrain_engine.render.images import jpeg_file
from gsrain_engine.render.photograph import Distances, Photograph
from gsrain_engine.threads import results_in_order

STAGES: dict[str, tuple[Any, str]] = {
    "measured distances": (capture_photos, "measured_depths"),
    "completed distances": (capture_photos, "completed_depths"),
    "softened light": (overcast_photos, "softened_photo"),
    "drops": (CpuRenderer, "draw"),
    "haze": (Distances, "transmittance"),
    "haze and mixing": (Photograph, "in_rain"),
}
"""Functions whose time is taken, by the names of stages."""
SEARCHED = 2  # pictures whose pixels are searched: one can take a minute
LEFT_OUT, LARGE_ERROR = 0.2, 0.05
"""Share of measured pixels left out of the distances, and error of transmittance that counts as large."""


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("recording", type=Path)
    parser.add_argument("--pictures", type=int, default=6)
    parser.add_argument("--rain", type=float, default=12.0)
    chosen = parser.parse_args()
    capture, rain = open_recording(chosen.recording).capture, RainSettings(intensity_mm_h=chosen.rain)
    pictures, views = PhotoRain(CpuRenderer(), capture, rain), capture.views[: chosen.pictures]
    file_of(pictures.begin(views[0]), views[0])  # reads the compiled kernels
    print(json.dumps({
        "pictures": len(views), "size": (views[0].camera.width, views[0].camera.height),
        **seconds(pictures, views),
        "completion": completion(CapturePhotos(capture), views[:SEARCHED], rain),
        "accuracy": accuracy(CapturePhotos(capture), views, rain),
    }, indent=1))  # fmt: skip


def file_of(make: Callable[[np.ndarray], np.ndarray], view: CaptureFrame) -> bytes:
    """Make a picture, from its file to that of the copy."""
    return jpeg_file(make(view.image), capture_photos.COPY_JPEG_QUALITY)


def seconds(pictures: PhotoRain, views: Sequence[CaptureFrame]) -> dict[str, Any]:
    """Seconds of a picture: by one thread, of its stages, and on all cores."""
    spent = dict.fromkeys(STAGES, 0.0)
    with ExitStack() as patches:
        for stage, (place, name) in STAGES.items():
            patches.enter_context(patch.object(place, name, timed(getattr(place, name), spent, stage)))
        wall_s, processor_s = time.perf_counter(), time.process_time()
        for view in views:
            file_of(pictures.begin(view), view)
        one = per_picture(wall_s, processor_s, len(views))
    wall_s, processor_s = time.perf_counter(), time.process_time()
    calls = [(view.name, partial(file_of, pictures.begin(view), view)) for view in views]
    list(results_in_order(calls, pictures.threads))
    stages = {stage: round(total / len(views), 3) for stage, total in spent.items()}
    return {
        "one thread": one,
        "stages_s": stages,
        f"{pictures.threads} threads": per_picture(wall_s, processor_s, len(views)),
    }


def timed(function: Callable[..., Any], spent: dict[str, float], stage: str) -> Callable[..., Any]:
    """Wrap a function so that its seconds add up."""

    def call(*arguments: Any, **options: Any) -> Any:
        start_s = time.perf_counter()
        try:
            return function(*arguments, **options)
        finally:
            spent[stage] += time.perf_counter() - start_s

    return call


def per_picture(wall_s: float, processor_s: float, count: int) -> dict[str, float]:
    """Wall and processor time of each picture since two clock readings, and cores in use."""
    wall_s, processor_s = time.perf_counter() - wall_s, time.process_time() - processor_s
    return {
        "wall_s": round(wall_s / count, 2), "processor_s": round(processor_s / count, 2),
        "cores": round(processor_s / wall_s, 2),
    }  # fmt: skip


def completion(photos: CapturePhotos, views: Sequence[CaptureFrame], rain: RainSettings) -> dict[str, Any]:
    """Seconds of completing depth, and of a search for the triangle of each pixel."""
    own_s, search_s, differences = list[float](), list[float](), list[np.ndarray]()
    for view in views:
        sparse = measured(photos, view, rain)
        start_s = time.perf_counter()
        depth = completed_depth(sparse)
        own_s.append(time.perf_counter() - start_s)
        start_s = time.perf_counter()
        inverse = LinearNDInterpolator(np.argwhere(sparse > 0), 1 / sparse[sparse > 0])(*np.indices(sparse.shape))
        search_s.append(time.perf_counter() - start_s)
        differences.append(np.abs(depth * inverse - 1)[np.isfinite(inverse)])
    return {
        "own_s": np.round(own_s, 3).tolist(), "search_s": np.round(search_s, 3).tolist(),
        "ratio": round(sum(search_s) / sum(own_s), 1),
        "median_difference": float(np.median(np.concatenate(differences))),
    }  # fmt: skip


def measured(photos: CapturePhotos, view: CaptureFrame, rain: RainSettings) -> np.ndarray:
    """Return the measured depths of a photograph, 0 elsewhere."""
    frame = photos.frame(view, RainSimulation.start(rain))
    assert frame.photograph is not None and frame.photograph.distances.measured is not None
    distances = frame.photograph.distances
    return np.where(distances.measured, distances.depth_m, np.float32(0))


def accuracy(photos: CapturePhotos, views: Sequence[CaptureFrame], rain: RainSettings) -> dict[str, float]:
    """Errors of depth and of transmittance at measured pixels that the distances leave out."""
    depth_errors, errors, rainfall = list[np.ndarray](), list[np.ndarray](), RainSimulation.start(rain)
    for number, view in enumerate(views):
        frame = photos.frame(view, rainfall)
        assert frame.photograph is not None and frame.falling is not None and frame.falling.medium is not None
        distances, camera, medium = frame.photograph.distances, frame.falling.view.camera, frame.falling.medium
        known = (
            np.zeros_like(distances.depth_m) if distances.measured is None else distances.measured * distances.depth_m
        )
        rows, columns = np.nonzero(known)
        chosen = np.random.default_rng(number).random(len(rows)) < LEFT_OUT
        rows, columns = rows[chosen], columns[chosen]
        truth, sparse = known[rows, columns], known.copy()
        sparse[rows, columns] = 0
        depth = completed_depth(sparse.astype(np.float32), distances.depth_m == 0)
        depth_errors.append(np.abs(depth[rows, columns] / truth - 1))
        own = distances.camera
        places = np.stack(
            [(columns + 0.5 - own.cx) / own.fx, (rows + 0.5 - own.cy) / own.fy, np.ones_like(rows)], axis=1
        )
        points = places * truth[:, None]
        kept = Distances(own, depth, sparse > 0).transmittance(medium, camera, frame.photograph.pixels)
        u, v = np.nan_to_num(camera.pixels(points), nan=-1).astype(np.int64).T
        inside = (u >= 0) & (v >= 0) & (u < camera.width) & (v < camera.height)
        errors.append(np.abs(kept[v[inside], u[inside]] - medium.transmittance(points)[inside]))
    depth_error, error = np.concatenate(depth_errors), np.concatenate(errors)
    return {
        "depth_median": round(float(np.median(depth_error)), 4),
        "depth_90_percent": round(float(np.quantile(depth_error, 0.9)), 4),
        "transmittance_mean": round(float(error.mean()), 4),
        "transmittance_large": round(float((error > LARGE_ERROR).mean()), 4),
    }


if __name__ == "__main__":
    main()
