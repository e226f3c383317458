"""Rain in front of photographs, as the camera would have stored it: light, noise, signal processing and JPEG."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Float32, Float64, UInt8

from gsrain_engine.rain.frame import SkyLight
from gsrain_engine.rain.settings import RainSettings
from gsrain_engine.rain.simulation import RainSimulation
from gsrain_engine.render.camera_response import jpeg_of, light_of_display, stored_jpeg, to_levels, tone_curve
from gsrain_engine.render.cpu.renderer import CpuRenderer
from gsrain_engine.render.signal_processing import processed, with_chroma_noise
from gsrain_engine.render.view import RenderView, rain_camera
from gsrain_engine.scene.camera import Camera
from gsrain_engine.scene.scene import Scene
from gsrain_engine.scene.sensor import Sensor

Window = tuple[int, int, int, int]  # left, top, width, height of a part of an image, in pixels
_NO_SCENE = Scene("no scene", (), up=(0.0, 0.0, 1.0))


def cropped_camera(camera: Camera, window: Window) -> Camera:
    """Return the camera of a window of this one's image."""
    x, y, width, height = window
    return replace(camera, cx=camera.cx - x, cy=camera.cy - y, width=width, height=height)


def rain_shares(
    camera: Camera, rainfall: RainSimulation, times_s: Sequence[float]
) -> Iterator[Float32[np.ndarray, "h w"]]:
    """Render the rain's share of each pixel at each time, as the renderer composites it: 0 without rain."""
    renderer = CpuRenderer()
    for time_s in times_s:
        shot = RenderView(camera, time_s=float(time_s))
        view = rain_camera(_NO_SCENE, rainfall, shot)
        renderer.draw([], camera, rainfall.frame(shot.time_s, view, SkyLight.uniform((1.0, 1.0, 1.0))))
        yield renderer.read().rgba[..., 3].copy()


def rain_over(
    background: Float32[np.ndarray, "h w *c"],
    share: Float32[np.ndarray, "h w"],
    drop_levels: float | Float64[np.ndarray, "3"] | Float32[np.ndarray, "h w 3"],
    rain: RainSettings,
    sensor: Sensor | None,
) -> Float32[np.ndarray, "h w *c"]:
    """Return by how many gray levels rain changes a photographed background (gray levels), luma or color.

    `drop_levels` is a drop's display level (0-255), the same or one for each pixel. With W the rain's share of a pixel,
    B the background and S the drop's light: enc((1 - W) dec(B) + W S) - B, with the tone curve of the sensor; or a mix
    of display values, as in the paper.
    """
    curve = "srgb" if sensor is None else sensor.tone_curve
    levels, drop = np.linspace(0, 1, 1 << 12), np.atleast_1d(np.asarray(drop_levels, np.float64)) / 255
    if not rain.is_paper:
        behind = light_of_display(levels, curve).astype(np.float32)
        light = light_of_display(drop, curve).astype(np.float32)
        shown = (255 * tone_curve(np.linspace(0, 1, 1 << 15), curve)).astype(np.float32)
    else:
        behind, light = levels.astype(np.float32), drop.astype(np.float32)
        shown = np.linspace(0, 255, 1 << 15, dtype=np.float32)
    before = behind[np.rint(np.clip(background / 255, 0, 1) * (len(behind) - 1)).astype(np.int32)]
    alpha = share if background.ndim == 2 else share[..., None]
    steps = [np.rint(np.clip(each, 0, 1) * (len(shown) - 1)).astype(np.int32)
             for each in (before, before + alpha * (light - before))]  # fmt: skip
    return shown[steps[1]] - shown[steps[0]]


def render_rain_frames(
    background: UInt8[np.ndarray, "h w"],
    noise_levels: Float32[np.ndarray, "h w"],
    camera: Camera,
    rainfall: RainSimulation,
    times_s: Sequence[float],
    drop_levels: float,
) -> Iterator[UInt8[np.ndarray, "h w"]]:
    """Render gray frames of a static camera (world: meters, z up) with a background behind all rain and white noise.

    See `rain_over`; tone curve and JPEG are those of a sensor that the rain names. Noise has the rain's seed.
    """
    behind, sensor, random = background.astype(np.float32), rainfall.picture_sensor, noise_of(rainfall.rain)
    for share in rain_shares(camera, rainfall, times_s):
        rise = rain_over(behind, share, drop_levels, rainfall.rain, sensor)
        noise = noise_levels * random.standard_normal(noise_levels.shape, np.float32)
        gray = to_levels(behind + rise + noise)
        yield gray if sensor is None or sensor.jpeg_quality is None else stored_jpeg(gray, sensor.jpeg_quality)


def noise_of(rain: RainSettings) -> np.random.Generator:
    """Return the source of noise, which has the rain's seed."""
    return np.random.default_rng(rain.seed)


class StoredPhoto(NamedTuple):
    """Picture as a camera stores it, in color and as luma."""

    color: UInt8[np.ndarray, "h w 3"]
    luma: UInt8[np.ndarray, "h w"]


def photographed(
    background: Float32[np.ndarray, "h w 3"],
    rise: Float32[np.ndarray, "h w 3"],
    noise_levels: Float32[np.ndarray, "h w"],
    sensor: Sensor | None,
    random: np.random.Generator | None = None,
    chroma_noise: float | Float32[np.ndarray, "h w 1"] = 1.0,
) -> StoredPhoto:
    """Add rain and noise to a photographed background (display color, gray levels) as a camera stores them.

    The background has been through the camera once; rain and noise, of a standard deviation of `noise_levels` in each
    channel, go through its signal processing, see `processed`. Then come rounding and the sensor's JPEG. The noise of
    color differences is multiplied by `chroma_noise` besides the sensor's own factor. Without a source of random
    numbers the background has its noise already. Its levels below 0, which a camera clips at black, hide faint rain.
    """
    signal = rise
    if random is not None:
        amplified = chroma_noise if sensor is None else sensor.chroma_noise * chroma_noise
        noise = noise_levels[..., None] * random.standard_normal(rise.shape, np.float32)
        signal = rise + with_chroma_noise(noise, amplified)
    if sensor is None or not sensor.processes_signal:
        color = to_levels(background + signal)
    else:
        color = to_levels(processed(signal, noise_levels, sensor, background))
    if sensor is None or sensor.jpeg_quality is None:
        return StoredPhoto(color, cv2.cvtColor(color, cv2.COLOR_RGB2GRAY))
    file = jpeg_of(color, sensor.jpeg_quality)
    stored, luma = (np.asarray(cv2.imdecode(file, mode)) for mode in (cv2.IMREAD_COLOR, cv2.IMREAD_GRAYSCALE))
    return StoredPhoto(np.ascontiguousarray(stored[..., ::-1]), luma)
