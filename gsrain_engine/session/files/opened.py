"""Reading the scene that becomes a session's document."""

from dataclasses import dataclass
from pathlib import Path

from gsrain_engine.datasets.open_capture import capture_format
from gsrain_engine.scene.errors import SceneFormatError
from gsrain_engine.scene.formats.known_files import KnownFiles
from gsrain_engine.scene.open_scene import folder_to_read, is_built_in, open_to_draw, scene_folder_of
from gsrain_engine.scene.scene import Scene

from .autosave import Autosaved
from .disk_stamp import DiskStamp, stamp_of


@dataclass(frozen=True, eq=False)
class Opened:
    """A scene that was read, and what is known about where it came from."""

    scene: Scene
    source: str
    home: Path | None
    stamp: DiskStamp | None
    known: KnownFiles
    recovered: Autosaved | None = None


class CaptureNamedError(SceneFormatError):
    """A capture where a scene should be."""

    def __init__(self, path: Path, kind: str) -> None:
        """`kind` is the name of its row in the table of captures."""
        super().__init__(path, f"this is a capture ({kind}), not a scene; File > Open a capture shows it")
        self.path, self.kind = path, kind


def read_opened(path: str) -> Opened:
    """Read what a person names, as `open_to_draw` does, and raise what that raises.

    Raises `CaptureNamedError` where it is a capture instead.
    """
    try:
        return _read(path)
    except SceneFormatError:
        kind = capture_format(path) if scene_folder_of(Path(path)) is None else None
        if kind is None:
            raise
        raise CaptureNamedError(Path(path), kind.name) from None


def _read(path: str) -> Opened:
    known = KnownFiles()
    home = folder_to_read(Path(path)) if not is_built_in(path) else None
    stamp = stamp_of(home) if home is not None else None  # before reading: a change meanwhile is noticed
    source = path if is_built_in(path) else str(home or Path(path).absolute())
    return Opened(open_to_draw(path, known), source, home, stamp, known)


def read_kept(autosaved: Autosaved) -> Opened:
    """Read what an autosave has kept; raises what `open_to_draw` raises."""
    known, about = KnownFiles(), autosaved.about
    scene = open_to_draw(str(autosaved.scene), known)
    home = about.folder
    return Opened(scene, str(home or ""), home, about.stamp, known, autosaved)
