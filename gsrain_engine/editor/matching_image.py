"""Overlay images of correspondences (other view warped, difference, or outcome per pixel), and their computation."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import matplotlib
import numpy as np
from jaxtyping import Float32, Int64, UInt8

from ..appearance.base import ClearView
from ..appearance.capture_views import CaptureViews
from ..appearance.correspondence import COLORS, Correspondence, MatchOutcome, correspondence, warped
from ..appearance.scene_views import PlacedCamera, scene_view, scene_views
from ..datasets.capture import Capture, CaptureFrame
from ..datasets.undistort import undistort_frame
from ..scene.scene import Scene
from .viewport.options import Mode

_VEIL: dict[MatchOutcome, float] = {MatchOutcome.OUTSIDE: 0.65, MatchOutcome.UNKNOWN: 0.6, MatchOutcome.MATCHED: 0.0}
_OTHER_VEIL = 0.5
_MARK = 0.45
_LARGEST_DIFFERENCE = 0.25
_SHADES = 256
_LINE_STEP_PX = 24

# Matched views


@dataclass(frozen=True, slots=True, eq=False)
class MatchedViews:
    """Two views, and the position of each pixel of the first in the second."""

    of: ClearView
    to: ClearView
    found: Correspondence


def matching_image(matched: MatchedViews, mode: Mode) -> UInt8[np.ndarray, "h w 4"]:
    """Draw a correspondence in display color, with alpha.

    Mode `picture` shows the other view warped to this one; unmatched pixels are dimmed, in the color of their outcome.
    Mode `difference` ranges from none (black) to a quarter of full scale (white). Mode `pixels` shows only outcome
    colors.
    """
    found = matched.found
    veils = np.array([_VEIL.get(each, _OTHER_VEIL) for each in MatchOutcome], np.float32)
    colors = np.array([COLORS[each] for each in MatchOutcome], np.float32)
    picture = np.concatenate([colors[found.outcome], veils[found.outcome][..., None]], axis=2)
    valid = found.valid
    if mode == "pixels":
        picture[valid, 3] = _MARK
    else:
        other = warped(matched.to.image, found)
        shown = other if mode == "picture" else _difference(other, matched.of.image)
        picture[valid] = np.concatenate([shown, np.ones_like(shown[..., :1])], axis=2)[valid]
    return np.rint(255 * np.clip(picture, 0, 1)).astype(np.uint8)


def flow_lines(matched: MatchedViews) -> Float32[np.ndarray, "n 2 2"]:
    """Lines on a grid from each matched pixel to its position in the other view, in shares of each image's size."""
    places, valid = matched.found.places, matched.found.valid
    height, width = valid.shape
    rows, columns = (each.ravel() for each in np.mgrid[_middle(height), _middle(width)])
    kept = valid[rows, columns]
    rows, columns = rows[kept], columns[kept]
    start = np.stack([(columns + 0.5) / width, (rows + 0.5) / height], axis=1)
    end = places[rows, columns] / np.array(matched.found.size[::-1], np.float32)
    return np.stack([start, end], axis=1).astype(np.float32)


def outcome_shares(matched: MatchedViews) -> dict[MatchOutcome, float]:
    """Share of the image of each outcome that occurs."""
    counts: Int64[np.ndarray, " k"] = np.bincount(matched.found.outcome.ravel(), minlength=len(MatchOutcome))
    return {each: float(counts[each] / counts.sum()) for each in COLORS if counts[each]}


def _middle(size: int) -> slice:
    return slice(size % _LINE_STEP_PX // 2 + _LINE_STEP_PX // 2, size, _LINE_STEP_PX)


def _difference(one: Float32[np.ndarray, "h w 3"], other: Float32[np.ndarray, "h w 3"]) -> Float32[np.ndarray, "h w 3"]:
    error = np.abs(one - other).mean(axis=2)
    shades = np.asarray(matplotlib.colormaps["magma"](np.linspace(0, 1, _SHADES)), np.float32)[:, :3]
    return shades[np.rint(np.clip(error / _LARGEST_DIFFERENCE, 0, 1) * (_SHADES - 1)).astype(int)]


WIDTH_PX = 480


class MatchableViews:
    """Views of a capture with depth; use from one thread.

    Depth comes from the capture or its lidar; if it has neither, or for the live view, from the scene made from it.
    """

    def __init__(self, capture: Capture, scene: Scene | None) -> None:
        """`scene` is the scene that shares the capture's units and axes, if there is one."""
        self.capture, self.scene = capture, scene
        self._recorded = CaptureViews(capture, WIDTH_PX)
        self._straight = [undistort_frame(view, min(WIDTH_PX, view.camera.width)) for view in capture]
        self._camera_panel: Sequence[ClearView] | None = None
        if scene is not None:
            placed = [_placed(view, scene) for view in self._straight]
            self._camera_panel = scene_views(scene, placed)

    def matched(self, of: int | PlacedCamera, to: int) -> MatchedViews:
        """Match a captured view, or the live one, with a captured one; raises ValueError if that is impossible."""
        is_live = isinstance(of, PlacedCamera)
        uses_scene = self._camera_panel is not None and (is_live or not self._has_depth)
        if is_live and self.scene is None:
            raise ValueError("The capture does not lie in the scene: look from one of its views to match it.")
        other = self._of_scene(to) if uses_scene else self._recorded[to]
        if is_live:
            view = scene_view(self.scene or Scene(""), of.at_width(WIDTH_PX))
        else:
            view = self._of_scene(of) if uses_scene else self._recorded[of]
        return MatchedViews(view, other, correspondence(view, other))

    @property
    def _has_depth(self) -> bool:
        return bool(self.capture.sweeps) or any(view.depth_source is not None for view in self.capture)

    def _of_scene(self, index: int) -> ClearView:
        """A captured image, with the scene's depth."""
        assert self._camera_panel is not None, "there is a scene"
        recorded = self._straight[index].image.astype(np.float32) / np.float32(255)
        return replace(self._camera_panel[index], image=recorded)


def _placed(view: CaptureFrame, scene: Scene) -> PlacedCamera:
    return PlacedCamera(view.name, view.camera.moved(scene.scene_to_world), view.time_s, view.sensor)
