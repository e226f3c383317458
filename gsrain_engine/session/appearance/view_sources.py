"""Which sources of views the open scene has, and which camera the viewport has."""

from typing import get_args

from gsrain_engine.appearance.views.choice import Source

from ..desk import Desk

SOURCES: tuple[Source, ...] = get_args(Source)

TITLES: dict[Source, str] = {
    "auto": "the best there are",
    "recorded": "of the open capture",
    "rig": "of the rig, along the drive",
    "path": "along the camera path",
    "around": "around the middle",
}
"""For a person to read."""


def why_no_views(session: Desk, source: Source) -> str | None:
    """Why views of a source can't be taken, in one sentence; None where they can."""
    scene, captures = session.scene, session.captures
    if not scene.gaussian_count:
        return "There is no scene yet to be made rainy."
    if source == "recorded":
        if captures.capture is None:
            return "No capture is open: open the scene's recording in Capture, or choose other views."
        if not captures.capture.has_poses:
            return "Nothing tells where the capture's cameras stood: choose other views."
        if not captures.lies_in(scene):
            return "The open capture has axes of its own: its cameras are not in the scene."
    if source == "rig" and not (scene.ego is not None and scene.ego.valid.any() and any(scene.rigs.values())):
        return "The scene has no drive with a camera rig: choose other views."
    if source == "path" and scene.path is None:
        return "There is no camera path yet: set keys in Timeline, or choose other views."
    return None


def uses_capture(session: Desk, source: Source) -> bool:
    """Whether views of a source are those of the open capture; by itself only where a person has said that it fits."""
    is_sure = session.captures.in_scene_axes is True and why_no_views(session, "recorded") is None
    return source == "recorded" or (source == "auto" and is_sure)
