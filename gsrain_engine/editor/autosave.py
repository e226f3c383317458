"""Autosave and crash recovery: copies of unsaved documents, change detection of scene folders, and the saved view."""

import hashlib
import logging
import os
import secrets
import shutil
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import msgspec
import numpy as np
from msgspec import Meta

from ..choices import RenderMode
from ..safe_io.errors import sentence_of
from ..safe_io.files import FileLock, whole_file
from ..safe_io.limits import read_file
from ..scene.formats.scene_folder import SCENE_FILE, FileCache, scene_folder_files, write_scene_folder
from ..scene.scene import Scene
from .preferences import state_folder
from .viewport.camera import FASTEST_M_S, SLOWEST_M_S, OrbitCamera
from .viewport_state import ViewportState

logger = logging.getLogger("gsrain")
_SCENE, _ABOUT = "scene", "autosave.json"
_MAX_NAME_BYTES = 200  # of a scene folder's name within its autosave's name; file systems allow 255

# Change detection of scene folders


class FileFingerprint(msgspec.Struct, frozen=True, kw_only=True):
    """State of a folder's `scene.json` and of the files that it names, to detect changes by other programs."""

    modified_ns: int
    size: int
    digest: str
    files: dict[str, tuple[int, int]] = {}
    """Modification time (ns) and bytes of each file, by its name in the folder."""


def fingerprint_of(folder: Path) -> FileFingerprint | None:
    """State of a scene folder now; None if it holds no scene."""
    file = folder / SCENE_FILE
    try:
        status, data = file.stat(), read_file(file)
    except OSError:
        return None
    digest = hashlib.blake2b(data, digest_size=16).hexdigest()
    try:
        places = scene_folder_files(folder)[1:]
        files = {str(place.relative_to(folder.resolve())): _state(place) for place in places}
    except (OSError, ValueError):  # a file is missing
        files = {}
    return FileFingerprint(modified_ns=status.st_mtime_ns, size=len(data), digest=digest, files=files)


def _state(file: Path) -> tuple[int, int]:
    status = file.stat()
    return status.st_mtime_ns, status.st_size


def has_changed(folder: Path, since: FileFingerprint | None) -> bool:
    """Return whether the folder holds a scene with other content; a removed file can't be overwritten.

    A new modification time alone does not count of `scene.json`, but of the large files.
    """
    for name, state in ({} if since is None else since.files).items():
        with suppress(OSError):
            if _state(folder / name) != state:
                return True
    try:
        status = (folder / SCENE_FILE).stat()
    except OSError:
        return False  # gone: nothing can be overwritten
    if since is not None and (status.st_mtime_ns, status.st_size) == (since.modified_ns, since.size):
        return False
    now = fingerprint_of(folder)
    return now is not None and (since is None or now.digest != since.digest)


# Autosave


class AutosaveEntry(msgspec.Struct, frozen=True, kw_only=True):
    """Scene folder and state that an autosave belongs to."""

    name: str
    home: str | None = None
    """Scene folder that the document came from."""
    home_bytes: bytes | None = None
    """The same path as bytes, for names that are not valid Unicode."""
    stamp: FileFingerprint | None = None
    """State of that folder when the document came from it."""

    @classmethod
    def of(cls, name: str, home: Path | None, stamp: FileFingerprint | None) -> "AutosaveEntry":
        if home is None:
            return cls(name=name, stamp=stamp)
        in_bytes = os.fsencode(home)
        try:
            return cls(name=name, home=in_bytes.decode(), stamp=stamp)
        except UnicodeDecodeError:
            return cls(name=name, home_bytes=in_bytes, stamp=stamp)

    @property
    def folder(self) -> Path | None:
        home = self.home_bytes or self.home
        return None if home is None else Path(os.fsdecode(home))


class RecoveryCandidate(msgspec.Struct, frozen=True):
    """An autosave found on disk."""

    place: Path
    about: AutosaveEntry
    saved_at: float
    """Seconds since 1970."""

    @property
    def scene(self) -> Path:
        return self.place / _SCENE


class Autosave:
    """The autosave of one process, and the locks that mark this process as alive.

    Not thread-safe: only the thread that reads and writes files may use it.
    """

    def __init__(self) -> None:
        self.place: Path | None = None
        """Folder of the current autosave; None if there is no autosave."""
        self._home: Path | None = None
        self._about: AutosaveEntry | None = None
        self._locks: dict[Path, FileLock] = {}

    def enter(self, home: Path | None, recovered: Path | None = None) -> tuple[bool, RecoveryCandidate | None]:
        """Switch to another document and remove the autosave of the previous one.

        `home` is the scene folder of the document, `recovered` the autosave to continue with. Returns True if no other
        process has the folder open, and the autosave that a process left there when it died.
        """
        if self.place != recovered:
            self.remove()
        self._home, self.place, self._about = home, None, None
        place = autosave_folder(home) if home is not None else None
        for other in [each for each in self._locks if each not in (place, recovered)]:
            self._locks.pop(other).release()
        if recovered is not None and self._hold(recovered):
            self.place = recovered
        if place is None:
            return True, None
        return self._hold(place), None if self.place == place else self.found(place)

    def found(self, place: Path) -> RecoveryCandidate | None:
        """Return the autosave at a place, or None if another living process owns it."""
        if place not in self._locks and not _is_free(place):
            return None
        try:
            about = msgspec.json.decode(read_file(place / _ABOUT), type=AutosaveEntry)
            return RecoveryCandidate(place, about, (place / _SCENE / SCENE_FILE).stat().st_mtime)
        except (OSError, msgspec.DecodeError, UnicodeDecodeError, RecursionError):
            return None

    def abandoned(self, homes: Iterable[Path]) -> list[RecoveryCandidate]:
        """Autosaves of dead processes for these scenes and for never-saved documents, latest first."""
        unsaved = [each for each in _unsaved().glob("*") if each.is_dir()] if _unsaved().is_dir() else []
        found = [self.found(place) for place in (*map(autosave_folder, homes), *unsaved)]
        for place in unsaved:
            if place not in self._locks and not (place / _SCENE / SCENE_FILE).exists() and _is_free(place):
                shutil.rmtree(place, ignore_errors=True)  # its process died before it wrote anything
        return sorted((each for each in found if each is not None), key=lambda each: -each.saved_at)

    def write(self, scene: Scene, home: Path | None, stamp: FileFingerprint | None, known: FileCache) -> None:
        """Write an autosave next to the scene folder, or in the state folder if that is not possible.

        `home` is the folder that the scene is saved to, and `stamp` its state; None for one that has none yet.

        Raises SceneFormatError if the document could not be read again, OSError if it can't be written anywhere.
        """
        about = AutosaveEntry.of(scene.name, home, stamp)
        place = self.place or self._folder_next_to_scene() or self._new_place()
        try:
            self._write_at(place, about, scene, known)
        except OSError as error:
            if place.parent == _unsaved():
                raise
            # The disk is full or refuses writes; another disk may work.
            logger.warning("The autosave can't be in %s: %s", place.parent, sentence_of(error))
            other, self._about = self._new_place(), None
            try:
                self._write_at(other, about, scene, known)
            except BaseException:
                _remove(other)
                if other in self._locks:
                    self._locks.pop(other).release()
                self.place, self._about = place if (place / _ABOUT).exists() else None, None
                raise
            _remove(place)  # the earlier autosave, only now

    def _folder_next_to_scene(self) -> Path | None:
        """Autosave folder next to the scene; None if another process owns it or it holds something to recover."""
        here = autosave_folder(self._home) if self._home is not None else None
        if here is None or here not in self._locks or self.found(here) is not None:
            return None
        if not os.access(here.parent, os.W_OK):
            return None
        if here.exists():  # a process was killed before it wrote anything
            _remove(here)
        return here

    def _new_place(self) -> Path:
        place = _unsaved() / f"{os.getpid()}-{secrets.token_hex(4)}"
        self._hold(place)
        return place

    def _write_at(self, place: Path, about: AutosaveEntry, scene: Scene, known: FileCache) -> None:
        place.mkdir(parents=True, exist_ok=True)
        if about != self._about:
            with whole_file(place / _ABOUT) as file:
                file.write_bytes(msgspec.json.encode(about))
            self._about = about
        self.place = place
        write_scene_folder(scene, place / _SCENE, known, linking=True, in_drawing_order=True)

    def remove(self) -> None:
        """Remove the autosave, after the document was saved or discarded."""
        place, self.place, self._about = self.place, None, None
        if place is not None:
            _remove(place)

    def discard(self, place: Path) -> None:
        """Remove an autosave, unless another living process uses it."""
        if place in self._locks or _is_free(place):
            _remove(place)

    def close(self) -> None:
        """Release all locks; an autosave that was not removed remains."""
        while self._locks:
            self._locks.popitem()[1].release()

    def _hold(self, place: Path) -> bool:
        if place in self._locks:
            return True
        try:
            lock = FileLock.take(_lock_file(place))
        except OSError as error:
            logger.warning("No lock can be had in %s: %s", state_folder(), error.strerror or error)
            return True
        if lock is not None:
            self._locks[place] = lock
        return lock is not None


def autosave_folder(home: Path) -> Path:
    """Path of the autosave of a scene folder."""
    name = os.fsencode(home.name)
    if len(name) > _MAX_NAME_BYTES:
        name = name[:_MAX_NAME_BYTES] + b"." + hashlib.blake2b(name, digest_size=6).hexdigest().encode()
    return home.with_name(f".{os.fsdecode(name)}.autosave")


def _remove(place: Path) -> None:
    """Remove an autosave, its description first so that a partial removal is not offered for recovery."""
    (place / _ABOUT).unlink(missing_ok=True)
    shutil.rmtree(place, ignore_errors=True)


def _is_free(place: Path) -> bool:
    try:
        lock = FileLock.take(_lock_file(place))
    except OSError:
        return True
    if lock is not None:
        lock.release()
    return lock is not None


def _lock_file(place: Path) -> Path:
    name = hashlib.blake2b(str(place).encode(errors="replace"), digest_size=12).hexdigest()
    return state_folder() / "locks" / name


def _unsaved() -> Path:
    return state_folder() / "unsaved"


# The document as one scene, with its view

_Triple = tuple[float, float, float]


class SavedView(msgspec.Struct, frozen=True, kw_only=True):
    """View saved with a scene, in the world frame (meters, z up). Unknown fields of newer versions are ignored."""

    position: _Triple
    heading: float
    """Radians from +x to +y."""
    pitch: float
    """Radians, upward."""
    distance_m: Annotated[float, Meta(gt=0)]
    vertical_fov_deg: Annotated[float, Meta(gt=0, lt=180)]
    speed_m_s: Annotated[float, Meta(ge=SLOWEST_M_S, le=FASTEST_M_S)]
    time_s: float = 0.0
    background: _Triple = (0.0, 0.0, 0.0)
    gain_ev: Annotated[float, Meta(ge=-10, le=10)] = 0.0
    look: RenderMode = "splats"
    orthographic: bool = False


def saved_scene(viewport: ViewportState) -> Scene:
    """The scene of the document with its rain, keyframes, and current view."""
    document, eye, options = viewport.document, viewport.navigation, viewport.options
    x, y, z = eye.position.tolist()
    saved_view = SavedView(
        position=(x, y, z),
        heading=float(eye.heading),
        pitch=float(eye.pitch),
        distance_m=float(eye.distance_m),
        vertical_fov_deg=float(eye.vertical_fov_deg),
        speed_m_s=float(eye.speed_m_s),
        time_s=float(viewport.playback.clock.time_s),
        background=options.background,
        gain_ev=options.gain_ev,
        look=options.look,
        orthographic=options.orthographic,
    )
    rain, keyframes, view = map(msgspec.to_builtins, (document.rain, document.keyframes, saved_view))
    return replace(document.scene, rain=rain, weather=keyframes if document.keyframes.keys else None, view=view)


def restore_view(viewport: ViewportState, values: Mapping[str, Any]) -> None:
    """Restore the view saved with a scene; invalid values are logged and ignored."""
    try:
        saved = msgspec.convert(values, SavedView)
    except msgspec.ValidationError as error:
        logger.warning("%s: the saved view can't be used: %s", viewport.document.scene.name, error)
        return
    viewport.navigation = OrbitCamera(
        np.array(saved.position), saved.heading, saved.pitch, saved.distance_m, saved.vertical_fov_deg, saved.speed_m_s
    )
    viewport.playback.clock.time_s = saved.time_s
    options = viewport.options
    options.background, options.gain_ev, options.look = saved.background, saved.gain_ev, saved.look
    options.orthographic = saved.orthographic
