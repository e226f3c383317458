"""Which views of a scene are taken: those of its recording, along a way, or around it."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Annotated, Literal

import numpy as np
from msgspec import Meta, Struct

from gsrain_engine.datasets.capture import Capture
from gsrain_engine.datasets.prepared import prepared
from gsrain_engine.scene.paths.camera_path import CameraPath
from gsrain_engine.scene.scene import Scene

from .placed_camera import PlacedCamera
from .rig_views import along_the_way
from .sampled_views import around_the_middle

Source = Literal["auto", "recorded", "rig", "path", "around"]

USUAL_COUNT = 24
"""Views where a person says nothing: enough for a street of 100 m."""
USUAL_PIXELS = 480 * 320
"""Size of a picture, whatever its shape, of a quick look: where no width is asked for."""
OWN_WIDTH_PX = 960
"""Commands take pictures as wide as they are, up to this, where no width is asked for."""
_PATH_PX = (960, 640)
"""Width and height of views along a camera path, which has no pictures of its own."""


class ViewChoice(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What a person can choose about views."""

    source: Annotated[
        Source,
        Meta(
            title="Views",
            description="recorded: the cameras of a capture; rig: the scene's own, along the ego's way; path: its "
            "camera path; around: outwards from its middle and inwards from a ring; auto: the first there is.",
        ),
    ] = "auto"
    count: (
        Annotated[
            int,
            Meta(
                ge=1,
                le=100_000,
                title="Number of views",
                extra={"none": "as many as fit", "usual": 24},
                description="Evenly over all there are.",
            ),
        ]
        | None
    ) = None
    """None is all of a recording, and 24 elsewhere."""
    width_px: (
        Annotated[
            int,
            Meta(
                ge=16,
                le=16384,
                title="Width of pictures",
                extra={"unit": "px", "none": "as 480 x 320", "usual": 480},
                description="Each picture keeps its proportions.",
            ),
        ]
        | None
    ) = None
    """None gives pictures as many pixels as 480 x 320, at most their own."""
    sensors: Annotated[
        tuple[str, ...], Meta(title="Cameras", description="Only these of the rig or the recording; empty for all.")
    ] = ()


def chosen_cameras(
    scene: Scene, choice: ViewChoice, capture: Capture | None = None, own_width_px: int | None = None
) -> list[PlacedCamera]:
    """Place cameras in a scene as chosen; names are unique.

    Args:
        scene: What is looked at.
        choice: From where.
        capture: The scene's recording, whose world is the scene's own units and axes.
        own_width_px: Where no width is chosen, pictures are as wide as their cameras', up to this; None makes them
            small instead (`ViewChoice.width_px`).

    Raises:
        ValueError: Where the scene has no such views.
    """
    source = choice.source if choice.source != "auto" else _best(scene, capture)
    if source == "recorded":
        placed = _recorded(scene, choice, capture)
    elif source == "rig":
        placed = along_the_way(scene, choice.count or USUAL_COUNT, choice.sensors)
    elif source == "path":
        placed = _on_the_path(scene, choice.count or USUAL_COUNT)
    else:
        placed = around_the_middle(scene, choice.count or USUAL_COUNT)
    if choice.width_px is None and own_width_px is not None:
        return [each.at_width(min(own_width_px, each.camera.width)) for each in placed]
    return [each.at_width(choice.width_px or _usual_width(each)) for each in placed]


def _best(scene: Scene, capture: Capture | None) -> Source:
    if capture is not None:
        return "recorded"
    if scene.ego is not None and scene.ego.valid.any() and any(scene.rigs.values()):
        return "rig"
    return "around" if scene.path is None else "path"


def chosen_views(capture: Capture, choice: ViewChoice) -> Capture:
    """Return a capture with the chosen views alone; raises ValueError where it has no such camera."""
    wanted = [view for view in capture if not choice.sensors or view.sensor in choice.sensors]
    if not wanted:
        there = ", ".join(filter(None, capture.sensors)) or "one without a name"
        raise ValueError(f"{capture.name}: has no camera {', '.join(choice.sensors)}, only {there}")
    return replace(capture, views=tuple(wanted[i] for i in evenly(len(wanted), choice.count)))


def _recorded(scene: Scene, choice: ViewChoice, capture: Capture | None) -> list[PlacedCamera]:
    if capture is None:
        raise ValueError(f"recorded views of scene {scene.name!r}: its capture is needed, which nobody has named")
    if not capture.has_poses:
        raise ValueError(f"{capture.name}: has pictures, but not where their cameras stood")
    to_world = scene.scene_to_world
    return [
        PlacedCamera(view.name, prepared(view).camera.moved(to_world), view.time_s, view.sensor)
        for view in chosen_views(capture, choice)
    ]


def _on_the_path(scene: Scene, count: int) -> list[PlacedCamera]:
    path = scene.path
    if path is None:
        raise ValueError(f"scene {scene.name!r} has no camera path")
    times = _evenly_timed(path, count)
    cameras = [path.camera(t, *_PATH_PX).moved(scene.scene_to_world) for t in times]
    return [PlacedCamera(f"path_{i:03d}", camera, t) for i, (camera, t) in enumerate(zip(cameras, times, strict=True))]


def _evenly_timed(path: CameraPath, count: int) -> list[float]:
    """Moments from a path's start to its end, without that at which a loop is back at its start."""
    if path.duration_s == 0:
        return [path.start_s]
    return np.linspace(path.start_s, path.end_s, count, endpoint=not path.loop).tolist()


def evenly(there: int, count: int | None) -> Sequence[int]:
    """Indices of so many out of all there are, evenly spread; all where no more are there."""
    if count is None or count >= there:
        return range(there)
    return np.floor((np.arange(count) + 0.5) * there / count).astype(int).tolist()


def _usual_width(placed: PlacedCamera) -> int:
    """Width at which a picture has the usual number of pixels; never more than its own."""
    width, height = placed.camera.width, placed.camera.height
    return min(width, max(1, round(width * np.sqrt(USUAL_PIXELS / (width * height)))))
