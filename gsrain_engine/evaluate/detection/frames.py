"""Views that detectors are tried on: from where, when, what is there to be found, and the picture that was taken."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64, UInt8

from gsrain_engine.appearance.views.placed_camera import PlacedCamera
from gsrain_engine.datasets.capture import Capture
from gsrain_engine.datasets.prepared import prepared
from gsrain_engine.render.renderer import Renderer
from gsrain_engine.render.scene_view import Shot
from gsrain_engine.scene.objects import scene_objects
from gsrain_engine.scene.scene import Scene

from .truth import LabelledObject
from .truth_from_boxes import truth_from_boxes
from .truth_from_scene import truth_from_scene

_STEP_S = 0.005
"""Half the time over which a speed is taken."""

Labels = dict[str, tuple[LabelledObject, ...]]


@dataclass(frozen=True, slots=True, eq=False)
class JudgedFrame:
    """One view. World: metres, z up."""

    name: str
    shot: Shot
    truths: tuple[LabelledObject, ...]
    original: Callable[[], UInt8[np.ndarray, "h w 3"]] | None = None
    """Reads the picture that a camera took there; none where nobody did."""


def scene_frames(renderer: Renderer, scene: Scene, placed: Sequence[PlacedCamera]) -> list[JudgedFrame]:
    """Views of a scene whose own actors (and parked vehicles) are to be found.

    Raises ValueError for a scene in which nothing has a class.
    """
    objects = scene_objects(scene)
    if not objects:
        raise ValueError(f"scene {scene.name!r} has no actors to be found; --capture or --truth says what is there")
    return [
        JudgedFrame(
            each.name, shot_in(scene, each), truth_from_scene(renderer, scene, objects, each.camera, each.time_s)
        )
        for each in placed
    ]


def recorded_frames(
    scene: Scene, placed: Sequence[PlacedCamera], capture: Capture, labels: Labels | None = None
) -> list[JudgedFrame]:
    """Views of a scene, or of a world of nothing, that a capture has pictures of, by the names of its views.

    What is there to be found are the capture's 3D boxes, or `labels` by the names of views and of their files.
    Raises ValueError where there are neither.
    """
    if labels is None and not (capture.boxes and capture.is_metric):
        raise ValueError(f"{capture.name}: has no 3D boxes of what is to be found; --truth names a COCO file")
    views = {view.name: view for view in capture}
    frames: list[JudgedFrame] = []
    for each in placed:
        view = prepared(views[each.name], each.camera.width)
        if labels is None:
            truths = truth_from_boxes(capture.boxes, view.camera, view.time_s)
        else:
            truths = _labels_of(labels, each.name)
        frames.append(JudgedFrame(each.name, shot_in(scene, each), truths, lambda view=view: view.image))
    return frames


def shot_in(scene: Scene, placed: PlacedCamera) -> Shot:
    """The shot of a camera that rides on the scene's ego vehicle, if there is one at its time."""
    return Shot(placed.camera, placed.time_s, _velocity(scene, placed.camera.position, placed.time_s))


def _velocity(scene: Scene, position: Float64[np.ndarray, "3"], time_s: float) -> Float64[np.ndarray, "3"]:
    """Of a place that is fixed to the ego vehicle, in m/s; zero without one."""
    now, before, after = (scene.ego_to_world(time_s + step) for step in (0.0, -_STEP_S, _STEP_S))
    if now is None or before is None or after is None:
        return np.zeros(3)
    mounted = np.linalg.inv(now) @ np.append(position, 1.0)
    return ((after - before) @ mounted)[:3] / (2 * _STEP_S)


def _labels_of(labels: Labels, name: str) -> tuple[LabelledObject, ...]:
    """Labels by a view's name, with or without folder and ending; none where the file does not know it."""
    stem = name.rpartition("/")[2].rpartition(".")[0] or name.rpartition("/")[2]
    for known, truths in labels.items():
        if name == known or stem == (known.rpartition("/")[2].rpartition(".")[0] or known):
            return truths
    return ()
