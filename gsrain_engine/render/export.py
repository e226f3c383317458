"""Export of frames: all cameras, passes and the clear twin, used by window and command line."""

import shlex
import time
from collections.abc import Iterator, Mapping, Sequence, Set
from contextlib import ExitStack, closing, suppress
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain
from typing import NamedTuple

import numpy as np
import psutil
from jaxtyping import UInt8, UInt16

from ..choices import RenderMode
from ..fields import option_words
from ..rain.settings import RainSettings
from ..rain.simulation import RainSimulation
from ..safe_io.files import hold_for_writing
from ..scene.camera import Camera
from ..scene.camera_path import CameraPath
from ..scene.open import with_lod_trees
from ..scene.progress import Progress
from ..scene.scene import Scene
from ..threads import kernel_threads, results_in_order
from .cpu.renderer import CpuRenderer
from .export_settings import DEFAULT_SIZE_PX, ExportSettings, Pass, export_files, export_outputs
from .images import FrameWriter, open_frame_writer
from .level_of_detail import lod_cut
from .object_labels import draw_labels, label_legend
from .provenance import PictureProvenance, provenance_of
from .renderer import Frame, PendingImage, Renderer, RenderStatistics
from .sequence import FollowingCamera, FrameSequence, RigCameraView, common_sky, find_rig_cameras
from .sky_color import SkyColor

_PREVIEW_PX = 320
_PREVIEW_EVERY_S = 0.5
FRAME_TIME = "seconds per frame"
"""Metric of an export: mean time of its frames so far, without the first."""


def export_frames(
    renderer: Renderer,
    recording: ExportSettings,
    sequences: Mapping[str, FrameSequence],
    numbers: Sequence[int],
    *,
    mode: RenderMode = "splats",
) -> Iterator[Progress]:
    """Render and write frames by their numbers; yields progress with the remaining time after each.

    Frames are complete and videos playable wherever the caller stops. The output is deterministic.

    Raises:
        ValueError: For an output that can't be encoded, and for marks without a scale.
        OSError: If it can't be written; frames written before remain playable. `PathInUseError` if another process
        writes it.
    """
    if recording.marks and not all(each.shot(numbers[0]).camera.is_orthographic for each in sequences.values()):
        raise ValueError(f"marks {', '.join(recording.marks)}: only an orthographic picture has a scale for them")
    with ExitStack() as stack:
        for path in export_outputs(recording, list(sequences)):
            stack.enter_context(hold_for_writing(path))
        streams = [
            _open_stream(stack, recording, sequence, name if len(sequences) > 1 else None, is_clear=is_clear)
            for name, sequence in sequences.items()
            for is_clear in ((True, False) if recording.twin else (False,))
        ]
        yield Progress(0.0, "Looking at the sky")
        is_sunny = recording.twin == "sunny"
        drawing = _Drawing(renderer, streams, common_sky(renderer, sequences), mode, is_sunny=is_sunny)
        estimator, drawn = EtaEstimator(len(numbers)), list[_DrawnFrame]()
        frames = chain(_in_order(drawing, numbers), ([],))
        while True:  # each frame is read back and written after the next one was drawn
            try:
                if (ahead := next(frames, None)) is None:
                    break
                written = [each.write() for each in drawn]
            except OSError as error:
                reason, done = error.strerror or str(error), estimator.done
                raise OSError(
                    f"{recording.output} can't be written on after {done} frames: {reason}; "
                    "what was written before is whole"
                ) from error
            if written:
                yield estimator.step(written[-1])
            drawn = ahead


_Bytes = UInt8[np.ndarray, "h w 3"]


class _OutputStream(NamedTuple):
    """Output of one camera, with or without rain."""

    sequence: FrameSequence
    writer: FrameWriter
    passes: Set[Pass]
    is_clear: bool


class _DrawnFrame(NamedTuple):
    """Frame of a stream that is read back and written later."""

    number: int
    writer: FrameWriter
    frame: "Frame | PendingImage | _Bytes | None"
    labels: UInt16[np.ndarray, "h w"] | None

    def read(self) -> "_DrawnFrame":
        """Wait for the frame: the renderer may draw another one."""
        return self._replace(frame=self.frame()) if callable(self.frame) else self

    def write(self) -> "Frame | _Bytes | None":
        """Wait for the frame, write it, and return what was written of its color."""
        frame = self.frame() if callable(self.frame) else self.frame
        self.writer.write(self.number, frame, self.labels)
        return frame


@dataclass(frozen=True, slots=True, eq=False)
class _Drawing:
    """Draws the frames of all streams."""

    renderer: Renderer
    streams: Sequence[_OutputStream]
    sky: SkyColor
    mode: RenderMode
    is_sunny: bool
    """True if the clear twin has the light of the scene."""

    def copy(self) -> "_Drawing":
        """Return one for another thread, with a renderer and memories of cameras of its own."""
        streams = [each._replace(sequence=replace(each.sequence)) for each in self.streams]
        return replace(self, renderer=CpuRenderer(), streams=streams)

    def frames(self, number: int) -> list[_DrawnFrame]:
        drawn = list[_DrawnFrame]()
        for sequence, writer, passes, is_clear in self.streams:
            labels = frame = None
            if "labels" in passes:
                shot = sequence.shot(number)
                labels = draw_labels(self.renderer, sequence.scene, shot.camera, shot.time_s)
            if passes - {"labels"}:  # last, so that the renderer's image is the color pass
                sky, with_depth = None if is_clear and self.is_sunny else self.sky, "depth" in passes
                if writer.takes_bytes:
                    frame = sequence.request(self.renderer, number, sky, mode=self.mode)
                else:
                    frame = sequence.frame(self.renderer, number, sky, with_depth=with_depth, mode=self.mode)
            drawn.append(_DrawnFrame(number, writer, frame, labels))
        return drawn


_MAX_THREADS = 8
_BYTES_PER_GAUSSIAN, _BYTES_PER_PIXEL = 300, 400  # of a renderer, while it draws


def _in_order(drawing: _Drawing, numbers: Sequence[int]) -> Iterator[list[_DrawnFrame]]:
    """Draw frames by their numbers; the processor draws as many at once as it has cores and memory for."""
    renderer = drawing.renderer
    threads = _thread_count(drawing.streams, len(numbers)) if isinstance(renderer, CpuRenderer) else 1
    if threads == 1 or not isinstance(renderer, CpuRenderer):
        yield from map(drawing.frames, numbers)
        return
    idle = [drawing]

    def read(number: int) -> tuple[list[_DrawnFrame], RenderStatistics]:
        own: _Drawing | None = None
        with suppress(IndexError):  # all are in use by other threads
            own = idle.pop()
        own = own or drawing.copy()
        try:
            return [each.read() for each in own.frames(number)], own.renderer.statistics
        finally:
            idle.append(own)

    calls = ((number, partial(read, number)) for number in numbers)
    with closing(results_in_order(calls, threads)) as results:
        for _, result in results:
            assert result is not None
            frames, renderer.statistics = result
            yield frames


def _thread_count(streams: Sequence[_OutputStream], frames: int) -> int:
    """Return how many frames may be drawn at once."""
    gaussians = max(each.sequence.scene.gaussian_count for each in streams)
    pixels = max(each.sequence.width * each.sequence.height * each.sequence.supersampling**2 for each in streams)
    needed = _BYTES_PER_GAUSSIAN * gaussians + _BYTES_PER_PIXEL * pixels
    room = psutil.virtual_memory().available // (2 * needed + 1)
    return max(1, min(kernel_threads(), _MAX_THREADS, frames, room))


def _open_stream(
    stack: ExitStack, recording: ExportSettings, sequence: FrameSequence, camera: str | None, *, is_clear: bool
) -> _OutputStream:
    """Open an output, which `stack` closes."""
    files = export_files(recording, camera, is_clear=is_clear)
    size = sequence.width, sequence.height
    try:
        writer = stack.enter_context(open_frame_writer(recording, files, size, label_legend(sequence.scene)))
    except OSError as error:
        raise OSError(f"{files.path} can't be written: {error.strerror or error}") from error
    return _OutputStream(replace(sequence, falls=not is_clear), writer, files.passes, is_clear)


class EtaEstimator:
    """Progress, preview and remaining time of an export."""

    def __init__(self, frames: int) -> None:
        self.done = 0
        self._frames, self._began, self._previewed = frames, -np.inf, -np.inf

    def step(self, frame: Frame | _Bytes | None) -> Progress:
        """Count a frame; attach a preview at intervals."""
        self.done += 1
        now, preview = time.perf_counter(), None
        if frame is not None and now - self._previewed >= _PREVIEW_EVERY_S:
            pixels = frame if isinstance(frame, np.ndarray) else frame.rgba
            step = -(-pixels.shape[1] // _PREVIEW_PX)
            small = pixels[::step, ::step]
            preview = np.ascontiguousarray(small if isinstance(frame, np.ndarray) else Frame(small).to_uint8())
            self._previewed = now
        metrics: dict[str, float] = {}
        message = f"Frame {self.done:,} of {self._frames:,}"
        if self.done == 1:  # excluded from the estimate: it loads data and compiles kernels
            self._began = now
        else:
            metrics[FRAME_TIME] = frame_s = (now - self._began) / (self.done - 1)
            left_s = frame_s * (self._frames - self.done)
            minutes, seconds = divmod(round(left_s), 60)
            hours = f"{minutes // 60}:{minutes % 60:02d}:{seconds:02d} h"
            message += f", {hours if minutes >= 60 else f'{minutes}:{seconds:02d} min'} left"
        return Progress(self.done / self._frames, message, preview, metrics)


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
    numbers, sky = frame_numbers(recording, {"": sequence}), sequence.sky(renderer)
    return (sequence.frame(renderer, number, sky, with_depth=with_depth) for number in numbers)


# Cameras, size and times of an export

LONGEST_DEFAULT_S = 10.0
"""Maximum default length of a video from a fixed camera or a path with times of its own; a drive is exported whole."""


def export_sequences(
    recording: ExportSettings,
    scene: Scene,
    rainfall: RainSimulation,
    viewpoint: Camera | CameraPath | FollowingCamera,
    *,
    in_scene_time: bool,
) -> dict[str, FrameSequence]:
    """Frame sequences of an export by camera name: rig cameras if it names some, or else one viewpoint.

    `in_scene_time` is true if a path's times are the scene's own. A still from an untimed path is rendered with the
    camera at rest. Raises `ValueError` for contradictory settings.
    """
    recording.check()
    whole = scene
    if recording.transparent:
        scene = replace(scene, layers=tuple(each for each in scene.layers if each.kind != "sky"))
    lod = merges_details(recording, scene)
    scene = with_lod_trees(scene) if lod else scene
    views: dict[str, Camera | CameraPath | RigCameraView | FollowingCamera] = {"": viewpoint}
    if recording.cameras:  # named as their files; prefixed with the rig if there are several rigs
        found = find_rig_cameras(scene, recording.cameras)
        several = len({each.rig for each in found}) > 1
        views = {f"{each.rig}_{each.name}" if several else each.name: each for each in found}
    sequences: dict[str, FrameSequence] = {}
    for name, view in views.items():
        size_px = recording.size_px or DEFAULT_SIZE_PX
        if recording.size_px is None and not isinstance(view, CameraPath):
            camera = view if isinstance(view, Camera) else view.at(recording.first_s)
            size_px = camera.width, camera.height
        is_untimed = isinstance(view, CameraPath) and not view.is_timed
        sequences[name] = FrameSequence(
            scene, rainfall, view, *size_px, fps=recording.fps, start_s=recording.first_s,
            in_scene_time=in_scene_time and isinstance(view, CameraPath), supersampling=recording.supersampling,
            motion_blur=recording.motion_blur, at_rest=recording.is_still and is_untimed, lod=lod,
            projection=recording.projection, sky_scene=whole if recording.transparent else None,
            marks=recording.marks,
        )  # fmt: skip
    return sequences


def first_pictures(
    renderer: Renderer, sequences: Mapping[str, FrameSequence], number: int, mode: RenderMode = "splats"
) -> dict[str, PictureProvenance]:
    """Return what the frame of a number holds, by camera."""
    sky = common_sky(renderer, sequences)
    return {
        name: provenance_of(sequence.frame_input(sequence.shot(number), sky, mode))
        for name, sequence in sequences.items()
    }


def merges_details(recording: ExportSettings, scene: Scene) -> bool:
    """Return whether images of a scene are drawn with a level-of-detail cut, see `ExportSettings.lod`."""
    is_exact = recording.lod is None and recording.format == "npy"
    return not is_exact and lod_cut(scene, recording.lod) is not None


def frame_numbers(recording: ExportSettings, sequences: Mapping[str, FrameSequence]) -> range:
    """Numbers of the frames between first and last time; without a last time, up to the end of the path."""
    if recording.is_still:
        return range(1)
    if recording.last_s is not None:
        return range(max(1, round((recording.last_s - recording.first_s) * recording.fps)))
    lengths_s = [1 / recording.fps]
    for each in sequences.values():
        length_s = LONGEST_DEFAULT_S if each.length_s is None else each.length_s
        has_times = each.in_scene_time or isinstance(each.camera, RigCameraView | FollowingCamera)
        lengths_s.append(length_s if has_times else min(LONGEST_DEFAULT_S, length_s))
    return range(max(1, round(max(lengths_s) * recording.fps)))


# Equivalent command line


def export_command(recording: ExportSettings, project: str) -> str:
    """Shell command for the same bytes; `project` is the scene folder."""
    return shlex.join(["gsrain", "render", project, "-o", recording.output, *option_words(recording, "render")])
