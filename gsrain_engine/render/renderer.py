"""Renderer interface: images, render modes, statistics, timing, and the description of the machine."""

import os
import platform
import time
from collections.abc import Callable, Generator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import partial
from importlib import metadata
from pathlib import Path
from typing import NamedTuple, Protocol, no_type_check, runtime_checkable

import numpy as np
from jaxtyping import Float32, UInt8

from ..choices import RenderMode
from ..kernels import kernel, range_of
from ..rain.frame import RainFrame
from ..scene.camera import Camera
from ..scene.scene import DrawItem
from ..threads import kernel_threads
from ..water.mirror import LensMirror, Mirror


@dataclass(slots=True)
class RenderStatistics:
    """Element counts and stage times of the last frame."""

    gaussians: int = 0
    splats_drawn: int = 0
    drops_drawn: int = 0
    """Number of drops drawn as streaks; each is one to `RainSettings.max_copies` Gaussians."""
    haze_drawn: int = 0
    """Number of haze Gaussians passed to the renderer."""
    pairs_left_out: int = 0
    """Number of pairs of tile and splat without room, in an image that was shown but not read. The next has room."""
    stages_ms: dict[str, float] = field(default_factory=dict[str, float])
    """Wall time per stage: project, sort, draw (including GPU work, since each stage waits for its result)."""


# Images


class PictureFilter(NamedTuple):
    """Effect on a drawn picture on the way to the stored one, such as glass or a sensor."""

    name: str
    """That of its pass."""
    picture: Callable[[UInt8[np.ndarray, "h w 3"]], UInt8[np.ndarray, "h w 3"]]


Color = tuple[float, float, float]  # red, green, blue as display values (sRGB-encoded), 0 to 1


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """Rendered image before tone mapping: premultiplied display color, unclamped."""

    rgba: Float32[np.ndarray, "h w 4"]
    """Premultiplied display color (sRGB-encoded) and alpha, top row first."""
    depth: Float32[np.ndarray, "h w"] | None = None
    """Expected depth of the scene along the view axis in meters, without rain; 0 where empty.

    Through a lens it is the distance from the camera.
    """
    filters: tuple[PictureFilter, ...] = ()
    """Effects on the 8-bit image, such as glass and sensor; floats are without them."""
    rough_depth: "Callable[[], Float32[np.ndarray, 'h w']] | None" = None
    """Computes a depth of the scene from what the image was made of, also where `depth` would be drawn for itself."""

    def over(self, background: Color = (0.0, 0.0, 0.0)) -> Float32[np.ndarray, "h w 3"]:
        alpha = self.rgba[..., 3:]
        return self.rgba[..., :3] + (1 - alpha) * np.asarray(background, np.float32)

    def to_uint8(self, background: Color = (0.0, 0.0, 0.0)) -> UInt8[np.ndarray, "h w 3"]:
        """Return the 8-bit image over a plain background, rounded to nearest, as the camera stores it."""
        pixels = np.empty((*self.rgba.shape[:2], 3), np.uint8)
        _quantize(np.ascontiguousarray(self.rgba, np.float32), np.array(background, np.float32), pixels)
        for each in self.filters:
            pixels = each.picture(pixels)
        return pixels

    def to_rgba8(self) -> UInt8[np.ndarray, "h w 4"]:
        """Return the 8-bit image with straight alpha; color is that of the covered share, black where there is none."""
        alpha = np.clip(self.rgba[..., 3:], 0, 1)
        color = np.clip(self.rgba[..., :3] / np.maximum(alpha, 1e-6), 0, 1) * (alpha > 0)
        return np.rint(255 * np.concatenate([color, alpha], axis=-1)).astype(np.uint8)


@kernel(parallel=True, error_model="numpy")
@no_type_check
def _quantize(portion, rgba, background, pixels):
    """Write the 8-bit image over a background: every video frame is converted here."""
    zero, one, top = np.float32(0), np.float32(1), np.float32(255)
    red, green, blue = background[0], background[1], background[2]
    for row in range_of(portion, pixels.shape[0]):
        for column in range(pixels.shape[1]):
            color, pixel = rgba[row, column], pixels[row, column]
            behind = one - color[3]
            pixel[0] = np.int32(np.rint(min(max(zero, color[0] + behind * red), one) * top))
            pixel[1] = np.int32(np.rint(min(max(zero, color[1] + behind * green), one) * top))
            pixel[2] = np.int32(np.rint(min(max(zero, color[2] + behind * blue), one) * top))


PendingImage = Callable[[], UInt8[np.ndarray, "h w 3"]]
"""Waits for an image that is being read back, and returns it."""


@runtime_checkable
class Renderer(Protocol):
    """Interface of the renderers: `SplatRenderer` (OpenGL) and `CpuRenderer`."""

    @property
    def name(self) -> str: ...

    @property
    def draws_lenses(self) -> bool:
        """True if cameras may have lenses and rolling shutters."""
        ...

    @property
    def statistics(self) -> RenderStatistics: ...

    def draw(
        self,
        parts: Sequence[DrawItem],
        camera: Camera,
        rain: RainFrame | None = None,
        *,
        with_depth: bool = False,
        mode: RenderMode = "splats",
        mirror: Mirror | LensMirror | None = None,
    ) -> None:
        """Draw parts and rain as one depth-ordered compositing; `read` returns the image.

        `camera` is in the world (meters). Depth is the scene's own, without rain. `mode` selects another render mode,
        without rain. The visible water on the parts, their `film`, adds what it reflects of a `mirror`.
        """
        ...

    def read(self) -> Frame: ...

    def read_uint8(self, background: Color = (0.0, 0.0, 0.0)) -> UInt8[np.ndarray, "h w 3"]:
        """Return what `read().to_uint8(background)` would; on a GPU the image is converted before it is read back."""
        ...

    def request_uint8(self, background: Color = (0.0, 0.0, 0.0)) -> PendingImage:
        """Start to read the last image back as `read_uint8` does, so that the next one can be drawn meanwhile."""
        ...


@runtime_checkable
class PictureSource(Protocol):
    """Source of a picture's pixels: a renderer, or bands of its pictures."""

    def read(self) -> Frame: ...

    def read_uint8(self, background: Color = (0.0, 0.0, 0.0)) -> UInt8[np.ndarray, "h w 3"]: ...

    def request_uint8(self, background: Color = (0.0, 0.0, 0.0)) -> PendingImage: ...


@dataclass(frozen=True, slots=True, eq=False)
class DrawnPicture:
    """A picture as it was drawn, to be read before its renderer draws the next one."""

    renderer: Renderer
    source: PictureSource
    filters: tuple[PictureFilter, ...]
    passes_ms: dict[str, float]
    """Time of each pass, and of reading the picture."""
    compose: Callable[[Frame], UInt8[np.ndarray, "h w 3"]] | None = None
    """Puts what was drawn before a photograph; None for pictures of scenes."""

    @property
    def rows_ms(self) -> dict[str, float]:
        """Time of each pass, of each stage of the renderer, and of reading, once that is done."""
        rows = dict(self.passes_ms)
        for stage, milliseconds in self.renderer.statistics.stages_ms.items():
            rows[stage] = rows.get(stage, 0.0) + milliseconds
        return rows

    def frame(self) -> Frame:
        """Return premultiplied floats, and depth if it was asked for, with the filters of the 8-bit image."""
        with timed(self.passes_ms, "read"):
            return replace(self.source.read(), filters=self.filters)

    def read_uint8(self, background: Color = (0.0, 0.0, 0.0)) -> UInt8[np.ndarray, "h w 3"]:
        """Return the 8-bit image (sRGB) over a plain background, as the camera stores it."""
        return self.request_uint8(background)()

    def request_uint8(self, background: Color = (0.0, 0.0, 0.0)) -> PendingImage:
        """Start to read the image back as `read_uint8` does, so that the next one can be drawn meanwhile."""
        if self.compose is None:
            pending = self.source.request_uint8(background)
        else:
            pending = partial(self.compose, self.source.read())
        return partial(self._stored, pending)

    def _stored(self, pending: PendingImage) -> UInt8[np.ndarray, "h w 3"]:
        with timed(self.passes_ms, "read"):
            pixels = pending()
        for each in self.filters:
            with timed(self.passes_ms, each.name):
                pixels = each.picture(pixels)
        return pixels


NEAREST_M, FARTHEST_M = 0.5, 200.0
"""Range of the depth colors: each octave is distinct for small captures and for streets."""

MAX_FRAGMENTS = 256  # upper end of the overdraw colors
MIN_WEIGHT = np.float32(0.5)  # minimum alpha of pixels with depth


@contextmanager
def timed(stages_ms: dict[str, float], stage: str) -> Generator[None]:
    """Add the wall time of a `with` block to a stage."""
    start = time.perf_counter()
    yield
    stages_ms[stage] = stages_ms.get(stage, 0.0) + 1000 * (time.perf_counter() - start)


# Machine


def describe_machine() -> dict[str, str | int]:
    """Processor, operating system, and versions that affect speed."""
    return {
        "cpu": processor_name(),
        "cores": len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1,
        "threads": kernel_threads(),
        "platform": platform.platform(),
        "python": platform.python_version(),
        **{name: metadata.version(name) for name in ("numpy", "numba", "moderngl")},
    }


def processor_name() -> str:
    listing = Path("/proc/cpuinfo")  # Linux only
    lines = listing.read_text().splitlines() if listing.exists() else []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor() or platform.machine()
