"""Camera paths from files and recorded drives into the document, and out into files."""

import logging
from collections.abc import Callable
from pathlib import Path

import numpy as np

from gsrain_engine.scene.drive_path import drive_path
from gsrain_engine.scene.errors import SceneFormatError
from gsrain_engine.scene.paths.camera_path import CameraPath
from gsrain_engine.scene.paths.edits import shifted
from gsrain_engine.scene.paths.export import write_nerfstudio_path, write_training_cameras
from gsrain_engine.scene.paths.files import read_camera_path, write_camera_path
from gsrain_engine.scene.paths.pace import WALKING_M_S, paced
from gsrain_engine.scene.paths.trajectory import every, simplified, snapped_key
from gsrain_engine.scene.scene import RigCamera

from ..document.viewed_document import ViewedDocument
from ..view.home_camera import front_camera
from .edits import set_path

logger = logging.getLogger("gsrain")

_VIEW_SIZE = (960, 640)
_TOLERANCE_M = 0.05
"""How far a path with few keys may be from the drive it was taken from: less than a lens is wide."""


def import_path(session: ViewedDocument, file: Path) -> None:
    """Take the camera path of a file; what is wrong with it is kept in `problem`, and the present path stays."""
    try:
        path = read_camera_path(file)
    except SceneFormatError as error:
        session.problem = str(error)
        logger.error("%s", error)
    else:
        path = path if path.start_s >= 0 else shifted(path, -path.start_s)  # a scene's time begins at 0
        if not path.is_timed:
            path = paced(path, WALKING_M_S / session.scene.metres_per_unit)
            logger.info("%s has no times: it is flown at walking pace, %g m/s", file.name, WALKING_M_S)
        set_path(session, f"Import {file.name}", path)
        session.timeline.key = None
        logger.info("Imported %s: %d keys, %.1f s", file.name, len(path.times_s), path.duration_s)


def export_path(session: ViewedDocument, file: Path) -> None:
    """Write the path that is ridden along as our own JSON: keys and what lies between them."""
    _export(session, file, write_camera_path)


def export_nerfstudio(session: ViewedDocument, file: Path) -> None:
    """Write every frame of the path as nerfstudio's camera_path.json."""
    _export(session, file, lambda target, path: write_nerfstudio_path(target, path, session.timeline.fps))


def export_training_cameras(session: ViewedDocument, file: Path) -> None:
    """Write every frame of the path as cameras of 3DGS."""
    _export(session, file, lambda target, path: write_training_cameras(target, path, session.timeline.fps))


def rig_cameras(session: ViewedDocument) -> list[RigCamera]:
    """Cameras that a drive can be taken from: those of all rigs, where there is an ego track."""
    scene = session.scene
    if scene.ego is None or not len(scene.ego.times):
        return []
    return [camera for rig in scene.rigs.values() for camera in rig]


def path_from_drive(session: ViewedDocument, camera: RigCamera | None = None, every_s: float = 0.0) -> None:
    """Make the drive of a rig camera the person's path, with a key every so many seconds.

    Without a camera it is the one that looks ahead. 0 s takes as few keys as stay within 5 cm and half a degree.
    """
    drive = _drive(session, camera)
    if drive is None:
        session.problem = "This scene has no ego vehicle with a camera, so there is no drive to take a path from."
        return
    few = simplified(drive, _TOLERANCE_M) if every_s <= 0 else every(drive, every_s)
    set_path(session, "Camera path from the drive", few.moved(np.linalg.inv(session.scene.scene_to_world)))
    session.timeline.key = None
    logger.info("Path from the drive: %d keys of %d samples", len(few.times_s), len(drive.times_s))


def snap_key(session: ViewedDocument, key: int) -> None:
    """Lay a key onto the nearest place of the drive, looking as its camera does there."""
    path, drive = session.scene.path, _drive(session, None)
    if drive is None:
        session.problem = "This scene has no ego vehicle with a camera, so there is no drive to snap to."
    elif path is not None:
        to_scene = np.linalg.inv(session.scene.scene_to_world)
        set_path(session, "Snap camera key to the drive", snapped_key(path, key, drive.moved(to_scene)))


def _drive(session: ViewedDocument, camera: RigCamera | None) -> CameraPath | None:
    camera = camera or front_camera(session.scene)
    return None if camera is None else drive_path(session.scene, camera, *_VIEW_SIZE)


def _export(session: ViewedDocument, file: Path, write: Callable[[Path, CameraPath], None]) -> None:
    """Write the path in scene units and axes; what goes wrong is kept in `problem`."""
    file = file if file.suffix else file.with_suffix(".json")
    path = session.scene.path or session.path.moved(np.linalg.inv(session.scene.scene_to_world))
    try:
        write(file, path)
    except OSError as error:
        session.problem = f"{file}: the camera path can't be written: {error.strerror or error}"
        logger.error("%s", session.problem)
    else:
        logger.info("Exported %s", file)
