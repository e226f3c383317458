"""Marks over orthographic pictures: grid, scale bar, boxes of road users, and paths, in pixels and drawn.

The window draws the same lines over its view.
"""

import math
from collections.abc import Collection, Iterator
from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Float64, UInt8

from ..choices import Mark
from ..scene.camera import Camera
from ..scene.geometry import EDGES, box_corners
from ..scene.scene import PoseTrack, Scene
from .view import RenderView

COLORS: dict[Mark, tuple[int, int, int]] = {
    "grid": (255, 255, 255), "scale": (255, 255, 255), "boxes": (255, 205, 60), "paths": (90, 200, 255),
}  # fmt: skip
"""Red, green, blue."""

_WIDTHS_PX: dict[Mark, float] = {"grid": 1.0, "scale": 2.0, "boxes": 1.5, "paths": 2.0}
_GRID_PX = 80.0  # least distance of two lines
_BAR_SHARE = 0.08  # least length of the scale bar, in widths of the picture
_GRID_OPACITY = 0.35
_MARGIN_PX, _TICK_PX = 16.0, 5.0
_UNITS = ("km", 1000.0), ("m", 1.0), ("cm", 0.01), ("mm", 0.001)
_FLATTEST = 0.1  # share of the line of sight that is vertical: flatter, a grid on the ground is a blur
_MAX_LINES = 400
_SHIFT = 4  # fractional bits of drawn coordinates


class MarkLine(NamedTuple):
    """A line of a mark."""

    mark: Mark
    points_px: Float64[np.ndarray, "n 2"]
    """x and y, from the picture's upper left corner."""


class ScaleBar(NamedTuple):
    """A horizontal bar of a round length."""

    length_px: float
    length_m: float

    @property
    def label(self) -> str:
        """Length with its unit."""
        unit, meters = next((each for each in _UNITS if self.length_m > 0.99 * each[1]), _UNITS[-1])
        return f"{self.length_m / meters:.6g} {unit}"


def round_length(at_least: float) -> float:
    """Return the smallest number of 1, 2, 5, 10, 20 ... that is not below another."""
    decade = 10.0 ** math.floor(math.log10(at_least))
    return next(decade * each for each in (1.0, 2.0, 5.0, 10.0) if decade * each >= at_least * (1 - 1e-9))


def scale_bar(camera: Camera) -> ScaleBar:
    """Scale bar of an orthographic camera's picture."""
    length_m = round_length(_BAR_SHARE * camera.width / camera.pixels_per_m)
    return ScaleBar(length_m * camera.pixels_per_m, length_m)


def mark_lines(scene: Scene, view: RenderView, marks: Collection[Mark]) -> list[MarkLine]:
    """Lines of all marks but the scale bar in an orthographic view, those that may be covered first."""
    found = list[MarkLine]()
    if "grid" in marks:
        found += _grid(scene, view.camera)
    if "paths" in marks:
        tracks = [each.track for each in scene.actors if each.visible]
        for track in [*tracks, scene.ego] if scene.ego is not None else tracks:
            found += _path(scene, track, view.camera)
    if "boxes" in marks:
        found += _boxes(scene, view)
    return found


def bar_line(bar: ScaleBar, left_px: float, bottom_px: float) -> MarkLine:
    """Line of a scale bar with upright ends."""
    x, right, y = left_px, left_px + bar.length_px, bottom_px
    return MarkLine("scale", np.array([(x, y - _TICK_PX), (x, y), (right, y), (right, y - _TICK_PX)]))


def draw_marks(
    scene: Scene, view: RenderView, marks: Collection[Mark], pixels: UInt8[np.ndarray, "h w 3"]
) -> UInt8[np.ndarray, "h w 3"]:
    """Return an orthographic picture with marks over it; all but the grid have a dark rim, for light ground.

    A scale bar is in the lower left corner.
    """
    lines, bar = mark_lines(scene, view, marks), scale_bar(view.camera)
    if "scale" in marks:
        lines.append(bar_line(bar, _MARGIN_PX, view.camera.height - _MARGIN_PX))
    picture = np.ascontiguousarray(pixels).copy()
    for each in lines:
        if each.mark == "grid":
            _draw(picture, each, COLORS["grid"], _WIDTHS_PX["grid"])
    picture = cv2.addWeighted(picture, _GRID_OPACITY, pixels, 1 - _GRID_OPACITY, 0.0)
    others = [each for each in lines if each.mark != "grid"]
    for rim_px in (2.0, 0.0):
        for each in others:
            _draw(picture, each, (0, 0, 0) if rim_px else COLORS[each.mark], _WIDTHS_PX[each.mark] + rim_px)
        if "scale" in marks:
            color = (0, 0, 0) if rim_px else COLORS["scale"]
            place = round(_MARGIN_PX), round(view.camera.height - _MARGIN_PX - 2 * _TICK_PX)
            cv2.putText(picture, bar.label, place, cv2.FONT_HERSHEY_SIMPLEX, 0.5, color, 1 + int(rim_px), cv2.LINE_AA)
    return picture


def _draw(picture: UInt8[np.ndarray, "h w 3"], line: MarkLine, color: tuple[int, int, int], width_px: float) -> None:
    points = np.round((line.points_px - 0.5) * (1 << _SHIFT)).astype(np.int32)
    cv2.polylines(picture, [points], False, color, max(1, round(width_px)), cv2.LINE_AA, _SHIFT)


def _in_picture(points_m: Float64[np.ndarray, "n 3"], camera: Camera) -> Float64[np.ndarray, "n 2"]:
    return camera.pixels(points_m @ camera.world_to_camera[:3, :3].T + camera.world_to_camera[:3, 3])


def _grid(scene: Scene, camera: Camera) -> Iterator[MarkLine]:
    """Lines along x and y on the ground at round places in meters."""
    sight = camera.world_to_camera[2, :3]
    if abs(sight[2]) < _FLATTEST:
        return
    step_m = round_length(_GRID_PX / camera.pixels_per_m)
    corners = np.array([[0, 0], [camera.width, 0], [camera.width, camera.height], [0, camera.height]], np.float64)
    rays = camera.directions(corners) @ camera.world_to_camera[:3, :3]
    height_m = scene.ground_m or 0.0
    reach = (height_m - camera.position[2]) / rays[:, 2]
    ground_m = camera.position + reach[:, None] * rays
    low, high = ground_m[:, :2].min(axis=0), ground_m[:, :2].max(axis=0)
    for axis in (0, 1):
        places = np.arange(np.ceil(low[axis] / step_m), np.floor(high[axis] / step_m) + 1)[:_MAX_LINES] * step_m
        for place in places.tolist():
            ends = np.full((2, 3), height_m)
            ends[:, axis], ends[:, 1 - axis] = place, (low[1 - axis], high[1 - axis])
            yield MarkLine("grid", _in_picture(ends, camera))


def _path(scene: Scene, track: PoseTrack, camera: Camera) -> Iterator[MarkLine]:
    """Runs of valid places of a track; none of one that stands."""
    places_m = track.positions @ scene.scene_to_world[:3, :3].T + scene.scene_to_world[:3, 3]
    starts = np.flatnonzero(np.diff(track.valid.astype(np.int8), prepend=0, append=0))
    for first, last in starts.reshape(-1, 2).tolist():
        run = places_m[first : min(last + 1, len(places_m))]
        if len(run) > 1 and np.ptp(run, axis=0).max() * camera.pixels_per_m > 1:
            yield MarkLine("paths", _in_picture(run, camera))


def _boxes(scene: Scene, view: RenderView) -> Iterator[MarkLine]:
    """Edges of the boxes of road users, and a line ahead from the middle of each."""
    for actor in scene.actors:
        pose = actor.pose_at(view.time_s) if actor.visible else None
        if pose is None:
            continue
        length, _, height = actor.size_lwh
        to_world = scene.scene_to_world @ pose
        ahead = np.array([[0, 0, height], [length / 2, 0, height]]) @ to_world[:3, :3].T + to_world[:3, 3]
        pixels = _in_picture(box_corners(to_world, actor.size_lwh), view.camera)
        for ends in (*pixels[EDGES], _in_picture(ahead, view.camera)):
            yield MarkLine("boxes", ends)
