"""`gsrain render SCENE -o OUT`: pictures and videos without a window."""

import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Literal

import msgspec
from cyclopts import Parameter

from gsrain_engine.rain.presets import load_preset
from gsrain_engine.rain.rain import Rain
from gsrain_engine.rain.rainfall import Rainfall
from gsrain_engine.render.backends import Backend, open_renderer
from gsrain_engine.render.frame_sink import FrameSink, open_sink
from gsrain_engine.render.look import Look
from gsrain_engine.render.renderer import Renderer
from gsrain_engine.render.sequence import FrameSequence
from gsrain_engine.scene.camera import Camera, read_camera
from gsrain_engine.scene.camera_path import CameraPath
from gsrain_engine.scene.camera_path_files import read_camera_path
from gsrain_engine.scene.scene import Scene
from gsrain_engine.session.home_camera import default_path, front_camera, home_camera
from gsrain_engine.session.open_scene import open_to_draw
from gsrain_engine.session.rainy_look import rainy_scene

from .arguments import JsonFile, parse_size, write_numbers
from .progress import progress_bar

_LONGEST_DEFAULT_S = 10.0
_UP = {
    "x": (1.0, 0.0, 0.0), "-x": (-1.0, 0.0, 0.0),
    "y": (0.0, 1.0, 0.0), "-y": (0.0, -1.0, 0.0),
    "z": (0.0, 0.0, 1.0), "-z": (0.0, 0.0, -1.0),
}  # fmt: skip


@Parameter(name="*")  # its fields are options of the command, without a prefix
@dataclass(frozen=True, kw_only=True)
class RainOptions:
    """Rain on the command line."""

    rain: Annotated[float | None, Parameter(help="Rainfall intensity in mm/h, 0..100; calibrated up to 13.")] = None
    preset: Annotated[
        str | None, Parameter(help="clear, 1.2, 8.5, 12.0, paper, or a preset file; other options go on top.")
    ] = None
    seed: Annotated[int | None, Parameter(help="Same seed and time, same drops.")] = None
    exposure: Annotated[float | None, Parameter(help="Shutter time in seconds; default: the camera's own.")] = None
    closure: Annotated[
        Literal["density", "published"] | None,
        Parameter(help="density: as many drops as the intensity needs; published: the paper's table as it is."),
    ] = None
    calibration: Annotated[
        str | None, Parameter(help="Name of a shipped calibration, or a file that gsrain calibrate wrote.")
    ] = None
    roofs: Annotated[bool | None, Parameter(help="Keep rain from under bridges, canopies and trees.")] = None
    haze: Annotated[bool | None, Parameter(help="Draw far drops as haze.")] = None
    streaks: Annotated[bool | None, Parameter(help="Draw near drops as streaks.")] = None

    def for_scene(self, scene: Scene) -> Rain:
        """Preset, else the rain saved with the scene, else none; then what was asked for on top."""
        if self.preset is not None:
            rain = load_preset(self.preset)
        else:
            rain = msgspec.convert(scene.rain, Rain) if scene.rain is not None else Rain()
        asked = {
            "intensity_mm_h": self.rain,
            "seed": self.seed,
            "exposure_s": self.exposure,
            "closure": self.closure,
            "calibration": self.calibration,
            "roofs": self.roofs,
            "haze": self.haze,
            "streaks": self.streaks,
        }
        values = msgspec.to_builtins(rain) | {name: value for name, value in asked.items() if value is not None}
        return msgspec.convert(values, Rain)


def render(
    scene: Annotated[str | None, Parameter(help="Scene file or folder; without one, the built-in street.")] = None,
    /,
    *,
    output: Annotated[
        Path, Parameter(name=["--output", "-o"], help="PNG, NPY, MP4, WebM, or a folder for PNG frames.")
    ],
    rain: RainOptions | None = None,
    camera: Annotated[Path | None, Parameter(help="Camera file (JSON) in the scene's own units and axes.")] = None,
    camera_path: Annotated[
        Path | None, Parameter(help="Camera path: ours, nerfstudio's camera_path.json or 3DGS's cameras.json.")
    ] = None,
    size: Annotated[
        str | None, Parameter(help="WIDTHxHEIGHT in pixels; default 960x640, or the camera file's.")
    ] = None,
    fps: Annotated[float, Parameter(help="Frames a second.")] = 30.0,
    duration: Annotated[
        float | None, Parameter(help="Seconds of video; default: the path's length, at most 10.")
    ] = None,
    time: Annotated[float, Parameter(help="Moment of the first frame in seconds.")] = 0.0,
    frame: Annotated[int | None, Parameter(help="Render only this frame of the sequence, counted from 0.")] = None,
    depth: Annotated[bool, Parameter(help="Write depth beside each PNG (16 bit, cm) or NPY (m).")] = False,
    look: Annotated[
        Look, Parameter(help="What to show: the picture (splats), or without rain what it is made of.")
    ] = "splats",
    wet: Annotated[bool, Parameter(help="First give the scene a wet look, as the window's preview job does.")] = False,
    up: Annotated[
        Literal["x", "-x", "y", "-y", "z", "-z"] | None,
        Parameter(help="Which way is up in the scene's axes.", allow_leading_hyphen=True),
    ] = None,
    metres_per_unit: Annotated[float | None, Parameter(help="Length of one scene unit in metres.")] = None,
    backend: Annotated[Backend, Parameter(help="auto takes OpenGL on a GPU, else the processor.")] = "auto",
    json: JsonFile = None,
) -> int:
    """Render a scene in its rain: a still, a video, frames, or raw floats (premultiplied, before tone mapping)."""
    width, height = parse_size(size) if size else (960, 640)
    _check(fps=fps, duration=duration, frame=frame, metres_per_unit=metres_per_unit)
    opened = _oriented(open_to_draw(scene), up, metres_per_unit)
    falling = Rainfall.start((rain or RainOptions()).for_scene(opened))
    if wet:
        opened = _made_rainy(opened)
    viewpoint = _viewpoint(opened, camera, camera_path, size, width, height, moving=_is_moving(output))
    if isinstance(viewpoint, Camera):
        width, height = viewpoint.width, viewpoint.height
    sequence = FrameSequence(opened, falling, viewpoint, width, height, fps, time)
    numbers = _frame_numbers(output, sequence, duration, frame)
    with open_renderer(backend) as renderer, open_sink(output, width, height, fps, with_depth=depth) as sink:
        report = _render(renderer, sequence, numbers, sink, depth, look)
    written = " and ".join(str(path) for path in sink.written)
    print(f"{written}: {report['frames']} of {len(numbers)} frames, {width}x{height}, {_describe(falling)}")
    write_numbers(json, report | {"backend": renderer.name})
    return 0 if report["frames"] == len(numbers) else 130


def _render(
    renderer: Renderer, sequence: FrameSequence, numbers: list[int], sink: FrameSink, depth: bool, look: Look
) -> dict[str, object]:
    """Render frames into a sink; Ctrl-C ends it early and leaves what is there."""
    started, done = time.perf_counter(), 0
    state = sequence.rainfall.state
    with progress_bar("Rendering", len(numbers)) as advance:
        try:
            sky = sequence.sky(renderer)
            for rendered in sequence.render(renderer, numbers, sky, with_depth=depth, look=look):
                sink.write(rendered.number, rendered.frame)
                done += 1
                advance()
        except KeyboardInterrupt:
            print(f"stopped after {done} frames")
    return {
        "frames": done,
        "seconds": time.perf_counter() - started,
        "splats": renderer.statistics.splats_drawn,
        "drops": state.drops,
        "drops_drawn": renderer.statistics.drops_drawn,
        "haze_gaussians": renderer.statistics.haze_drawn,
        "intensity_mm_h": state.intensity_mm_h,
        "implied_mm_h": state.implied_mm_h,
        "table_implied_mm_h": state.table_implied_mm_h,
    }


def _describe(rainfall: Rainfall) -> str:
    state, rain = rainfall.state, rainfall.rain
    if state.intensity_mm_h == 0:
        return "clear"
    words = [f"{state.intensity_mm_h:g} mm/h asked, {state.implied_mm_h:.3g} mm/h drawn, {state.drops:,} drops"]
    if state.beyond_calibration:
        words.append("beyond calibration")
    return ", ".join([*words, *filter(None, [rain.exaggeration])])


def _check(*, fps: float, duration: float | None, frame: int | None, metres_per_unit: float | None) -> None:
    if not 0.1 <= fps <= 1000:
        raise ValueError(f"--fps {fps:g}: must be within 0.1..1000")
    if duration is not None and not 0 < duration <= 36000:
        raise ValueError(f"--duration {duration:g}: must be above 0 and at most 36000 s")
    if frame is not None and frame < 0:
        raise ValueError(f"--frame {frame}: must be 0 or more")
    if metres_per_unit is not None and not 1e-6 <= metres_per_unit <= 1e6:
        raise ValueError(f"--metres-per-unit {metres_per_unit:g}: must be within 0.000001..1000000")


def _oriented(scene: Scene, up: str | None, metres_per_unit: float | None) -> Scene:
    if up is not None:
        scene = replace(scene, up=_UP[up])
    return scene if metres_per_unit is None else replace(scene, metres_per_unit=metres_per_unit)


def _made_rainy(scene: Scene) -> Scene:
    with progress_bar("Wet look", 1) as advance:
        last = 0.0
        for progress, changed in rainy_scene(scene):
            advance(progress.fraction - last)
            last, scene = progress.fraction, changed
    return scene


def _is_moving(output: Path) -> bool:
    return output.suffix.lower() not in (".png", ".npy")


def _viewpoint(
    scene: Scene,
    camera: Path | None,
    camera_path: Path | None,
    size: str | None,
    width: int,
    height: int,
    *,
    moving: bool,
) -> Camera | CameraPath:
    """What the options ask for, in the world; by default the ego's drive, or a swing around the scene's middle."""
    if camera is not None and camera_path is not None:
        raise ValueError("--camera and --camera-path exclude each other")
    if camera is not None:
        read = read_camera(camera)
        return (read.resized(width, height) if size else read).moved(scene.scene_to_world)
    if camera_path is not None:
        return read_camera_path(camera_path).moved(scene.scene_to_world)
    if moving or front_camera(scene) is not None:
        return default_path(scene, width, height)
    return home_camera(scene, width, height)


def _frame_numbers(output: Path, sequence: FrameSequence, duration: float | None, frame: int | None) -> list[int]:
    if frame is not None:
        return [frame]
    if not _is_moving(output):
        return [0]
    if duration is None:
        length = _LONGEST_DEFAULT_S
        if isinstance(sequence.camera, CameraPath):
            length = min(length, sequence.camera.duration_s - sequence.start_s)
        duration = max(length, 1 / sequence.fps)
    return list(range(max(1, round(duration * sequence.fps))))
