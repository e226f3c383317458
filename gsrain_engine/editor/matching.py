"""Matching in the viewport: settings, choice of the other view, correspondences and their overlay images.

Not part of the document.
"""

import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float32, Int64, UInt8

from ..appearance.base import ClearView
from ..appearance.correspondence import COLORS, Correspondence, MatchOutcome, correspondence, warped
from ..appearance.scene_views import PlacedCamera, scene_view, scene_views
from ..datasets.capture import Capture
from ..datasets.undistort import undistort_frame
from ..scene.camera import Camera
from ..scene.scene import Scene
from .background import Background
from .capture_view import CaptureController
from .viewport.options import Mode, Texture
from .viewport_state import ViewportState

logger = logging.getLogger("gsrain")


class _MatchRequest(NamedTuple):
    """Input of a match; equal requests have equal results."""

    capture: Capture
    scene: Scene | None
    of: int | None
    """Index of a captured view, or None for the live one."""
    to: int
    pose: bytes = b""
    """Pose of the live camera."""
    time_s: float = 0.0


class MatchResult(NamedTuple):
    """Result of a request."""

    request: _MatchRequest
    camera: Camera
    """Camera of the first view, in the world."""
    matched: "MatchedViews"
    lines: Float32[np.ndarray, "n 2 2"]
    shares: dict[MatchOutcome, float]


class MatchingController:
    """Matches the current view with another view of the capture. Main thread only."""

    def __init__(self, viewport: ViewportState, captures: CaptureController, background: Background) -> None:
        self._viewport, self._captures = viewport, captures
        self.is_on = False
        self.against: Against = "next"
        """Partner of a captured view; the live view is always matched with the selected one."""
        self.mode: Mode = "picture"
        self.lines = False
        """True if lines show the displacement to the other view."""
        self.shown: MatchResult | None = None
        self.why_none: str | None = None
        """Reason why nothing is displayed, in a sentence."""
        self.texture: Texture | None = None
        """Overlay on the GPU, with its own alpha."""
        self._background = background
        self._last: _MatchRequest | None = None
        self._failed: tuple[_MatchRequest, str] | None = None
        self._views: MatchableViews | None = None
        self._image: tuple[MatchResult, Mode, UInt8[np.ndarray, "h w 4"]] | None = None

    @property
    def is_working(self) -> bool:
        is_due = self._last is not None and self.shown is None and self.why_none is None
        return is_due or self._background.is_working("matching")

    @property
    def picture(self) -> UInt8[np.ndarray, "h w 4"] | None:
        """Overlay image; the same array until it changes."""
        if self.shown is None:
            return None
        if self._image is None or self._image[0] is not self.shown or self._image[1] != self.mode:
            self._image = self.shown, self.mode, matching_image(self.shown.matched, self.mode)
        return self._image[2]

    def poll(self) -> None:
        """Start a match for the current view. Once a frame."""
        request = self._request() if self.is_on else ""
        if isinstance(request, str):
            self.shown, self.why_none, self._last, self._failed = None, request or None, None, None
            self._views = self._views if self.is_on else None
            return
        self.why_none = self._failed[1] if self._failed is not None and self._failed[0] == request else None
        if self.shown is not None and self.shown.request != request:
            self.shown = None
        is_still, self._last = request == self._last, request
        is_free = not self._background.is_working("matching")
        if is_still and self.shown is None and is_free and self.why_none is None:
            self._begin(request)

    def _request(self) -> _MatchRequest | str:
        """Request for the current view, or the reason why it can't be matched."""
        captures, present = self._captures, self._viewport.document.scene
        capture = captures.capture
        if capture is None or not capture.has_poses:
            return "Open a capture whose cameras are known."
        scene = present if captures.lies_in(present) and present.gaussian_count else None
        of = captures.view_at_camera
        if of is not None:
            to = neighbor_view(capture, of, self.against, captures.chosen)
            return WHY_NONE[self.against] if to is None else _MatchRequest(capture, scene, of, to)
        shot = self._viewport.shot(*captures.viewport_px)
        pose = shot.camera.world_to_camera.tobytes() + np.array([shot.camera.fy, *captures.viewport_px]).tobytes()
        return _MatchRequest(capture, scene, None, captures.chosen, pose, shot.time_s if present.actors else 0.0)

    def _begin(self, request: _MatchRequest) -> None:
        if request.of is None:
            shot = self._viewport.shot(*self._captures.viewport_px)
            camera, of = shot.camera, PlacedCamera("the view", shot.camera, shot.time_s)
        else:
            camera, of = self._captures.cameras(self._viewport.document.scene)[request.of], request.of

        def take(result: MatchResult) -> None:
            self.shown, self._failed = result, None

        def fail(error: Exception) -> None:
            self._failed = request, str(error)
            logger.warning("Matching: %s", error)

        self._background.start(lambda: self._match(request, camera, of), take, fail, lane="matching")

    def _match(self, request: _MatchRequest, camera: Camera, of: int | PlacedCamera) -> MatchResult:
        """Compute a match; in the thread, one after another."""
        views = self._views
        if views is None or views.capture is not request.capture or views.scene is not request.scene:
            self._views = views = MatchableViews(request.capture, request.scene)
        matched = views.matched(of, request.to)
        return MatchResult(request, camera, matched, flow_lines(matched), outcome_shares(matched))


# Choice of the other view

Against = Literal["next", "previous", "beside", "chosen"]
WHY_NONE: dict[Against, str] = {
    "next": "This is the last view of its camera.",
    "previous": "This is the first view of its camera.",
    "beside": "There is no other camera.",
    "chosen": "Choose another view in the list.",
}
"""Messages if there is no such view."""


def neighbor_view(capture: Capture, of: int, against: Against, chosen: int) -> int | None:
    """View that a captured one is matched with, or None.

    `beside` is the view of another camera with the most similar direction, among those nearest in time.
    """
    view = capture[of]
    if against == "chosen":
        return chosen if chosen != of else None
    same = [i for i, each in enumerate(capture) if each.sensor == view.sensor]
    if against != "beside":
        at = same.index(of) + (1 if against == "next" else -1)
        return same[at] if 0 <= at < len(same) else None
    others: dict[str, int] = {}
    for i, each in enumerate(capture):
        best = others.get(each.sensor)
        apart = abs(each.time_s - view.time_s)
        if each.sensor != view.sensor and (best is None or apart < abs(capture[best].time_s - view.time_s)):
            others[each.sensor] = i
    ahead = view.camera.world_to_camera[2, :3]
    return max(others.values(), key=lambda i: float(capture[i].camera.world_to_camera[2, :3] @ ahead), default=None)


# Correspondences

_WIDTH_PX = 480


@dataclass(frozen=True, slots=True, eq=False)
class MatchedViews:
    """Two views, and the position of each pixel of the first in the second."""

    of: ClearView
    to: ClearView
    found: Correspondence


class MatchableViews:
    """Views of a capture with depth; use from one thread.

    Depth comes from the capture or its lidar; if it has neither, or for the live view, from the scene made from it.
    """

    def __init__(self, capture: Capture, scene: Scene | None) -> None:
        """`scene` is the scene that shares the capture's units and axes, if there is one."""
        from ..appearance.capture_views import CaptureViews  # SciPy loads slowly

        self.capture, self.scene = capture, scene
        self._recorded = CaptureViews(capture, _WIDTH_PX)
        self._straight = [undistort_frame(view, min(_WIDTH_PX, view.camera.width)) for view in capture]
        self._scene_views: Sequence[ClearView] | None = None
        if scene is not None:
            placed = [
                PlacedCamera(view.name, view.camera.moved(scene.scene_to_world), view.time_s, view.sensor)
                for view in self._straight
            ]
            self._scene_views = scene_views(scene, placed)

    def matched(self, of: int | PlacedCamera, to: int) -> MatchedViews:
        """Match a captured view, or the live one, with a captured one; raises ValueError if that is impossible."""
        is_live = isinstance(of, PlacedCamera)
        has_depth = bool(self.capture.sweeps) or any(each.depth_source is not None for each in self.capture)
        uses_scene = self._scene_views is not None and (is_live or not has_depth)
        if is_live and self.scene is None:
            raise ValueError("The capture does not lie in the scene: look from one of its views to match it.")
        other = self._of_scene(to) if uses_scene else self._recorded[to]
        if is_live:
            view = scene_view(self.scene or Scene(""), of.at_width(_WIDTH_PX))
        else:
            view = self._of_scene(of) if uses_scene else self._recorded[of]
        return MatchedViews(view, other, correspondence(view, other))

    def _of_scene(self, index: int) -> ClearView:
        """A captured image, with the scene's depth."""
        assert self._scene_views is not None, "there is a scene"
        recorded = self._straight[index].image.astype(np.float32) / np.float32(255)
        return replace(self._scene_views[index], image=recorded)


# Overlay images

_VEILS = {MatchOutcome.OUTSIDE: 0.65, MatchOutcome.UNKNOWN: 0.6, MatchOutcome.MATCHED: 0.0}
_OTHER_VEIL = 0.5
_MARK = 0.45
_MAX_DIFFERENCE = 0.25
_LINE_STEP_PX = 24


def matching_image(matched: MatchedViews, mode: Mode) -> UInt8[np.ndarray, "h w 4"]:
    """Draw a correspondence in display color, with alpha.

    Mode `picture` shows the other view warped to this one; unmatched pixels are dimmed, in the color of their outcome.
    Mode `difference` ranges from none (black) to a quarter of full scale (white). Mode `pixels` shows only outcome
    colors.
    """
    found = matched.found
    veils = np.array([_VEILS.get(each, _OTHER_VEIL) for each in MatchOutcome], np.float32)
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
    step, half = _LINE_STEP_PX, _LINE_STEP_PX // 2
    grid = np.mgrid[height % step // 2 + half : height : step, width % step // 2 + half : width : step]
    rows, columns = (each.ravel()[valid[tuple(grid)].ravel()] for each in grid)
    start = np.stack([(columns + 0.5) / width, (rows + 0.5) / height], axis=1)
    end = places[rows, columns] / np.array(matched.found.size[::-1], np.float32)
    return np.stack([start, end], axis=1).astype(np.float32)


def outcome_shares(matched: MatchedViews) -> dict[MatchOutcome, float]:
    """Share of the image of each outcome that occurs."""
    counts: Int64[np.ndarray, " k"] = np.bincount(matched.found.outcome.ravel(), minlength=len(MatchOutcome))
    return {each: float(counts[each] / counts.sum()) for each in COLORS if counts[each]}


def _difference(one: Float32[np.ndarray, "h w 3"], other: Float32[np.ndarray, "h w 3"]) -> Float32[np.ndarray, "h w 3"]:
    import matplotlib  # loads slowly

    error = np.abs(one - other).mean(axis=2)
    shades = np.asarray(matplotlib.colormaps["magma"](np.linspace(0, 1, 256)), np.float32)[:, :3]
    return shades[np.rint(np.clip(error / _MAX_DIFFERENCE, 0, 1) * 255).astype(int)]
