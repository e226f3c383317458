"""Export of frames: all cameras, passes and the clear twin, used by window and command line."""

import shlex
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass

import numpy as np
from jaxtyping import UInt8

from ..rain.settings import RainSettings
from ..rain.simulation import RainSimulation
from ..scene.camera import Camera
from ..scene.camera_path import CameraPath
from ..scene.files import hold_for_writing
from ..scene.progress import Progress
from ..scene.scene import Scene
from .export_settings import DEFAULT_SIZE_PX, ExportSettings, Pass, export_files, export_outputs
from .images import FrameWriter, open_frame_writer
from .object_labels import draw_labels, label_legend
from .renderer import Frame, Renderer, RenderMode
from .sequence import FrameSequence, RigCameraView, find_rig_cameras
from .sky_color import SkyColor

_PREVIEW_PX = 320
_PREVIEW_EVERY_S = 0.5


def export_frames(
    renderer: Renderer,
    recording: ExportSettings,
    sequences: Mapping[str, FrameSequence],
    numbers: Sequence[int],
    *,
    look: RenderMode = "splats",
) -> Iterator[Progress]:
    """Render and write frames by their numbers; yields progress with the remaining time after each.

    Frames are complete and videos playable wherever the caller stops. The output is deterministic.

    Raises:
        ValueError: For an output that can't be encoded.
        OSError: If it can't be written; frames written before remain playable. `PathInUseError` if another process
        writes it.
    """
    with ExitStack() as stack:
        for path in export_outputs(recording, list(sequences)):
            stack.enter_context(hold_for_writing(path))
        takes = _open(recording, sequences, stack)
        yield Progress(0.0, "Looking at the sky")
        sky = next(iter(sequences.values())).sky(renderer)
        pace = _EtaEstimator(len(numbers))
        for number in numbers:
            try:
                frames = [take.write(renderer, number, sky, look) for take in takes]
            except OSError as error:
                raise OSError(_problem(recording, error, pace.done)) from error
            yield pace.step(frames[-1])


@dataclass(frozen=True, slots=True, eq=False)
class _OutputStream:
    """Output of one camera, with or without rain."""

    sequence: FrameSequence
    sink: FrameWriter
    passes: frozenset[Pass]
    is_clear: bool

    def write(self, renderer: Renderer, number: int, sky: SkyColor, look: RenderMode) -> Frame | None:
        """Render a frame and write its passes; the renderer's last image is the color pass."""
        labels = frame = None
        if "labels" in self.passes:
            shot = self.sequence.shot(number)
            labels = draw_labels(renderer, self.sequence.scene, shot.camera, shot.time_s)
        if self.passes - {"labels"}:
            seen = None if self.is_clear else sky
            frame = self.sequence.frame(renderer, number, seen, with_depth="depth" in self.passes, look=look)
        self.sink.write(number, frame, labels)
        return frame


class _EtaEstimator:
    """Progress, preview and remaining time of an export."""

    def __init__(self, frames: int) -> None:
        self.done = 0
        self._frames, self._began, self._previewed = frames, -np.inf, -np.inf

    def step(self, frame: Frame | None) -> Progress:
        """Count a frame; attach a preview at intervals."""
        self.done += 1
        now, preview = time.perf_counter(), None
        if frame is not None and now - self._previewed >= _PREVIEW_EVERY_S:
            preview, self._previewed = _small(frame), now
        message = f"Frame {self.done:,} of {self._frames:,}"
        if self.done == 1:  # excluded from the estimate: it loads data and compiles kernels
            self._began = now
        else:
            left_s = (now - self._began) / (self.done - 1) * (self._frames - self.done)
            message += f", {_clock_time(left_s)} left"
        return Progress(self.done / self._frames, message, preview)


def _open(recording: ExportSettings, sequences: Mapping[str, FrameSequence], stack: ExitStack) -> list[_OutputStream]:
    """Return one output stream per camera, the clear twin before the rainy one; `stack` closes them."""
    takes: list[_OutputStream] = []
    for name, sequence in sequences.items():
        for is_clear in (True, False) if recording.twin else (False,):
            files = export_files(recording, name if len(sequences) > 1 else None, is_clear=is_clear)
            size = sequence.width, sequence.height
            try:
                sink = stack.enter_context(open_frame_writer(recording, files, size, label_legend(sequence.scene)))
            except OSError as error:
                raise OSError(f"{files.path} can't be written: {error.strerror or error}") from error
            takes.append(_OutputStream(sequence, sink, files.passes, is_clear))
    return takes


def _clock_time(seconds: float) -> str:
    minutes, rest = divmod(round(seconds), 60)
    return f"{minutes // 60}:{minutes % 60:02d}:{rest:02d} h" if minutes >= 60 else f"{minutes}:{rest:02d} min"


def _small(frame: Frame) -> UInt8[np.ndarray, "h w 3"]:
    step = -(-frame.rgba.shape[1] // _PREVIEW_PX)
    return np.ascontiguousarray(Frame(frame.rgba[::step, ::step]).to_uint8())


def _problem(recording: ExportSettings, error: OSError, done: int) -> str:
    reason = error.strerror or str(error)
    return f"{recording.output} can't be written on after {done} frames: {reason}; what was written before is whole"


# Export from scene, rain and camera


def render_video(
    renderer: Renderer, recording: ExportSettings, scene: Scene, rain: RainSettings, camera: Camera | CameraPath
) -> Iterator[Progress]:
    """Export a scene in its rain from a camera or along a path (world, meters, z up); yields after each frame.

    The path's times are those of the scene and the rain. The output is byte-identical to that of the window and of
    `gsrain render`. If a caller stops early, the frames written so far are playable.

    Raises:
        ValueError: For contradictory settings, or a missing calibration named by the rain.
        OSError: If the output can't be written.
    """
    rainfall = RainSimulation.start(rain)
    sequences = export_sequences(recording, scene, rainfall, camera, in_scene_time=True)
    yield from export_frames(renderer, recording, sequences, frame_numbers(recording, sequences))


def film_frames(
    renderer: Renderer,
    recording: ExportSettings,
    scene: Scene,
    rain: RainSettings,
    camera: Camera | CameraPath,
    *,
    with_depth: bool = False,
) -> Iterator[Frame]:
    """Render the frames that `render_video` would export, one by one, without writing; `recording.output` is unused.

    Depth is that of the scene in meters, without rain. Raises `ValueError` as `render_video` does, before the first
    frame.
    """
    rainfall = RainSimulation.start(rain)
    (sequence,) = export_sequences(recording, scene, rainfall, camera, in_scene_time=True).values()
    numbers = frame_numbers(recording, {"": sequence})
    return (each.frame for each in sequence.render(renderer, numbers, sequence.sky(renderer), with_depth=with_depth))


# Cameras, size and times of an export

LONGEST_DEFAULT_S = 10.0
"""Maximum default length of a video from a fixed camera or a path with times of its own."""


def export_sequences(
    recording: ExportSettings,
    scene: Scene,
    rainfall: RainSimulation,
    viewpoint: Camera | CameraPath,
    *,
    in_scene_time: bool,
) -> dict[str, FrameSequence]:
    """Frame sequences of an export by camera name: rig cameras if it names some, or else one viewpoint.

    `in_scene_time` is true if a path's times are the scene's own. A still from an untimed path is rendered with the
    camera at rest. Raises `ValueError` for contradictory settings.
    """
    recording.check()
    views: dict[str, Camera | CameraPath | RigCameraView] = {"": viewpoint}
    if recording.cameras:
        views = _by_name(find_rig_cameras(scene, recording.cameras))
    sequences: dict[str, FrameSequence] = {}
    for name, view in views.items():
        width, height = recording.size_px or _own_size(view, recording.first_s)
        sequences[name] = FrameSequence(
            scene,
            rainfall,
            view,
            width,
            height,
            recording.fps,
            recording.first_s,
            in_scene_time and isinstance(view, CameraPath),
            recording.supersampling,
            recording.motion_blur,
            at_rest=recording.is_still and isinstance(view, CameraPath) and not view.is_timed,
        )
    return sequences


def frame_numbers(recording: ExportSettings, sequences: Mapping[str, FrameSequence]) -> range:
    """Numbers of the frames between first and last time; without a last time, up to the end of the path."""
    if recording.is_still:
        return range(1)
    if recording.last_s is not None:
        return range(max(1, round((recording.last_s - recording.first_s) * recording.fps)))
    length_s = max(_length_s(each) for each in sequences.values())
    return range(max(1, round(max(length_s, 1 / recording.fps) * recording.fps)))


def _length_s(sequence: FrameSequence) -> float:
    """Full length of a drive or a path in scene time; at most `LONGEST_DEFAULT_S` otherwise."""
    length_s = LONGEST_DEFAULT_S if sequence.length_s is None else sequence.length_s
    is_made = sequence.in_scene_time or isinstance(sequence.camera, RigCameraView)
    return length_s if is_made else min(LONGEST_DEFAULT_S, length_s)


def _by_name(cameras: list[RigCameraView]) -> dict[str, Camera | CameraPath | RigCameraView]:
    """Name cameras as their files; prefixed with the rig if there are several rigs."""
    several = len({each.rig for each in cameras}) > 1
    return {f"{each.rig}_{each.name}" if several else each.name: each for each in cameras}


def _own_size(view: Camera | CameraPath | RigCameraView, time_s: float) -> tuple[int, int]:
    if isinstance(view, CameraPath):
        return DEFAULT_SIZE_PX
    camera = view if isinstance(view, Camera) else view.at(time_s)
    return camera.width, camera.height


# Equivalent command line

_OPTIONS = {
    "fps": "--fps",
    "first_s": "--from",
    "last_s": "--to",
    "supersampling": "--supersampling",
    "motion_blur": "--motion-blur",
    "quality": "--quality",
}


def export_command(recording: ExportSettings, project: str) -> str:
    """Shell command for the same bytes; `project` is the scene folder."""
    words = ["gsrain", "render", project, "-o", recording.output]
    if recording.size_px is not None:
        words += ["--size", "{}x{}".format(*recording.size_px)]
    plain = ExportSettings(output=recording.output)
    for field, option in _OPTIONS.items():
        value = getattr(recording, field)
        if value != getattr(plain, field):
            words += [option, f"{value!r}"]
    if recording.cameras:
        words += ["--cameras", ",".join(recording.cameras)]
    if recording.passes != plain.passes:
        words += ["--passes", ",".join(recording.passes)]
    if recording.format != plain.format:
        words += ["--codec", recording.codec]
    if recording.twin:
        words.append("--clear-pair")
    return shlex.join(words)
