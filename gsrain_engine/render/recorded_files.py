"""The names of what a recording writes: one file or folder for each camera and its clear twin, passes beside them."""

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from gsrain_engine.scene.file_names import shortened

from .recording import Pass, Recording


@dataclass(frozen=True, slots=True)
class RecordedFiles:
    """Files of one camera.

    `still.png` has its passes beside it: `still.depth.png`; so do the frames of a folder: `frames/000007.depth.png`;
    those of a video get a folder each: `clip.depth/000007.png`. EXR holds colour, alpha and depth in one file.
    """

    path: Path
    format: str
    is_video: bool
    passes: frozenset[Pass]
    is_folder: bool
    """Whether `path` is a folder of frames; its name may have dots in it."""

    def color(self, number: int) -> Path:
        """Where the colours of a frame go."""
        ending = "jpg" if self.format == "jpeg" else self.format
        return self.path / f"{number:06d}.{ending}" if self.is_folder else self.path

    def beside(self, number: int, name: Pass) -> Path:
        """Where another pass of a frame goes."""
        kind = "npy" if self.format == "npy" and name == "depth" else "png"
        if self.is_video:
            return self._folder(name) / f"{number:06d}.{kind}"
        if self.is_folder:
            return self.path / f"{number:06d}.{name}.{kind}"
        return self.path.with_name(f"{self.path.stem}.{name}.{kind}")

    @property
    def legend(self) -> Path:
        """Where the meaning of the labels goes."""
        if self.is_video:
            return self._folder("labels") / "labels.json"
        return self.path / "labels.json" if self.is_folder else self.path.with_name(f"{self.path.stem}.labels.json")

    def roots(self) -> Iterator[Path]:
        """Every file and folder that is written, without what lies in a folder."""
        if self.is_folder:
            yield self.path
            return
        inside = {"color", "alpha", "depth"} if self.format == "exr" else {"color"}
        if self.passes & inside:
            yield self.path
        for name in sorted(self.passes - inside):
            yield self._folder(name) if self.is_video else self.beside(0, name)

    def _folder(self, name: str) -> Path:
        return self.path.with_name(f"{self.path.stem}.{name}")


def recorded_files(recording: Recording, camera: str | None, *, is_clear: bool = False) -> RecordedFiles:
    """Files of one camera, or of its clear twin, which is called `NAME.clear`; none where there is only one camera.

    Several cameras share a folder: `drive.mp4` becomes `drive/FRONT.mp4`. Depth and labels are the scene's own, with
    rain or without: the twin does not repeat them.
    """
    path, passes = recording.path, frozenset(recording.passes)
    if camera is not None:
        suffix = path.suffix or recording.usual_suffix
        path = path.with_suffix("") / (shortened(re.sub(r"[^\w-]+", "_", camera)) + suffix)
    is_folder = path.suffix == ""
    if is_clear:
        path, passes = path.with_name(f"{path.stem}.clear{path.suffix}"), passes - {"depth", "labels"}
    return RecordedFiles(path, recording.format, recording.is_video, passes, is_folder)


def outputs(recording: Recording, cameras: Sequence[str]) -> list[Path]:
    """Every file and folder that a recording of these cameras writes."""
    names = cameras if len(cameras) > 1 else [None]
    twins = (False, True) if recording.twin else (False,)
    return [path for name in names for twin in twins for path in recorded_files(recording, name, is_clear=twin).roots()]
