"""Videos with PyAV: H.264 or AV1 in MP4, VP9 or AV1 in WebM; deterministic, and playable if interrupted."""

import os
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from fractions import Fraction
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import UInt8

from ..safe_io.limits import open_file
from .export_settings import DEFAULT_QUALITY

SUFFIXES = (".mp4", ".webm")
_GROUP = 30  # frames between key frames: the maximum loss in an interrupted file


_ENCODERS: dict[str, tuple[str, dict[str, str]]] = {
    # mbtree=0: its lookahead, and thus the bytes, depend on the number of threads.
    "h264": ("libx264", {"preset": "medium", "x264-params": "mbtree=0"}),
    "vp9": ("libvpx-vp9", {"b": "0", "deadline": "good", "cpu-used": "4"}),
    "av1": ("libsvtav1", {"preset": "8", "svtav1-params": "lp=1"}),
}

_CONTAINERS = {
    # A fragmented file is complete up to its last fragment even after kill -9.
    ".mp4": {"movflags": "hybrid_fragmented", "flush_packets": "1"},
    ".webm": {"fflags": "+bitexact", "cluster_time_limit": "1000"},
}

_CODECS = {".mp4": ("h264", "av1"), ".webm": ("vp9", "av1")}


def can_write_videos() -> bool:
    """True if PyAV is installed; frozen programs omit it."""
    return find_spec("av") is not None


def read_video(path: Path) -> Iterator[UInt8[np.ndarray, "h w 3"]]:
    """Decode the frames of a video as display color (RGB). Raises `ValueError` for a file that isn't one."""
    av = _imported(path)
    with open_file(path) as file:
        try:
            with av.open(file, metadata_errors="ignore") as container:
                if not container.streams.video:
                    raise ValueError(f"{path}: no video in it")
                for frame in container.decode(container.streams.video[0]):
                    yield frame.to_ndarray(format="rgb24")
        except av.FFmpegError as error:
            raise ValueError(f"{path}: not a readable video ({error.strerror})") from None


def _imported(path: Path) -> Any:
    """PyAV, imported lazily: PyInstaller builds omit it, since its wheel contains encoders under the GPL."""
    try:
        import av
    except ImportError as error:
        raise ValueError(
            f"{path}: videos need PyAV, which is not here (pip install av; a frozen program never has it); "
            "a folder of pictures or .exr goes without"
        ) from error
    return av


class VideoWriter:
    """Writes frames of one size. Use it in a `with` block, which finalizes the file, also after an exception."""

    def __init__(
        self, path: Path, width: int, height: int, fps: float, *, codec: str | None = None, quality: int | None = None,
        has_alpha: bool = False,
    ) -> None:  # fmt: skip
        """Open a video file; its suffix selects the format, and the codec if `codec` is None.

        `has_alpha` is possible with VP9. `quality` is the encoder's constant rate factor: lower is better and larger.
        Raises `ValueError` for a suffix, codec or size that can't be encoded, and if PyAV is missing.
        """
        suffix = path.suffix.lower()
        if suffix not in _CODECS:
            raise ValueError(f"{path}: a video ends in {' or '.join(SUFFIXES)}")
        if codec is not None and codec not in _CODECS[suffix]:
            raise ValueError(f"{path}: {suffix} holds {' or '.join(_CODECS[suffix])}, not {codec}")
        if width % 2 or height % 2:
            raise ValueError(f"{path}: a video needs an even width and height, got {width}x{height}")
        self._av: Any = _imported(path)
        codec = codec or _CODECS[suffix][0]
        encoder, options = _ENCODERS[codec]
        options = {"crf": str(DEFAULT_QUALITY[codec] if quality is None else quality), **options}
        if encoder == "libsvtav1":
            os.environ.setdefault("SVT_LOG", "1")  # errors only: SVT-AV1 is verbose on the console
        path.parent.mkdir(parents=True, exist_ok=True)
        # Ctrl-C is raised in the main thread, and would be lost inside a callback from FFmpeg.
        self._thread = ThreadPoolExecutor(1, "video")
        self._file = ErrorCapturingFile(path)
        self._container: Any = self._av.open(self._file, mode="w", format=suffix[1:], options=_CONTAINERS[suffix])
        rate = Fraction(fps).limit_denominator(1001)
        self._stream: Any = self._container.add_stream(encoder, rate=rate, options=options)
        self._stream.width, self._stream.height, self._stream.pix_fmt = width, height, "yuv420p"
        if has_alpha:  # VP9 alone: the alpha is a second stream within the first
            self._stream.pix_fmt, self._stream.metadata["alpha_mode"] = "yuva420p", "1"
        self._stream.codec_context.gop_size = _GROUP

    def write(self, pixels: UInt8[np.ndarray, "h w c"]) -> None:
        """Add a frame, RGB or RGBA with straight alpha. Raises `OSError` if it can't be written."""
        form = "rgba" if pixels.shape[2] == 4 else "rgb24"
        frame = self._av.VideoFrame.from_ndarray(np.ascontiguousarray(pixels), format=form)
        self._thread.submit(self._mux, self._container, frame).result()

    def close(self) -> None:
        """Flush the encoder and finalize the file. Raises `OSError` if it can't be written."""
        if self._container is not None:
            container, self._container = self._container, None
            with self._thread:
                self._thread.submit(self._end, container).result()

    def __enter__(self) -> "VideoWriter":
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if kind is not None and issubclass(kind, OSError):
            with suppress(OSError):  # a full disk has been reported already
                self.close()
        else:
            self.close()

    def _mux(self, container: Any, frame: Any) -> None:
        container.mux(self._stream.encode(frame))
        self._file.check()

    def _end(self, container: Any) -> None:
        container.mux(self._stream.encode(None))
        container.close()
        self._file.close()
        self._file.check()


class ErrorCapturingFile:
    """File object that stores the first write error and pretends success from then on.

    FFmpeg's fragmented MP4 ends the process if it is closed after an error of its output.
    """

    def __init__(self, path: Path) -> None:
        """Open a file for writing, unbuffered: written data survives the process."""
        self._path, self._file = path, path.open("wb", buffering=0)
        self._position = self._end = 0
        self.error: OSError | None = None

    def check(self) -> None:
        if self.error is not None:
            raise self.error

    def write(self, data: bytes) -> int:
        if self.error is None:
            try:
                self._file.seek(self._position)
                rest = memoryview(data)
                while rest:
                    rest = rest[self._file.write(rest) :]
            except OSError as error:
                self.error = OSError(error.errno, error.strerror, str(self._path))
        self._position += len(data)
        self._end = max(self._end, self._position)
        return len(data)

    def seek(self, offset: int, whence: int = 0) -> int:
        self._position = offset + (0, self._position, self._end)[whence]
        return self._position

    def tell(self) -> int:
        return self._position

    def close(self) -> None:
        self._file.close()
