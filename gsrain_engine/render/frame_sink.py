"""Where rendered frames go: a still, raw floats, a video, or a folder of numbered stills."""

from collections.abc import Generator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Protocol, runtime_checkable

from .frame import Frame
from .pictures import write_array, write_depth, write_picture
from .video import SUFFIXES, VideoWriter


@runtime_checkable
class FrameSink(Protocol):
    """Takes frames and knows what it has written."""

    written: list[Path]

    def write(self, number: int, frame: Frame) -> None:
        """Take a frame of a sequence."""
        ...


@contextmanager
def open_sink(path: Path, width: int, height: int, fps: float, *, with_depth: bool = False) -> Generator[FrameSink]:
    """Choose by suffix: .png, .npy, .mp4, .webm; anything without a suffix is a folder of PNG frames.

    Raises `ValueError` for another suffix.
    """
    suffix = path.suffix.lower()
    with ExitStack() as stack:
        if suffix in SUFFIXES:
            if with_depth:
                raise ValueError(f"{path}: depth can't go into a video; write a folder of frames")
            yield _Video(path, stack.enter_context(VideoWriter(path, width, height, fps)))
        elif suffix in (".png", ".npy", ""):
            yield _Stills(path, with_depth)
        else:
            raise ValueError(f"{path}: an output ends in .png, .npy, .mp4 or .webm, or is a folder without a suffix")


class _Video:
    def __init__(self, path: Path, writer: VideoWriter) -> None:
        self.written = [path]
        self._writer = writer

    def write(self, number: int, frame: Frame) -> None:
        self._writer.write(frame.to_uint8())


class _Stills:
    def __init__(self, path: Path, with_depth: bool) -> None:
        self.written: list[Path] = []
        self._path, self._with_depth = path, with_depth

    def write(self, number: int, frame: Frame) -> None:
        suffix = self._path.suffix.lower()
        target = self._path if suffix else self._path / f"{number:06d}.png"
        beside = target.with_name(f"{target.stem}.depth{target.suffix}")
        if suffix == ".npy":
            write_array(target, frame.rgba)
        else:
            write_picture(target, frame.to_uint8())
        if self._with_depth and frame.depth is not None:
            (write_array if suffix == ".npy" else write_depth)(beside, frame.depth)
        if suffix:
            self.written = [target, beside] if self._with_depth else [target]
        else:
            self.written = [self._path]
