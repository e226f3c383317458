"""Share of light that walls keep in rain, against exp(-beta r): prints the table of docs/physics/extinction.md.

A black wall and a white one are drawn with the same drops; their difference in linear light, over that of clear air, is
the transmittance of each pixel, whatever the airlight (Koschmieder 1924). beta is the `extinction_per_m` that
`gsrain render --json` reports, r the length of the pixel's own ray. Without streaks every pixel counts; with streaks
the mean over pixels and independent moments, which has a counting error.

    .venv/bin/python -m benchmarks.transmittance [--backends cpu,opengl] [--moments 48]
"""

import argparse
import json
import tempfile
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64

from app.main import run
from gsrain_engine.backends import open_renderer
from gsrain_engine.evaluation.lidar.sensor import SENSORS
from gsrain_engine.rain.frame import SkyLight
from gsrain_engine.rain.settings import RainSettings
from gsrain_engine.rain.simulation import RainSimulation
from gsrain_engine.render.draw import draw
from gsrain_engine.render.frame_input import FrameInput
from gsrain_engine.render.renderer import Renderer
from gsrain_engine.render.view import RenderView
from gsrain_engine.scene.camera import Camera, look_at
from gsrain_engine.scene.formats.scene_files import write_scene
from gsrain_engine.scene.gaussians import Gaussians, sh_from_color
from gsrain_engine.scene.geometry import linear_to_srgb, srgb_to_linear
from gsrain_engine.scene.scene import Layer, Scene

INTENSITIES_MM_H, DISTANCES_M = (2.5, 8.5, 25.0, 50.0, 100.0), (10.0, 50.0, 161.0, 500.0)
SIZE, FOV_DEG, EYE_M, FOCAL_PX = (150, 100), 30.0, (0.0, 0.0, 1.5), 1200.0
SPACING_PX = 0.7  # between the Gaussians of a wall
FAINT = 0.05
"""Transmittance below which errors are those of the full contrast, not of the transmittance."""
SKY = SkyLight.uniform((0.74, 0.76, 0.78))
STEP_S = 0.5  # between moments: most drops near the camera are then others


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--backends", default="cpu")
    parser.add_argument("--moments", type=int, default=48)
    chosen = parser.parse_args()
    betas = {rate: reported_beta(rate) for rate in INTENSITIES_MM_H}
    rows: list[dict[str, float | str]] = []
    for name in chosen.backends.split(","):
        with open_renderer(name) as renderer:
            for rate in INTENSITIES_MM_H:
                for distance_m in DISTANCES_M:
                    rows.append({"backend": name, "mm_h": rate, "distance_m": distance_m})
                    rows[-1] |= measure(renderer, rate, distance_m, betas[rate], chosen.moments)
    print(json.dumps({"size": SIZE, "fov_deg": FOV_DEG, "rows": rows}, indent=1))


def measure(renderer: Renderer, rate: float, distance_m: float, beta: float, moments: int) -> dict[str, float]:
    """Errors of one wall in one rain: the largest of a pixel without streaks, and that of the mean with streaks."""
    expected = np.exp(-beta * ray_lengths_m(distance_m))
    walls = WallPair(renderer, distance_m)
    plain = walls.transmittance(RainSettings(intensity_mm_h=rate, streaks=False), 0.0)
    drawn = [walls.transmittance(RainSettings(intensity_mm_h=rate), STEP_S * k) for k in range(moments)]
    with_streaks = mean_error(np.array(drawn), expected)
    return {
        "beta_per_km": 1e3 * beta,
        "lidar_per_km": 1e3 * lidar_beta(rate),
        "expected": float(expected.mean()),
        "largest_error": float(np.abs(errors(plain, expected)).max()),
        "error_with_streaks": with_streaks.mean,
        "counting_error": with_streaks.standard_error,
    }


class MeanError(NamedTuple):
    """Mean over independent moments, and its standard error."""

    mean: float
    standard_error: float


def errors(found: Float64[np.ndarray, "*n"], expected: Float64[np.ndarray, "*n"]) -> Float64[np.ndarray, "*n"]:
    """Errors of transmittances: relative, or of the full contrast where less than `FAINT` is left."""
    return (found - expected) / np.where(expected > FAINT, expected, 1.0)


def mean_error(drawn: Float64[np.ndarray, "k h w"], expected: Float64[np.ndarray, "h w"]) -> MeanError:
    """Error of the mean transmittance over pixels and moments; streaks of different moments are independent."""
    each = errors(drawn, np.broadcast_to(expected, drawn.shape)).mean(axis=(1, 2))
    return MeanError(float(each.mean()), float(each.std(ddof=1) / np.sqrt(len(each))))


def reported_beta(rate: float) -> float:
    """Extinction coefficient (1/m) that `gsrain render --json` reports."""
    with tempfile.TemporaryDirectory() as folder:
        scene, numbers = Path(folder) / "wall", Path(folder) / "numbers.json"
        write_scene(wall_scene(10.0, 0.5, wall_camera((15, 10))), scene)
        command = ["render", str(scene), "-o", str(Path(folder) / "wall.png"), "--size", "16x16", "--backend", "cpu"]
        if run([*command, "--no-wet", "--rain", f"{rate:g}", "--json", str(numbers)]):
            raise RuntimeError("gsrain render failed")
        return json.loads(numbers.read_text(encoding="utf-8"))["extinction_per_m"]


def lidar_beta(rate: float) -> float:
    """Extinction coefficient (1/m) from the loss of a lidar's signal between 10 m and 50 m."""
    state, sensor = RainSimulation.start(RainSettings(intensity_mm_h=rate)).state, SENSORS["64"]
    ranges, reflectance = np.array([10.0, 50.0]), np.full(2, 0.2)
    rainy, clear = (sensor.signal(ranges, reflectance, each) for each in (state.extinction_per_m, 0.0))
    return float(np.log(rainy / clear) @ [0.5, -0.5] / 40.0)


# Walls


class WallPair:
    """A black and a white wall across the view, which one camera at rest looks at."""

    def __init__(self, renderer: Renderer, distance_m: float, size: tuple[int, int] = SIZE) -> None:
        self._renderer, self._camera = renderer, wall_camera(size)
        self._scenes = [wall_scene(distance_m, light, self._camera) for light in (0.0, 1.0)]
        self._clear = self._contrast(RainSettings(intensity_mm_h=0.0), 0.0)

    def transmittance(self, rain: RainSettings, time_s: float) -> Float64[np.ndarray, "h w"]:
        """Share of the walls' light that arrives at each pixel."""
        return self._contrast(rain, time_s) / self._clear

    def _contrast(self, rain: RainSettings, time_s: float) -> Float64[np.ndarray, "h w"]:
        simulation, view = RainSimulation.start(rain), RenderView(self._camera, time_s, focal_px=FOCAL_PX)
        lights: list[Float64[np.ndarray, "h w"]] = []
        for scene in self._scenes:
            draw(self._renderer, FrameInput.of(scene, simulation, SKY, view))
            lights.append(srgb_to_linear(self._renderer.read().rgba[..., 1].astype(np.float64)))
        return lights[1] - lights[0]


def wall_camera(size: tuple[int, int] = SIZE) -> Camera:
    """Camera that looks along x; a smaller picture is the middle of a larger one."""
    eye, fov = np.array(EYE_M), 2 * np.arctan(size[1] / SIZE[1] * np.tan(np.radians(FOV_DEG / 2)))
    return Camera.from_fov(
        *size, float(np.degrees(fov)), look_at(eye, eye + (1.0, 0.0, 0.0), np.array([0.0, 0.0, 1.0]))
    )


def wall_scene(distance_m: float, light: float, camera: Camera) -> Scene:
    """Plane across x with a linear light, a little larger than the view."""
    step_m = SPACING_PX * distance_m / camera.fx
    columns, rows = (int(0.62 * pixels / SPACING_PX) for pixels in (camera.width, camera.height))
    y, z = np.meshgrid(np.arange(-columns, columns + 1), np.arange(-rows, rows + 1))
    means = np.stack([np.full(y.size, distance_m), step_m * y.ravel(), EYE_M[2] + step_m * z.ravel()], axis=1)
    count, shade = len(means), float(linear_to_srgb(np.array(light)))
    scales, turns = np.tile([1e-3 * step_m, step_m, step_m], (count, 1)), np.tile([1.0, 0, 0, 0], (count, 1))
    numbers = (np.asarray(each, np.float32) for each in (means, scales, turns, np.full(count, 0.999)))
    gaussians = Gaussians(*numbers, sh_from_color(np.full((count, 3), shade, np.float32)))
    return Scene("wall", (Layer("wall", gaussians),))


def ray_lengths_m(distance_m: float, size: tuple[int, int] = SIZE) -> Float64[np.ndarray, "h w"]:
    """Length of each pixel's ray up to the wall."""
    camera = wall_camera(size)
    x = (np.arange(camera.width) + 0.5 - camera.cx) / camera.fx
    y = (np.arange(camera.height) + 0.5 - camera.cy) / camera.fy
    return distance_m * np.sqrt(1 + x**2 + y[:, None] ** 2)


if __name__ == "__main__":
    main()
