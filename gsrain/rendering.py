"""Images and videos of a scene in the rain, rendered without a window: as arrays, as files, and in a notebook."""

import atexit
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from functools import cache
from io import BytesIO
from pathlib import Path
from typing import Any, Literal, TypedDict, Unpack

import numpy as np
import PIL.Image
from jaxtyping import Float32, UInt8

from gsrain_engine.backends import open_renderer
from gsrain_engine.choices import Backend
from gsrain_engine.editor.jobs.record import export_scene
from gsrain_engine.editor.viewport.camera import default_path, home_camera
from gsrain_engine.rain.settings import RainSettings as RainSettings
from gsrain_engine.render.export import film_frames
from gsrain_engine.render.export import render_video as film
from gsrain_engine.render.export_settings import DEFAULT_SIZE_PX, ExportSettings
from gsrain_engine.render.images import write_still
from gsrain_engine.render.renderer import Frame
from gsrain_engine.render.sequence import render_image
from gsrain_engine.scene.camera import Camera
from gsrain_engine.scene.camera_path import CameraPath
from gsrain_engine.scene.geometry import srgb_to_linear
from gsrain_engine.scene.progress import Progress
from gsrain_engine.scene.scene import Scene

from .arguments import checked, checked_settings


class Image:
    """A rendered image over black; the last line of a notebook's cell shows it. `np.asarray(image)` is `rgb`."""

    @checked
    def __init__(self, frame: Frame) -> None:
        """Take a frame of a renderer."""
        self.frame = frame
        """Premultiplied display colors with alpha, (H, W, 4) float32, nothing clamped."""

    @property
    def width(self) -> int:
        """Width in pixels."""
        return self.frame.rgba.shape[1]

    @property
    def height(self) -> int:
        """Height in pixels."""
        return self.frame.rgba.shape[0]

    @property
    def rgb(self) -> UInt8[np.ndarray, "h w 3"]:
        """Display colors (sRGB), 0..255, top row first."""
        return self.frame.to_uint8()

    @property
    def linear(self) -> Float32[np.ndarray, "h w 3"]:
        """Linear light with sRGB primaries; 1 is white, highlights can exceed it."""
        return srgb_to_linear(self.frame.over()).astype(np.float32)

    @property
    def alpha(self) -> Float32[np.ndarray, "h w"]:
        """Share of each pixel that scene and rain cover, 0..1."""
        return self.frame.rgba[..., 3]

    @property
    def depth(self) -> Float32[np.ndarray, "h w"]:
        """Depth of the scene along the view axis in meters, without rain; 0 where there is nothing.

        Raises `ValueError` for an image that was rendered without depth.
        """
        if self.frame.depth is None:
            raise ValueError("this image was rendered without depth: pass depth=True")
        return self.frame.depth

    @checked
    def save(self, path: Path | str) -> None:
        """Save as .png, .jpg, .exr (linear light, with depth) or .npy (premultiplied floats), by the ending.

        Missing folders are made. Raises `ValueError` for another ending, `OSError` where it can't be written.
        """
        write_still(path, self.frame)

    def to_pil(self) -> PIL.Image.Image:
        """Return the 8-bit colors as an image of Pillow."""
        return PIL.Image.fromarray(self.rgb)

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> np.ndarray:
        return np.asarray(self.rgb, dtype)

    def __repr__(self) -> str:
        return f"<gsrain.Image {self.width} x {self.height}{'' if self.frame.depth is None else ', with depth'}>"

    def _repr_png_(self) -> bytes:
        file = BytesIO()
        self.to_pil().save(file, format="PNG")
        return file.getvalue()


class Clip(TypedDict, total=False):
    """Settings of a clip; see `frames`."""

    size: tuple[int, int] | None
    fps: float
    start: float
    end: float | None


class VideoClip(Clip, total=False):
    """Settings of a video; see `render_video`."""

    clear_pair: Literal["sunny", "overcast"] | None
    supersampling: int
    motion_blur: int
    quality: int | None


class Renderer:
    """Renders without a window: `with gr.Renderer("cpu") as r: r.render(scene, rain, camera)`.

    It keeps the last scene's Gaussians on the device, so that loops don't upload them again. `gr.render` opens one by
    itself and keeps it. Several threads may share one: they take turns.
    """

    @checked
    def __init__(self, backend: Backend = "auto") -> None:
        """Open a back end: "opengl", "cpu", or "auto": OpenGL on a GPU, else the processor.

        Raises `OSError` or `ValueError`, which say what is missing, where one was asked for that can't be opened.
        """
        self._lock = threading.RLock()
        self._open = ExitStack()
        self._renderer = self._open.enter_context(open_renderer(backend))
        self._is_open = True

    @property
    def backend(self) -> str:
        """Name of the back end that renders."""
        return self._renderer.name

    @checked
    def render(
        self,
        scene: Scene,
        rain: RainSettings | None = None,
        camera: Camera | CameraPath | None = None,
        *,
        size: tuple[int, int] | None = None,
        time: float = 0.0,
        depth: bool = True,
    ) -> Image:
        """Render one image; see `gr.render`."""
        viewpoint = _still_camera(scene, camera, size, time)
        with self._lock:
            self._check_open()
            return Image(render_image(self._renderer, scene, rain or RainSettings(), viewpoint, time, with_depth=depth))

    @checked
    def frames(
        self,
        scene: Scene,
        rain: RainSettings | None = None,
        path: CameraPath | Camera | None = None,
        *,
        depth: bool = False,
        **clip: Unpack[Clip],
    ) -> Iterator[Image]:
        """Render the frames of a clip one by one; see `gr.frames`."""
        export = _export("frames", path, clip)
        with self._lock:
            self._check_open()
            viewpoint = path or default_path(scene, *DEFAULT_SIZE_PX)
            made = film_frames(self._renderer, export, scene, rain or RainSettings(), viewpoint, with_depth=depth)
        return self._frames(made)

    @checked
    def render_video(
        self,
        scene: Scene,
        rain: RainSettings | None,
        path: CameraPath | Camera | None,
        output: Path | str,
        *,
        progress: Callable[[Progress], object] | None = None,
        **clip: Unpack[VideoClip],
    ) -> Path:
        """Render a clip to a file; see `gr.render_video`."""
        export = _export(str(output), path, clip)
        with self._lock:
            self._check_open()
            viewpoint = path or default_path(scene, *DEFAULT_SIZE_PX)
            for step in film(self._renderer, export, scene, rain or RainSettings(), viewpoint):
                if progress is not None:
                    progress(step)
        return export.path

    def close(self) -> None:
        """Free the device; calling it again does nothing."""
        with self._lock:
            self._is_open = False
            self._open.close()

    def __enter__(self) -> "Renderer":
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def __repr__(self) -> str:
        return f"<gsrain.Renderer {self.backend}{'' if self._is_open else ', closed'}>"

    def _frames(self, made: Iterator[Any]) -> Iterator[Image]:
        while True:
            with self._lock:
                self._check_open()
                frame = next(made, None)
            if frame is None:
                return
            yield Image(frame)

    def _check_open(self) -> None:
        if not self._is_open:
            raise ValueError("this Renderer is closed: open another one")


@checked
def render(
    scene: Scene,
    rain: RainSettings | None = None,
    camera: Camera | CameraPath | None = None,
    *,
    size: tuple[int, int] | None = None,
    time: float = 0.0,
    depth: bool = True,
    backend: Backend = "auto",
) -> Image:
    """Render one image of a scene in the rain.

    Args:
        scene: The scene; wet colors, where it has them, come with the rain's wetness.
        rain: The rain; None is none.
        camera: A camera in the world (meters, z up), or a path, of which the camera at `time` is taken; None is the
            scene's home camera.
        size: Width and height in pixels; None is the camera's own size, or 960 x 640 without a camera.
        time: Moment of scene and rain in seconds.
        depth: Whether `Image.depth` is rendered, too.
        backend: "opengl", "cpu", or "auto": OpenGL on a GPU, else the processor. It stays open for the next call.

    Raises:
        ValueError: For a size that is not allowed, and a calibration that the rain names and there is not.
    """
    return _shared(backend).render(scene, rain, camera, size=size, time=time, depth=depth)


@checked
def frames(
    scene: Scene,
    rain: RainSettings | None = None,
    path: CameraPath | Camera | None = None,
    *,
    size: tuple[int, int] | None = None,
    fps: float = 30.0,
    start: float = 0.0,
    end: float | None = None,
    depth: bool = False,
    backend: Backend = "auto",
) -> Iterator[Image]:
    """Render the frames of a clip one by one, and write nothing: `for image in gr.frames(scene, rain, path): ...`.

    Args:
        scene: The scene.
        rain: The rain; None is none.
        path: A camera path in the world; or a camera that stands still; None is the ego vehicle's drive, else an orbit.
        size: Width and height in pixels; None is the camera's own size, or 960 x 640.
        fps: Frames per second.
        start: Moment of the first frame in seconds, of scene, rain and path.
        end: Moment at which the clip ends; None is the end of the path, or 10 s for a camera that stands still.
        depth: Whether `Image.depth` is rendered, too.
        backend: As in `render`.

    Raises:
        ValueError: For settings that are not allowed.
    """
    return _shared(backend).frames(scene, rain, path, size=size, fps=fps, start=start, end=end, depth=depth)


@checked
def render_video(
    scene: Scene,
    rain: RainSettings | None,
    path: CameraPath | Camera | None,
    output: Path | str,
    *,
    size: tuple[int, int] | None = None,
    fps: float = 30.0,
    start: float = 0.0,
    end: float | None = None,
    clear_pair: Literal["sunny", "overcast"] | None = None,
    supersampling: int = 1,
    motion_blur: int = 1,
    quality: int | None = None,
    progress: Callable[[Progress], object] | None = None,
    backend: Backend = "auto",
) -> Path:
    """Render a video, or a folder of frames; the same bytes as `gsrain render` writes.

    Args:
        scene: The scene.
        rain: The rain; None is none.
        path: A camera path in the world; or a camera that stands still; None is the ego vehicle's drive, else an orbit.
        output: .mp4 (H.264) or .webm (VP9); a name without an ending is a folder of PNG frames.
        size: Width and height in pixels, even for videos; None is the camera's own size, or 960 x 640.
        fps: Frames per second.
        start: Moment of the first frame in seconds, of scene, rain and path.
        end: Moment at which the clip ends; None is the end of the path, or 10 s for a camera that stands still.
        clear_pair: Whether to write the same clip without drops and haze, too, as NAME.clear with the same ending:
            "sunny" as the scene is lit, "overcast" in the light and wet colors of the rain.
        supersampling: Render 1..4 times wider and higher, and take the mean.
        motion_blur: Sub-frames, 1..64, over the exposure.
        quality: Constant rate factor, lower is better: 0..51 in .mp4 (default 18), 0..63 in .webm (default 24).
        progress: Called after each frame with `fraction` (0..1), `message`, and at times a `preview` image.
        backend: As in `render`.

    Returns:
        The output as a path.

    Raises:
        ValueError: For settings that are not allowed or contradict each other.
        OSError: When the output can't be written; what was written until then can be played.
    """
    return _shared(backend).render_video(
        scene, rain, path, output, size=size, fps=fps, start=start, end=end, clear_pair=clear_pair,
        supersampling=supersampling, motion_blur=motion_blur, quality=quality, progress=progress,
    )  # fmt: skip


@checked
def export(
    scene: Scene,
    output: Path | str,
    *,
    progress: Callable[[Progress], object] | None = None,
    backend: Backend = "auto",
    **settings: Any,
) -> Path:
    """Export a clip or a still with the rain and the camera path that a scene is saved with, as the Record panel does.

    Args:
        scene: The scene.
        output: See `gsrain render --output`.
        progress: Called after each frame with `fraction` (0..1), `message`, and at times a `preview` image.
        backend: As in `render`.
        settings: Fields of `ExportSettings`, such as `fps`, `size_px`, `cameras` and `passes`.

    Raises:
        ValueError: For settings that are not allowed or contradict each other.
        OSError: When the output can't be written; what was written until then can be played.
    """
    recording = checked_settings(settings | {"output": str(output)}, ExportSettings, {})
    recording.check()
    with open_renderer(backend) as renderer:
        for step in export_scene(renderer, scene, recording):
            if progress is not None:
                progress(step)
    return recording.path


@cache
def _shared(backend: Backend) -> Renderer:
    """Return the shared renderer of this module's functions, opened on first use."""
    renderer = Renderer(backend)
    atexit.register(renderer.close)
    return renderer


def _still_camera(
    scene: Scene, camera: Camera | CameraPath | None, size: tuple[int, int] | None, time: float
) -> Camera:
    width, height = _export("image.png", camera, {"size": size, "start": time}).size_px or DEFAULT_SIZE_PX
    match camera:
        case None:
            return home_camera(scene, width, height)
        case Camera():
            return camera.resized(width, height) if size is not None else camera
        case CameraPath():
            return camera.camera(time, width, height)


def _export(output: str, viewpoint: Camera | CameraPath | None, clip: Clip | VideoClip) -> ExportSettings:
    """Return checked settings of a clip; errors name the argument."""
    own = None if isinstance(viewpoint, Camera) else DEFAULT_SIZE_PX
    values = {_FIELDS.get(name, name): value for name, value in clip.items()} | {"size_px": clip.get("size") or own}
    return checked_settings(values | {"output": output}, ExportSettings, _FIELDS)


_FIELDS = {"size": "size_px", "start": "first_s", "end": "last_s", "clear_pair": "twin"}
"""Fields of `ExportSettings` by argument, if their names differ."""
