"""Recorded drive of a scene as other simulators ask for it: names, cameras, microseconds, height above the ground."""

from collections import Counter

from .scene import PoseTrack, RigCamera, Scene

MICROSECONDS = 1_000_000
"""In a second."""

_SENSOR_HEIGHT_M = 1.5  # of the ego frame above the ground, in scenes that don't state their ground's height
_LOWEST_M, _HIGHEST_M = 0.2, 4.0


def scene_id(scene: Scene) -> str:
    """Name by which a simulator asks for a scene."""
    return scene.name or "scene"


def logical_cameras(scene: Scene) -> dict[str, RigCamera]:
    """Cameras of all rigs by name; by "RIG/NAME" where rigs share one."""
    named = [(rig, camera) for rig, cameras in scene.rigs.items() for camera in cameras]
    counts = Counter(camera.name for _, camera in named)
    return {camera.name if counts[camera.name] == 1 else f"{rig}/{camera.name}": camera for rig, camera in named}


def start_s(scene: Scene) -> float:
    """Scene time at microsecond 0, whose numbers have no sign: the earliest time, or 0 if none is before it."""
    tracks = [each.track for each in scene.actors] + ([scene.ego] if scene.ego is not None else [])
    return min([0.0, *(float(track.times[0]) for track in tracks if len(track.times))])


def timestamps_us(track: PoseTrack, scene: Scene) -> list[int]:
    """Times of a track in microseconds after `start_s`."""
    return [round((time - start_s(scene)) * MICROSECONDS) for time in track.times.tolist()]


def sensor_height_m(scene: Scene) -> float:
    """Height of the ego frame's origin above the ground."""
    first = scene.ego_to_world(float(scene.ego.times[0])) if scene.ego is not None and len(scene.ego.times) else None
    height = _SENSOR_HEIGHT_M if first is None or scene.ground_m is None else float(first[2, 3]) - scene.ground_m
    return height if _LOWEST_M < height < _HIGHEST_M else _SENSOR_HEIGHT_M
