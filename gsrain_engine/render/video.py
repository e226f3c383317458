"""Video out by PyAV: H.264 in MP4 or VP9 in WebM, the same bytes every time, playable whenever it stops."""

from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import numpy as np
from jaxtyping import UInt8

SUFFIXES = (".mp4", ".webm")

_GROUP = 30
"""Frames between key frames: what a torn file can lose at most."""

_ENCODERS: dict[str, tuple[str, dict[str, str], dict[str, str]]] = {
    # A fragmented file is complete up to its last fragment even after kill -9. mbtree=0: its lookahead depends on the
    # number of threads, and so would the bytes.
    ".mp4": (
        "libx264",
        {"preset": "medium", "crf": "18", "x264-params": "mbtree=0"},
        {"movflags": "hybrid_fragmented", "flush_packets": "1"},
    ),
    ".webm": (
        "libvpx-vp9",
        {"crf": "24", "b": "0", "deadline": "good", "cpu-used": "4"},
        {"fflags": "+bitexact", "cluster_time_limit": "1000"},
    ),
}


class VideoWriter:
    """Writes frames of one size. Use it in a `with` block: leaving it, even by an exception, ends the file properly."""

    def __init__(self, path: Path, width: int, height: int, fps: float) -> None:
        """Open a video file; its suffix chooses the format.

        Raises `ValueError` for a suffix or a size that can't be encoded.
        """
        if path.suffix.lower() not in _ENCODERS:
            raise ValueError(f"{path}: a video ends in {' or '.join(SUFFIXES)}")
        if width % 2 or height % 2:
            raise ValueError(f"{path}: a video needs an even width and height, got {width}x{height}")
        codec, options, container = _ENCODERS[path.suffix.lower()]
        path.parent.mkdir(parents=True, exist_ok=True)
        self._container: Any = av.open(str(path), mode="w", options=container)
        rate = Fraction(fps).limit_denominator(1001)
        self._stream: Any = self._container.add_stream(codec, rate=rate, options=options)
        self._stream.width, self._stream.height = width, height
        self._stream.pix_fmt = "yuv420p"
        self._stream.codec_context.gop_size = _GROUP

    def write(self, pixels: UInt8[np.ndarray, "h w 3"]) -> None:
        """Add a frame."""
        frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(pixels), format="rgb24")
        self._container.mux(self._stream.encode(frame))

    def close(self) -> None:
        """Write what the encoder still holds and end the file."""
        if self._container is not None:
            self._container.mux(self._stream.encode(None))
            self._container.close()
            self._container = None

    def __enter__(self) -> "VideoWriter":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
