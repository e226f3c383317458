"""Orthographic cameras on the command line: `gsrain render SCENE --camera top`, `ortho:ego`, `top:12,3`."""

from difflib import get_close_matches
from math import ceil
from pathlib import Path
from typing import TYPE_CHECKING, get_args

from gsrain_engine.choices import Direction
from gsrain_engine.render.export_settings import DEFAULT_SIZE_PX, LARGEST_PX, ExportSettings

from .options import check_within

if TYPE_CHECKING:
    import numpy as np
    from jaxtyping import Float64

    from gsrain_engine.render.sequence import FollowingCamera
    from gsrain_engine.scene.camera import Camera
    from gsrain_engine.scene.scene import PoseTrack, Scene

_EGO = "ego"
_AROUND_M = 60.0  # width of a picture around a place or a road user


def is_plan(camera: str | None) -> bool:
    """Return whether a --camera names an orthographic one, and no file."""
    return camera is not None and camera.partition(":")[0] in get_args(Direction) and not Path(camera).exists()


def plan_camera(
    scene: "Scene", text: str, export: ExportSettings, pixels_per_m: float | None
) -> "Camera | FollowingCamera":
    """Return the camera of `top` or `ortho`: of the whole scene, or around `:X,Y` or `:NAME` of a road user.

    Raises `ValueError` for a place that is none, a road user that the scene lacks, and a picture that is too large.
    """
    from gsrain_engine.editor.viewport.camera import find_scene_core
    from gsrain_engine.render.sequence import FollowingCamera
    from gsrain_engine.scene.orthographic import extent_m, fitted_scale, orientation, scaled_camera

    check_within("--pixels-per-meter", pixels_per_m, 0, 1e6, "px/m", is_open=True)
    direction, _, place = text.partition(":")
    core = find_scene_core(scene)
    turn = orientation(scene, "top" if direction == "top" else "ortho")  # which `is_plan` has checked
    size_px, middle_m, track = export.size_px, core.middle, None
    if place:
        track = None if "," in place else _track(scene, place)
        middle_m = _place(text, place, scene.ground_m or 0.0) if track is None else _first_place(scene, track)
    elif size_px is None and pixels_per_m is not None:
        size_px = _size_of(extent_m(core, turn), direction, pixels_per_m)
    width, height = size_px or DEFAULT_SIZE_PX
    around = width / min(_AROUND_M, extent_m(core, turn)[0]) if place else fitted_scale(core, turn, width, height)
    camera = scaled_camera(core, turn, middle_m, (width, height), pixels_per_m or around)
    return camera if track is None else FollowingCamera(scene, track, camera)


def _size_of(extent_m: tuple[float, float], direction: str, pixels_per_m: float) -> tuple[int, int]:
    """Size of a picture of the whole scene, even for videos."""
    width, height = (2 * ceil(pixels_per_m * each / 2) for each in extent_m)
    if max(width, height) > LARGEST_PX:
        raise ValueError(
            f"--pixels-per-meter {pixels_per_m:g}: the scene would be {width:,} x {height:,} px, and a picture has at "
            f"most {LARGEST_PX:,}; --size and --camera {direction}:X,Y draw a part of it"
        )
    return width, height


def _place(text: str, place: str, height_m: float) -> "Float64[np.ndarray, '3']":
    import numpy as np

    try:
        x, y = (float(each) for each in place.split(","))
    except ValueError:
        x = y = float("nan")
    if not max(abs(x), abs(y)) < 1e6:
        raise ValueError(f"--camera {text}: expected X,Y in meters after the colon, or the name of a road user")
    return np.array([x, y, height_m])


def _track(scene: "Scene", name: str) -> "PoseTrack":
    tracks = {each.id: each.track for each in scene.actors}
    if scene.ego is not None:
        tracks[_EGO] = scene.ego
    if name not in tracks or not tracks[name].valid.any():
        like = get_close_matches(name, tracks, 1) or list(tracks)[:8]
        hint = f"; there is {', '.join(like)}" if like else ""
        raise ValueError(f"scene {scene.name!r} has no road user {name!r}{hint}")
    return tracks[name]


def _first_place(scene: "Scene", track: "PoseTrack") -> "Float64[np.ndarray, '3']":
    to_world = scene.scene_to_world
    return to_world[:3, :3] @ track.positions[track.valid][0] + to_world[:3, 3]
