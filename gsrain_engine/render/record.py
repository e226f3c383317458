"""Records a clip: all cameras, passes and the clear twin, frame by frame; the window and the command line run this."""

import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass

import numpy as np
from jaxtyping import UInt8

from gsrain_engine.scene.file_lock import holding
from gsrain_engine.scene.progress import Progress

from .frame import Frame
from .frame_sink import FrameSink, open_sink
from .labels import draw_labels, legend
from .look import Look
from .recorded_files import outputs, recorded_files
from .recording import Pass, Recording
from .renderer import Renderer
from .sequence import FrameSequence
from .sky_color import Sky

_PREVIEW_PX = 320
_PREVIEW_EVERY_S = 0.5


def record(
    renderer: Renderer,
    recording: Recording,
    sequences: Mapping[str, FrameSequence],
    numbers: Sequence[int],
    *,
    look: Look = "splats",
) -> Iterator[Progress]:
    """Render and write frames by their numbers; yields after each, with the time that is left.

    Frames are whole, and videos are brought to an end, wherever the caller stops. The same input gives the same bytes.

    Raises:
        ValueError: For an output that can't be encoded.
        OSError: When it can't be written; what had been written can be played. `HeldError` where another process does.
    """
    with ExitStack() as stack:
        for path in outputs(recording, list(sequences)):
            stack.enter_context(holding(path))
        takes = _open(recording, sequences, stack)
        yield Progress(0.0, "Looking at the sky")
        sky = next(iter(sequences.values())).sky(renderer)
        pace = _Pace(len(numbers))
        for number in numbers:
            try:
                frames = [take.write(renderer, number, sky, look) for take in takes]
            except OSError as error:
                raise OSError(_problem(recording, error, pace.done)) from error
            yield pace.step(frames[-1])


@dataclass(frozen=True, slots=True, eq=False)
class _Take:
    """One camera's clip, in the rain or without."""

    sequence: FrameSequence
    sink: FrameSink
    passes: frozenset[Pass]
    is_clear: bool

    def write(self, renderer: Renderer, number: int, sky: Sky, look: Look) -> Frame | None:
        """Render a frame and write its passes; the renderer's last picture is that of the colours."""
        labels = frame = None
        if "labels" in self.passes:
            shot = self.sequence.shot(number)
            labels = draw_labels(renderer, self.sequence.scene, shot.camera, shot.time_s)
        if self.passes - {"labels"}:
            seen = None if self.is_clear else sky
            frame = self.sequence.frame(renderer, number, seen, with_depth="depth" in self.passes, look=look)
        self.sink.write(number, frame, labels)
        return frame


class _Pace:
    """How far a recording has come, and how long it will take."""

    def __init__(self, frames: int) -> None:
        self.done = 0
        self._frames, self._began, self._previewed = frames, -np.inf, -np.inf

    def step(self, frame: Frame | None) -> Progress:
        """Count a frame; now and then show it."""
        self.done += 1
        now, preview = time.perf_counter(), None
        if frame is not None and now - self._previewed >= _PREVIEW_EVERY_S:
            preview, self._previewed = _small(frame), now
        message = f"Frame {self.done:,} of {self._frames:,}"
        if self.done == 1:  # it loads and compiles what all others use: it says nothing about them
            self._began = now
        else:
            left_s = (now - self._began) / (self.done - 1) * (self._frames - self.done)
            message += f", {_clock_time(left_s)} left"
        return Progress(self.done / self._frames, message, preview)


def _open(recording: Recording, sequences: Mapping[str, FrameSequence], stack: ExitStack) -> list[_Take]:
    """One take for each camera, the clear twin before the one in the rain; `stack` closes them."""
    takes: list[_Take] = []
    for name, sequence in sequences.items():
        for is_clear in (True, False) if recording.twin else (False,):
            files = recorded_files(recording, name if len(sequences) > 1 else None, is_clear=is_clear)
            size = sequence.width, sequence.height
            try:
                sink = stack.enter_context(open_sink(recording, files, size, legend(sequence.scene)))
            except OSError as error:
                raise OSError(f"{files.path} can't be written: {error.strerror or error}") from error
            takes.append(_Take(sequence, sink, files.passes, is_clear))
    return takes


def _clock_time(seconds: float) -> str:
    """Minutes and seconds, with hours where there are any."""
    minutes, rest = divmod(round(seconds), 60)
    return f"{minutes // 60}:{minutes % 60:02d}:{rest:02d} h" if minutes >= 60 else f"{minutes}:{rest:02d} min"


def _small(frame: Frame) -> UInt8[np.ndarray, "h w 3"]:
    """Every so many-th pixel of a frame."""
    step = -(-frame.rgba.shape[1] // _PREVIEW_PX)
    return np.ascontiguousarray(Frame(frame.rgba[::step, ::step]).to_uint8())


def _problem(recording: Recording, error: OSError, done: int) -> str:
    """Say in one sentence what a disk has against it, and what is left."""
    reason = error.strerror or str(error)
    return f"{recording.output} can't be written on after {done} frames: {reason}; what was written before is whole"
