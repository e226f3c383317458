"""Which cameras a recording shows, in which size, and at which moments."""

from collections.abc import Mapping

from gsrain_engine.rain.rainfall import Rainfall
from gsrain_engine.scene.camera import Camera
from gsrain_engine.scene.paths.camera_path import CameraPath
from gsrain_engine.scene.scene import Scene

from .mounted_camera import MountedCamera, mounted_cameras
from .recording import DEFAULT_SIZE_PX, Recording
from .sequence import FrameSequence

LONGEST_DEFAULT_S = 10.0
"""Of a clip that neither a person nor a path of theirs gives a length."""


def sequences_of(
    recording: Recording, scene: Scene, rainfall: Rainfall, viewpoint: Camera | CameraPath, *, in_scene_time: bool
) -> dict[str, FrameSequence]:
    """What a recording shows, by the names of its cameras: rig cameras where it names some, else one viewpoint.

    `in_scene_time` says whether a path's times are the scene's own. A still from a path without times is one of a
    camera at rest. Raises `ValueError` for what contradicts itself.
    """
    recording.check()
    views: dict[str, Camera | CameraPath | MountedCamera] = {"": viewpoint}
    if recording.cameras:
        views = _by_name(mounted_cameras(scene, recording.cameras))
    sequences: dict[str, FrameSequence] = {}
    for name, view in views.items():
        width, height = recording.size_px or _own_size(view, recording.first_s)
        sequences[name] = FrameSequence(
            scene,
            rainfall,
            view,
            width,
            height,
            recording.fps,
            recording.first_s,
            in_scene_time and isinstance(view, CameraPath),
            recording.supersampling,
            recording.motion_blur,
            at_rest=recording.is_still and isinstance(view, CameraPath) and not view.is_timed,
        )
    return sequences


def frame_numbers(recording: Recording, sequences: Mapping[str, FrameSequence]) -> range:
    """Numbers of the frames between a recording's two moments; without the second, as long as the path is."""
    if recording.is_still:
        return range(1)
    if recording.last_s is not None:
        return range(max(1, round((recording.last_s - recording.first_s) * recording.fps)))
    length_s = max(_length_s(each) for each in sequences.values())
    return range(max(1, round(max(length_s, 1 / recording.fps) * recording.fps)))


def _length_s(sequence: FrameSequence) -> float:
    """All of a drive or of a person's own flight; of anything else so much that its end is seen soon."""
    length_s = LONGEST_DEFAULT_S if sequence.length_s is None else sequence.length_s
    is_made = sequence.in_scene_time or isinstance(sequence.camera, MountedCamera)
    return length_s if is_made else min(LONGEST_DEFAULT_S, length_s)


def _by_name(cameras: list[MountedCamera]) -> dict[str, Camera | CameraPath | MountedCamera]:
    """Name cameras as their files: with the rig in front where there are several rigs."""
    several = len({each.rig for each in cameras}) > 1
    return {f"{each.rig}_{each.name}" if several else each.name: each for each in cameras}


def _own_size(view: Camera | CameraPath | MountedCamera, time_s: float) -> tuple[int, int]:
    if isinstance(view, CameraPath):
        return DEFAULT_SIZE_PX
    camera = view if isinstance(view, Camera) else view.at(time_s)
    return camera.width, camera.height
