"""Choice of the renderer: the fastest way on a GPU, the CPU elsewhere."""

import hashlib
import time
from collections.abc import Generator
from contextlib import contextmanager, suppress
from importlib import metadata
from pathlib import Path
from typing import get_args

import moderngl
import msgspec
import platformdirs

from .choices import Backend
from .compile_cache import has_kernels
from .render.cpu.renderer import CpuRenderer
from .render.opengl.context import NoOpenGLError, can_draw_scenes, check_context, is_software, lack_of, open_context
from .render.opengl.renderer import Rasterizer, SplatRenderer
from .render.renderer import Renderer, processor_name
from .safe_io.files import whole_file
from .safe_io.text_files import read_whole
from .scene.open import random_scene, random_scene_camera


@contextmanager
def open_renderer(backend: Backend = "auto") -> Generator[Renderer]:
    """Open a renderer without a window while the block runs. Several may be open and take turns.

    `opengl` and `auto` take what `measure_device` found to be the fastest. Where OpenGL is a software rasterizer or
    missing, `auto` takes the `cpu` back end, which draws the same image several times faster.

    Raises:
        ValueError: For any other name.
        NoOpenGLError: When OpenGL was requested and is not available.
        LostContextError: When the GPU is lost while the block runs.
    """
    if backend not in (choices := get_args(Backend)):
        raise ValueError(f"back end {backend!r}: expected {', '.join(choices)}")
    if backend == "cpu":
        yield CpuRenderer()
        return
    try:
        context = open_context()
    except NoOpenGLError:
        if backend != "auto":
            raise
        yield CpuRenderer()
        return
    try:
        with context:
            speed = measure_device(context) if backend in ("auto", "opengl") else DeviceSpeed()
            if backend == "auto" and speed.is_cpu_fastest:
                renderer = CpuRenderer()
            else:
                renderer = SplatRenderer(context, activates=True, rasterizer=rasterizer_for(backend, speed))
        yield renderer
    except Exception:
        with context:
            check_context(context)  # the lost context is the cause of any other error
        raise
    finally:
        context.release()


def device_of(renderer: Renderer) -> str:
    """Name the device that executes a renderer's drawing."""
    if isinstance(renderer, SplatRenderer):
        return renderer.context.info["GL_RENDERER"]
    return processor_name()


# Speed of a device


_TIMED_SCENE, _TIMED_SIZE = "random-200k", (960, 640)
_UNTIMED_FRAMES, _TIMED_FRAMES = 3, 5
_FAST_MS = 15.0  # an OpenGL frame this fast needs no comparison with a CPU whose kernels would have to be compiled


class DeviceSpeed(msgspec.Struct, frozen=True, kw_only=True):
    """Times of a frame on one device and driver, by back end; empty if OpenGL is not timed."""

    frame_ms: dict[str, float] = {}
    """Shortest wall time with read-back of 200,000 Gaussians at 960x640, by back end."""
    untimed: str = "OpenGL is a software rasterizer here"
    """Reason why it is not."""

    @property
    def rasterizer(self) -> Rasterizer:
        """The faster of the two ways of OpenGL."""
        return "tiles" if self._ms("opengl-tiles") < self._ms("opengl-quads") else "quads"

    @property
    def is_cpu_fastest(self) -> bool:
        """True if `auto` takes the CPU."""
        return not self.frame_ms or self._ms("cpu") < self._ms(f"opengl-{self.rasterizer}")

    @property
    def reason(self) -> str:
        """Times of which the choice is the result, in a few words."""
        if not self.frame_ms:
            return self.untimed
        times = sorted(self.frame_ms.items(), key=lambda each: each[1])
        return ", ".join(f"{name} {milliseconds:.1f} ms" for name, milliseconds in times) + " per frame"

    def _ms(self, backend: str) -> float:
        return self.frame_ms.get(backend, float("inf"))


def measure_device(context: moderngl.Context) -> DeviceSpeed:
    """Time tiles, quads and CPU on the current context, once per device, driver and version; later calls remember it.

    Nothing is timed on a software rasterizer, or where OpenGL draws no scenes.
    """
    if not can_draw_scenes(context):
        return DeviceSpeed(untimed=lack_of(context))
    if is_software(context):
        return DeviceSpeed()
    file = _speed_file(context)
    with suppress(OSError, ValueError):  # unknown yet, or damaged: timed again
        return msgspec.json.decode(read_whole(file), type=DeviceSpeed)
    speed = _timed(context)
    with suppress(OSError), whole_file(file) as whole:
        whole.write_bytes(msgspec.json.encode(speed))
    return speed


def rasterizer_for(backend: Backend, speed: DeviceSpeed) -> Rasterizer:
    """Way of OpenGL for a requested back end."""
    ways: dict[Backend, Rasterizer] = {"opengl-tiles": "tiles", "opengl-quads": "quads"}
    return ways.get(backend, speed.rasterizer)


def _speed_file(context: moderngl.Context) -> Path:
    names = (*(context.info[name] for name in ("GL_RENDERER", "GL_VERSION")), processor_name())
    key = hashlib.sha256("\n".join((*names, metadata.version("gsrain"))).encode()).hexdigest()[:16]
    return Path(platformdirs.user_cache_dir("gsrain", appauthor=False)) / "devices" / f"{key}.json"


def _timed(context: moderngl.Context) -> DeviceSpeed:
    frame_ms = {f"opengl-{each}": time_frame_ms(SplatRenderer(context, rasterizer=each)) for each in ("tiles", "quads")}
    if has_kernels() or min(frame_ms.values()) > _FAST_MS:
        frame_ms["cpu"] = time_frame_ms(CpuRenderer())
    return DeviceSpeed(frame_ms=frame_ms)


def time_frame_ms(renderer: Renderer) -> float:
    """Return the shortest time in ms of some frames of a random scene, each with its read-back."""
    scene = random_scene(_TIMED_SCENE)
    parts, camera = scene.parts(0.0), random_scene_camera(scene, *_TIMED_SIZE)
    times_s: list[float] = []
    for _ in range(_UNTIMED_FRAMES + _TIMED_FRAMES):
        start = time.perf_counter()
        renderer.draw(parts, camera)
        renderer.read()
        times_s.append(time.perf_counter() - start)
    return 1000 * min(times_s[_UNTIMED_FRAMES:])
