"""`gsrain render SCENE -o OUT`: images and videos without a window."""

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
from cyclopts import Parameter
from msgspec import structs

from gsrain_engine.backends import Backend, open_renderer
from gsrain_engine.editor.jobs.record import own_path
from gsrain_engine.editor.viewport.camera import front_camera, home_camera
from gsrain_engine.rain.keyframes import RainKeyframes
from gsrain_engine.rain.settings import RainSettings, load_preset
from gsrain_engine.rain.simulation import RainSimulation
from gsrain_engine.render.export import export_frames, export_sequences, frame_numbers
from gsrain_engine.render.export_settings import DEFAULT_SIZE_PX, Codec, ExportSettings, export_outputs
from gsrain_engine.render.object_labels import LabelFormat
from gsrain_engine.render.renderer import Renderer, RenderMode
from gsrain_engine.render.sequence import FrameSequence
from gsrain_engine.safe_io.errors import convert_checked
from gsrain_engine.scene.camera import Camera, read_camera
from gsrain_engine.scene.camera_path import CameraPath
from gsrain_engine.scene.camera_path_io import read_camera_path
from gsrain_engine.scene.objects import scene_objects
from gsrain_engine.scene.open import load_sorted_scene
from gsrain_engine.scene.scene import Scene

from .console import print
from .options import RAIN_OPTIONS, JsonFile, check_writable, converted_options, lock_outputs, parse_size, write_numbers
from .progress import followed, progress_bar
from .scene_options import Orientation, TimedPath, timed_path

_MAX_LISTED = 6
_FILE_ENDINGS = (".png", ".jpg", ".jpeg", ".exr", ".npy", ".mp4", ".webm", ".json")
"""Extensions of files that a recording writes; any other output is a folder, even with dots: frames.clear, clip.depth.
"""

# Options of rain and recording


@Parameter(name="*")  # fields are options of the command, without a prefix
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
    wetness: Annotated[
        float | None,
        Parameter(help="Share of the scene's wet colours, 0 clear to 1 soaked; default: as the intensity has it."),
    ] = None

    def for_scene(self, scene: Scene) -> RainSettings:
        """Return the preset, else the scene's saved rain, else no rain, with the given options applied."""
        if self.preset is not None:
            rain = load_preset(self.preset)
        else:
            rain = convert_checked(scene.rain, RainSettings) if scene.rain is not None else RainSettings()
        asked = {
            "intensity_mm_h": self.rain,
            "seed": self.seed,
            "exposure_s": self.exposure,
            "closure": self.closure,
            "calibration": self.calibration,
            "roofs": self.roofs,
            "haze": self.haze,
            "streaks": self.streaks,
            "wetness": self.wetness,
        }
        values = msgspec.to_builtins(rain) | {name: value for name, value in asked.items() if value is not None}
        return converted_options(values, RainSettings, RAIN_OPTIONS)


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class RecordingOptions:
    """Recording of a clip on the command line."""

    fps: Annotated[float, Parameter(help="Frames a second.")] = 30.0
    time: Annotated[float, Parameter(name=["--time", "--from"], help="Moment of the first frame in seconds.")] = 0.0
    to: Annotated[float | None, Parameter(help="Moment at which the clip ends, in seconds.")] = None
    supersampling: Annotated[int, Parameter(help="Draw 1..4 times wider and higher, and take the mean.")] = 1
    motion_blur: Annotated[
        int, Parameter(help="Sub-frames (1..64) over the exposure T, with T/k each, averaged in linear light.")
    ] = 1
    cameras: Annotated[
        str, Parameter(help="Rig cameras instead of a path: RIG, RIG/NAME, NAME or all; several with commas.")
    ] = ""
    passes: Annotated[
        str, Parameter(help="color, depth (16 bit, cm), alpha, labels (layer or actor of each pixel); with commas.")
    ] = "color"
    twin: Annotated[bool, Parameter(help="Also the same clip at 0 mm/h, called NAME.clear.")] = False
    codec: Annotated[
        Codec,
        Parameter(
            help="auto goes by the ending: h264 in MP4, vp9 in WebM, png in folders, which may hold jpeg or exr too."
        ),
    ] = "auto"
    quality: Annotated[
        int | None,
        Parameter(help="Rate factor, lower is better: 0..51 (h264), 0..63 (vp9, av1); JPEG: 1..100, higher is better."),
    ] = None

    def recording(self, output: Path, size_px: tuple[int, int] | None, *, depth: bool) -> ExportSettings:
        """Check all options. Raises `ValueError` for values out of bounds or in conflict."""
        if not 0.1 <= self.fps <= 1000:
            raise ValueError(f"--fps {self.fps:g}: must be within 0.1..1000")
        passes = _words(self.passes)
        values: dict[str, Any] = {
            "output": str(output),
            "size_px": size_px,
            "fps": self.fps,
            "first_s": self.time,
            "last_s": self.to,
            "supersampling": self.supersampling,
            "motion_blur": self.motion_blur,
            "cameras": _words(self.cameras),
            "passes": [*passes, "depth"] if depth and "depth" not in passes else passes,
            "twin": self.twin,
            "codec": self.codec,
            "quality": self.quality,
        }
        return converted_options(values, ExportSettings, _RECORDING_OPTIONS)


def render(
    scene: Annotated[str | None, Parameter(help="Scene file or folder; without one, the built-in street.")] = None,
    /,
    *,
    output: Annotated[
        Path,
        Parameter(
            name=["--output", "-o"], help="PNG, JPEG, EXR, NPY, MP4, WebM, or a folder for PNG, JPEG or EXR frames."
        ),
    ],
    rain: RainOptions | None = None,
    recording: RecordingOptions | None = None,
    camera: Annotated[Path | None, Parameter(help="Camera file (JSON) in the scene's own units and axes.")] = None,
    camera_path: Annotated[
        Path | None, Parameter(help="Camera path: ours, nerfstudio's camera_path.json or 3DGS's cameras.json.")
    ] = None,
    size: Annotated[str | None, Parameter(help="WIDTHxHEIGHT in pixels; default 960x640, or the camera's own.")] = None,
    speed: Annotated[
        float | None,
        Parameter(help="Speed along the camera path in m/s; default: its own times, or walking pace without any."),
    ] = None,
    duration: Annotated[
        float | None, Parameter(help="Seconds of video; default: the path's length, at most 10.")
    ] = None,
    frame: Annotated[int | None, Parameter(help="Render only this frame of the path or drive, counted from 0.")] = None,
    depth: Annotated[bool, Parameter(help="Add depth to the passes: PNG (16 bit, cm), NPY (m) or EXR (m).")] = False,
    labels: Annotated[
        LabelFormat | None,
        Parameter(help="Write 2D and 3D boxes, visibility, instance masks of actors and parked vehicles, with depth."),
    ] = None,
    look: Annotated[
        RenderMode, Parameter(help="What to show: the picture (splats), or without rain what it is made of.")
    ] = "splats",
    wet: Annotated[
        bool,
        Parameter(help="First give the scene wet colours, as the window's preview job does; soaked without --wetness."),
    ] = False,
    orientation: Orientation | None = None,
    backend: Annotated[Backend, Parameter(help="auto takes OpenGL on a GPU, else the processor.")] = "auto",
    json: JsonFile = None,
) -> int:
    """Render a scene in its rain: a still, a video, frames, or raw floats (premultiplied, before tone mapping)."""
    asked = (recording or RecordingOptions()).recording(
        output, parse_size(size) if size else None, depth=depth or labels is not None
    )
    asked.check()
    _check(duration=duration, frame=frame)
    if frame is not None and camera is not None and asked.is_still:
        raise ValueError(f"--frame {frame}: a still from --camera has no other frame; --time sets its moment")
    check_writable(json)
    opened = (orientation or Orientation()).of(load_sorted_scene(scene))
    if labels is not None and not scene_objects(opened):
        raise ValueError(f"--labels {labels}: scene {opened.name!r} has no actors that labels could be about")
    asked_rain = (rain or RainOptions()).for_scene(opened)
    if wet:
        opened = _made_rainy(opened)
        asked_rain = asked_rain if asked_rain.wetness is not None else structs.replace(asked_rain, wetness=1.0)
    falling = RainSimulation.start(asked_rain, weather=rendered_weather(rain, opened))
    is_own_path = camera is None and camera_path is None and opened.path is not None
    viewpoint = _viewpoint(opened, camera, camera_path, asked, is_frame=frame is not None)
    timing = _timing(opened, viewpoint, camera_path, asked, speed)
    viewpoint = viewpoint if timing is None else timing.path
    sequences = export_sequences(asked, opened, falling, viewpoint, in_scene_time=is_own_path)
    numbers = _frame_numbers(asked, sequences, duration, frame)
    _check_outputs(asked, list(sequences), labels, json)
    lock_outputs(*export_outputs(asked, list(sequences)))
    with open_renderer(backend) as renderer:
        report = _record(renderer, asked, sequences, numbers, look)
        labelled = _label(renderer, labels, asked, sequences, numbers[: report["frames"]])
    if timing is not None and timing.line is not None:
        print(f"{camera_path or opened.name}: {timing.line}")
    written = _listed(export_outputs(asked, list(sequences)))
    first_s = next(iter(sequences.values())).time_s(numbers[0])
    sizes = ", ".join(dict.fromkeys(f"{each.width}x{each.height}" for each in sequences.values()))
    print(f"{written}: {report['frames']} of {len(numbers)} frames, {sizes}, {_describe(falling, first_s)}")
    if labelled:
        print(f"{_listed(labelled)}: labels, the same with rain and without")
    speeds = {"speed_m_s": timing.speed_m_s, "speed_is_assumed": timing.is_assumed} if timing is not None else {}
    write_numbers(json, report | {"backend": renderer.name} | speeds)
    return 0 if report["frames"] == len(numbers) else 130


def _record(
    renderer: Renderer,
    recording: ExportSettings,
    sequences: Mapping[str, FrameSequence],
    numbers: Sequence[int],
    look: RenderMode,
) -> dict[str, Any]:
    """Record frames; Ctrl-C stops early and keeps the frames so far."""
    started, done = time.perf_counter(), 0
    first = next(iter(sequences.values()))
    state = first.rainfall.state_at(first.time_s(numbers[0]))
    with progress_bar("Rendering", len(numbers), draws=True) as advance:
        try:
            for progress in export_frames(renderer, recording, sequences, numbers, look=look):
                advance(round(progress.fraction * len(numbers)) - done)
                done = round(progress.fraction * len(numbers))
        except KeyboardInterrupt:
            print(f"stopped after {done} frames")
    return {
        "frames": done,
        "seconds": time.perf_counter() - started,
        "splats": renderer.statistics.splats_drawn,
        "drops": state.drops,
        "drops_drawn": renderer.statistics.drops_drawn,
        "haze_gaussians": state.haze_gaussians,
        "haze_drawn": renderer.statistics.haze_drawn,
        "intensity_mm_h": state.intensity_mm_h,
        "implied_mm_h": state.implied_mm_h,
        "table_implied_mm_h": state.table_implied_mm_h,
    }


def _label(
    renderer: Renderer,
    form: LabelFormat | None,
    recording: ExportSettings,
    sequences: Mapping[str, FrameSequence],
    numbers: Sequence[int],
) -> list[Path]:
    if form is None or not numbers:
        return []
    from gsrain_engine.render.label_export import write_object_labels  # loads OpenCV, which images don't need

    return followed(write_object_labels(renderer, form, recording, sequences, numbers))


def _listed(paths: list[Path]) -> str:
    if len(paths) <= _MAX_LISTED:
        return " and ".join(map(str, paths))
    return f"{paths[0]} and {len(paths) - 1} more"


def _describe(rainfall: RainSimulation, first_s: float) -> str:
    """Describe the rain, for animated rain at the first frame."""
    state, rain = rainfall.state_at(first_s), rainfall.rain
    when = f"first of a weather with {len(rainfall.weather.keys):,} keys: " if rainfall.weather.keys else ""
    if state.intensity_mm_h == 0:
        return f"{when}clear"
    words = [f"{when}{state.intensity_mm_h:g} mm/h asked, {state.implied_mm_h:.3g} mm/h drawn, {state.drops:,} drops"]
    if state.beyond_calibration:
        words.append("beyond calibration")
    return ", ".join([*words, *filter(None, [rain.exaggeration])])


def _check(*, duration: float | None, frame: int | None) -> None:
    if duration is not None and not 0 < duration <= 36000:
        raise ValueError(f"--duration {duration:g}: must be above 0 and at most 36000 s")
    if frame is not None and frame < 0:
        raise ValueError(f"--frame {frame}: must be 0 or more")


def _check_frame(
    frame: int, sequences: Mapping[str, FrameSequence], recording: ExportSettings, duration: float | None
) -> None:
    """Raise ValueError for a frame after the end of the path or drive, unless a longer clip is set."""
    lengths = [each.length_s for each in sequences.values()]
    if any(each is None for each in lengths):
        return
    ends = [recording.last_s - recording.first_s if recording.last_s is not None else None, duration, *lengths]
    count = max(1, round(max(each for each in ends if each is not None) * recording.fps))
    loops = any(isinstance(each.camera, CameraPath) and each.camera.loop for each in sequences.values())
    if frame > count and not loops:
        raise ValueError(f"--frame {frame}: there are frames 0 to {count} at {recording.fps:g} frames a second")


def _check_outputs(
    recording: ExportSettings, cameras: Sequence[str], labels: LabelFormat | None, json: Path | None
) -> None:
    """Raise ValueError for outputs that could not be written after rendering."""
    written = export_outputs(recording, cameras)
    if labels is not None:
        from gsrain_engine.render.label_export import label_outputs  # loads OpenCV, which images don't need

        written += label_outputs(labels, recording, cameras)
    folders = [path for path in written if path.suffix.lower() not in _FILE_ENDINGS]
    files = [path for path in written if path not in folders]
    check_writable(json, *files, folders=dict.fromkeys(folders))


def _made_rainy(scene: Scene) -> Scene:
    # Loading kernels takes a second, so import them only here.
    from gsrain_engine.recolor.recolor import wet_scene

    return followed(wet_scene(scene))


def _viewpoint(
    scene: Scene, camera: Path | None, camera_path: Path | None, recording: ExportSettings, *, is_frame: bool
) -> Camera | CameraPath:
    """Return the camera or path of the options, in the world; else the scene's path, the ego's drive, or an orbit.

    A single still shows a scene without path and drive from the front.
    """
    if camera is not None and camera_path is not None:
        raise ValueError("--camera and --camera-path exclude each other")
    width, height = recording.size_px or DEFAULT_SIZE_PX
    if camera is not None:
        read = read_camera(camera)
        return (read.resized(width, height) if recording.size_px else read).moved(scene.scene_to_world)
    if camera_path is not None:
        return read_camera_path(camera_path).moved(scene.scene_to_world)
    if scene.path is not None or not recording.is_still or is_frame or front_camera(scene) is not None:
        return own_path(scene, width, height)
    return home_camera(scene, width, height)


def _timing(
    scene: Scene,
    viewpoint: Camera | CameraPath,
    camera_path: Path | None,
    recording: ExportSettings,
    speed: float | None,
) -> TimedPath | None:
    """Return the timing of a camera path; None for drives, which have their own speed, and for fixed cameras."""
    is_path = camera_path is not None or scene.path is not None
    if isinstance(viewpoint, CameraPath) and is_path and not recording.cameras:
        return timed_path(viewpoint, speed, is_still=recording.is_still)
    if speed is not None:
        raise ValueError(f"--speed {speed:g}: only a camera path has one (--camera-path, or a scene with its own)")
    return None


def _frame_numbers(
    recording: ExportSettings, sequences: Mapping[str, FrameSequence], duration: float | None, frame: int | None
) -> Sequence[int]:
    if frame is not None:
        _check_frame(frame, sequences, recording, duration)
        return [frame]
    if duration is None or recording.is_still:
        return frame_numbers(recording, sequences)
    if recording.last_s is not None:
        raise ValueError("--duration and --to exclude each other")
    return range(max(1, round(duration * recording.fps)))


_RECORDING_OPTIONS = {"size_px": "size", "first_s": "from", "last_s": "to"}


def _words(text: str) -> list[str]:
    return [word.strip() for word in text.split(",") if word.strip()]


# Animated rain


def rendered_weather(options: RainOptions | None, scene: Scene) -> RainKeyframes | None:
    """Return the rain keyframes saved with a scene, without those that --rain, --exposure or --preset replace.

    Raises `msgspec.ValidationError` if the saved keyframes are invalid.
    """
    if scene.weather is None or (options is not None and options.preset is not None):
        return None
    weather = convert_checked(scene.weather, RainKeyframes)
    if options is not None and options.rain is not None:
        weather = weather.without("intensity_mm_h")
    if options is not None and options.exposure is not None:
        weather = weather.without("exposure_s")
    return weather
