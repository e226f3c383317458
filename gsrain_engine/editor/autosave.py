"""Autosaves: a copy of the unsaved document beside its scene folder, that outlives the process when it is killed."""

import hashlib
import logging
import os
import secrets
import shutil
from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import msgspec
import numpy as np
from msgspec import Meta

from ..render.renderer import RenderMode
from ..safe_io.limits import read_file
from ..scene.files import FileLock, sentence_of, whole_file
from ..scene.formats.scene_folder import SCENE_FILE, FileCache, write_scene_folder
from ..scene.scene import Scene
from .preferences import state_folder
from .viewport.camera import FASTEST_M_S, SLOWEST_M_S, OrbitCamera
from .viewport_state import ViewportState

logger = logging.getLogger("gsrain")

_SCENE, _ABOUT = "scene", "autosave.json"

_LONGEST_NAME = 200
"""Bytes of a scene folder's name that go into that of its autosave; disks take 255."""

# § What a scene folder looked like when it was read or written: to notice that somebody else has changed it since.


class FileFingerprint(msgspec.Struct, frozen=True, kw_only=True):
    """State of a folder's `scene.json`."""

    modified_ns: int
    size: int
    digest: str


class AutosaveEntry(msgspec.Struct, frozen=True, kw_only=True):
    """What an autosave belongs to."""

    name: str
    home: str | None = None
    """The scene folder that the document came from."""
    home_bytes: bytes | None = None
    """The same where its name is no Unicode."""
    stamp: FileFingerprint | None = None
    """State of that folder when the document came from it."""

    @property
    def folder(self) -> Path | None:
        """The scene folder that the document came from."""
        home = self.home_bytes or self.home
        return None if home is None else Path(os.fsdecode(home))


class RecoveryCandidate(msgspec.Struct, frozen=True):
    """An autosave that was found."""

    place: Path
    about: AutosaveEntry
    saved_at: float
    """Seconds since 1970."""

    @property
    def scene(self) -> Path:
        return self.place / _SCENE


class FolderClaim(NamedTuple):
    """What was found out about a scene folder when a process went to it."""

    is_alone: bool
    """Whether no other process has it open."""
    found: RecoveryCandidate | None = None
    """What a process that died has kept of it."""


class Autosave:
    """The autosave of one process: where it goes, and the locks that tell others that this process lives.

    For one thread at a time: the one that reads and writes files.
    """

    def __init__(self) -> None:
        self._home: Path | None = None
        self._place: Path | None = None
        self._about: AutosaveEntry | None = None
        self._locks: dict[Path, FileLock] = {}

    @property
    def place(self) -> Path | None:
        """Where the document is kept; None while nothing is."""
        return self._place

    def enter(self, home: Path | None, recovered: Path | None = None) -> FolderClaim:
        """Go to another document: what was kept of the one before is removed.

        `home` is the scene folder that it came from, `recovered` the autosave to go on with.
        """
        if self._place != recovered:
            self.remove()
        self._home, self._place, self._about = home, None, None
        place = autosave_folder(home) if home is not None else None
        for other in [each for each in self._locks if each not in (place, recovered)]:
            self._locks.pop(other).release()
        if recovered is not None and self._hold(recovered):
            self._place = recovered
        if place is None:
            return FolderClaim(True)
        return FolderClaim(self._hold(place), None if self._place == place else self.found(place))

    def found(self, place: Path) -> RecoveryCandidate | None:
        """What lies at a place that belongs to no other living process."""
        if place not in self._locks and not _is_free(place):
            return None
        try:
            about = msgspec.json.decode(read_file(place / _ABOUT), type=AutosaveEntry)
            return RecoveryCandidate(place, about, (place / _SCENE / SCENE_FILE).stat().st_mtime)
        except (OSError, msgspec.DecodeError, UnicodeDecodeError, RecursionError):
            return None

    def abandoned(self, homes: Iterable[Path]) -> list[RecoveryCandidate]:
        """Autosaves of processes that died: those of these scenes, and those that never had a home. Latest first."""
        unsaved = [each for each in _unsaved().glob("*") if each.is_dir()] if _unsaved().is_dir() else []
        found = [self.found(place) for place in (*map(autosave_folder, homes), *unsaved)]
        for place in unsaved:
            if place not in self._locks and not (place / _SCENE / SCENE_FILE).exists() and _is_free(place):
                shutil.rmtree(place, ignore_errors=True)  # its process died before there was anything in it
        return sorted((each for each in found if each is not None), key=lambda each: -each.saved_at)

    def write(self, scene: Scene, stamp: FileFingerprint | None, known: FileCache) -> None:
        """Keep a document: beside its home where that can be, else among those that have none.

        Raises:
            SceneFormatError: When the document could not be read again.
            OSError: When it can be written nowhere.
        """
        about = _about(scene.name, self._home, stamp)
        place = self._place or self._folder_next_to_scene() or self._new_place()
        try:
            self._write_at(place, about, scene, known)
        except OSError as error:
            if place.parent == _unsaved():
                raise
            # Its disk is full, or takes no file any more; another one may.
            logger.warning("The autosave can't be in %s: %s", place.parent, sentence_of(error))
            self._write_elsewhere(place, about, scene, known)

    def _folder_next_to_scene(self) -> Path | None:
        """Where it may go beside its home; None where another process does, or where something is to be recovered."""
        if self._home is None or autosave_folder(self._home) not in self._locks:
            return None
        here = autosave_folder(self._home)
        if self.found(here) is not None or not os.access(here.parent, os.W_OK):
            return None
        if here.exists():  # a process was killed before there was anything in it
            _remove(here)
        return here

    def _new_place(self) -> Path:
        place = _unsaved() / f"{os.getpid()}-{secrets.token_hex(4)}"
        self._hold(place)
        return place

    def _write_elsewhere(self, before: Path, about: AutosaveEntry, scene: Scene, known: FileCache) -> None:
        """Write among those that have no home; what was kept before stays until then, and for good where that fails."""
        place, self._about = self._new_place(), None
        try:
            self._write_at(place, about, scene, known)
        except BaseException:
            _remove(place)
            if place in self._locks:
                self._locks.pop(place).release()
            self._place, self._about = before if (before / _ABOUT).exists() else None, None
            raise
        _remove(before)

    def _write_at(self, place: Path, about: AutosaveEntry, scene: Scene, known: FileCache) -> None:
        place.mkdir(parents=True, exist_ok=True)
        if about != self._about:
            with whole_file(place / _ABOUT) as file:
                file.write_bytes(msgspec.json.encode(about))
            self._about = about
        self._place = place
        write_scene_folder(scene, place / _SCENE, known, linking=True, in_drawing_order=True)

    def remove(self) -> None:
        """Remove what was kept: the document is saved, or given up."""
        place, self._place, self._about = self._place, None, None
        if place is not None:
            _remove(place)

    def discard(self, place: Path) -> None:
        """Remove what was kept at a place, unless another living process goes on with it."""
        if place in self._locks or _is_free(place):
            _remove(place)

    def close(self) -> None:
        """Let others have what this process held; what is kept stays, unless it was removed before."""
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
    """Where the autosave of a scene folder goes."""
    name = os.fsencode(home.name)
    if len(name) > _LONGEST_NAME:
        name = name[:_LONGEST_NAME] + b"." + hashlib.blake2b(name, digest_size=6).hexdigest().encode()
    return home.with_name(f".{os.fsdecode(name)}.autosave")


def _about(name: str, home: Path | None, stamp: FileFingerprint | None) -> AutosaveEntry:
    if home is None:
        return AutosaveEntry(name=name, stamp=stamp)
    in_bytes = os.fsencode(home)
    try:
        return AutosaveEntry(name=name, home=in_bytes.decode(), stamp=stamp)
    except UnicodeDecodeError:
        return AutosaveEntry(name=name, home_bytes=in_bytes, stamp=stamp)


def _remove(place: Path) -> None:
    """Remove an autosave; first what makes it one."""
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


def fingerprint_of(folder: Path) -> FileFingerprint | None:
    """State of a scene folder now; None where there is no scene."""
    file = folder / SCENE_FILE
    try:
        status, data = file.stat(), read_file(file)
    except OSError:
        return None
    digest = hashlib.blake2b(data, digest_size=16).hexdigest()
    return FileFingerprint(modified_ns=status.st_mtime_ns, size=len(data), digest=digest)


def has_changed(folder: Path, since: FileFingerprint | None) -> bool:
    """Whether a scene stands there that is not the one of before; to be touched alone is no change."""
    try:
        status = (folder / SCENE_FILE).stat()
    except OSError:
        return False  # gone: nothing that could be lost
    if since is not None and (status.st_mtime_ns, status.st_size) == (since.modified_ns, since.size):
        return False
    now = fingerprint_of(folder)
    return now is not None and (since is None or now.digest != since.digest)


# § A session's document as one value, as it goes into files.


def saved_scene(session: ViewportState) -> Scene:
    """The scene with its rain, its weather, and from where it is looked at."""
    weather = msgspec.to_builtins(session.weather) if session.weather.keys else None
    return replace(
        session.scene, rain=msgspec.to_builtins(session.rain), weather=weather, view=capture_view_state(session)
    )


# § The view that goes with a saved scene: from where, and how, it was looked at.

_Triple = tuple[float, float, float]


class SavedView(msgspec.Struct, frozen=True, kw_only=True):
    """World frame (metres, z up). What a newer program has written besides is passed over."""

    position: _Triple
    heading: float
    """Radians from +x to +y."""
    pitch: float
    """Radians, upwards."""
    distance_m: Annotated[float, Meta(gt=0)]
    vertical_fov_deg: Annotated[float, Meta(gt=0, lt=180)]
    speed_m_s: Annotated[float, Meta(ge=SLOWEST_M_S, le=FASTEST_M_S)]
    time_s: float = 0.0
    background: _Triple = (0.0, 0.0, 0.0)
    gain_ev: Annotated[float, Meta(ge=-10, le=10)] = 0.0
    look: RenderMode = "splats"


def capture_view_state(session: ViewportState) -> dict[str, Any]:
    """Plain values of what a session looks at now."""
    eye, view = session.navigation, session.view
    x, y, z = eye.position.tolist()
    kept = SavedView(
        position=(x, y, z),
        heading=float(eye.heading),
        pitch=float(eye.pitch),
        distance_m=float(eye.distance_m),
        vertical_fov_deg=float(eye.vertical_fov_deg),
        speed_m_s=float(eye.speed_m_s),
        time_s=float(session.clock.time_s),
        background=view.background,
        gain_ev=view.gain_ev,
        look=view.look,
    )
    return msgspec.to_builtins(kept)


def restore_view(session: ViewportState, values: Mapping[str, Any]) -> None:
    """Look from where a scene was looked at when it was saved; values that can't be used are told of and left."""
    try:
        kept = msgspec.convert(values, SavedView)
    except msgspec.ValidationError as error:
        logger.warning("%s: the saved view can't be used: %s", session.scene.name, error)
        return
    session.navigation = OrbitCamera(
        np.array(kept.position), kept.heading, kept.pitch, kept.distance_m, kept.vertical_fov_deg, kept.speed_m_s
    )
    session.clock.time_s = kept.time_s
    session.view.background, session.view.gain_ev, session.view.look = kept.background, kept.gain_ev, kept.look
