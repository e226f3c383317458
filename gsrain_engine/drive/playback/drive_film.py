"""A drive's video, written into a file."""

from collections.abc import Iterator
from itertools import chain
from pathlib import Path

from gsrain_engine.render.video import VideoWriter
from gsrain_engine.scene.progress import Progress

from .drive_video import DriveVideo

_PREVIEW_PX = 320


def film_drive(path: Path, video: DriveVideo, fps: float) -> Iterator[Progress]:
    """Write a video with so many frames a second; yields after each frame.

    Where a caller stops, what was written can be played.

    Raises:
        ValueError: For a suffix that is no video's.
        OSError: When the file can't be written.
    """
    pictures, count = video.pictures(fps), video.count(fps)
    first = next(pictures)
    every = max(first.shape[1] // _PREVIEW_PX, 1)
    with VideoWriter(path, first.shape[1], first.shape[0], fps) as writer:
        for number, picture in enumerate(chain([first], pictures), start=1):
            writer.write(picture)
            yield Progress(number / count, f"Frame {number} of {count}", picture[::every, ::every].copy())
