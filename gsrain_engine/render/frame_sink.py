"""Where recorded frames go: a video, a still, or a folder of frames, with the passes beside them."""

from collections.abc import Generator, Mapping
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import UInt16

from .exr import write_exr
from .frame import Frame
from .pictures import write_alpha, write_array, write_depth, write_jpeg, write_labels, write_legend, write_picture
from .recorded_files import RecordedFiles, recorded_files
from .recording import DEFAULT_JPEG_QUALITY, Recording
from .video import VideoWriter


@contextmanager
def open_sink(
    recording: Recording, files: RecordedFiles, size_px: tuple[int, int], legend: Mapping[str, Any]
) -> Generator["FrameSink"]:
    """Open what takes the frames of one camera; `legend` says what labels mean.

    Raises `ValueError` for what can't be encoded.
    """
    video = nullcontext()
    if files.is_video and "color" in files.passes:
        codec, quality = recording.format, recording.quality
        video = VideoWriter(files.path, *size_px, recording.fps, codec=codec, quality=quality)
    with video as opened:
        yield FrameSink(files, legend, opened, recording.quality)


def write_still(path: Path | str, frame: Frame) -> None:
    """Write a frame as PNG, JPEG, EXR or NPY, by the ending; the same bytes as a recorded still.

    An EXR file holds the depth, too, where the frame has it; NPY holds premultiplied display colors and alpha. Missing
    folders are made. Raises `ValueError` for another ending, `OSError` where it can't be written.
    """
    has_depth = frame.depth is not None and Path(path).suffix.lower() == ".exr"
    recording = Recording(output=str(path), passes=("color", "depth") if has_depth else ("color",))
    if not recording.is_still:
        raise ValueError(f"{path}: expected the name of an image, which ends in .png, .jpg, .exr or .npy")
    files = recorded_files(recording, None, is_clear=False)
    with open_sink(recording, files, (frame.rgba.shape[1], frame.rgba.shape[0]), {}) as sink:
        sink.write(0, frame)


class FrameSink:
    """Takes the frames of one camera. Those that are files of their own are there whole or not at all."""

    def __init__(
        self, files: RecordedFiles, legend: Mapping[str, Any], video: VideoWriter | None, quality: int | None
    ) -> None:
        """`quality` is that of JPEG."""
        self._files, self._legend, self._video = files, legend, video
        self._quality = DEFAULT_JPEG_QUALITY if quality is None else quality
        self._has_legend = False

    def write(self, number: int, frame: Frame | None, labels: UInt16[np.ndarray, "h w"] | None = None) -> None:
        """Take a frame of a sequence. Raises `OSError` where it can't be written."""
        if frame is not None and self._files.format == "exr":
            write_exr(self._files.color(number), frame, self._files.passes)
        elif frame is not None:
            self._write_passes(number, frame)
        if labels is not None:
            write_labels(self._files.beside(number, "labels"), labels, len(self._legend) - 1)
            if not self._has_legend:
                write_legend(self._files.legend, self._legend)
                self._has_legend = True

    def _write_passes(self, number: int, frame: Frame) -> None:
        files = self._files
        if self._video is not None:
            self._video.write(frame.to_uint8())
        elif "color" in files.passes and files.format == "npy":
            write_array(files.color(number), frame.rgba)
        elif "color" in files.passes and files.format == "jpeg":
            write_jpeg(files.color(number), frame.to_uint8(), self._quality)
        elif "color" in files.passes:
            write_picture(files.color(number), frame.to_uint8())
        if "depth" in files.passes and frame.depth is not None:
            write = write_array if files.format == "npy" else write_depth
            write(files.beside(number, "depth"), frame.depth)
        if "alpha" in files.passes:
            write_alpha(files.beside(number, "alpha"), frame.rgba[..., 3])
