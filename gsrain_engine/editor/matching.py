"""Matching in the viewport: its settings, its results, and the choice of the other view. Not part of the document."""

import logging
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np
from jaxtyping import Float32, UInt8

from ..appearance.correspondence import MatchOutcome
from ..datasets.capture import Capture, CaptureError
from ..scene.camera import Camera
from ..scene.scene import Scene
from .services import EditorServices
from .viewport.options import Mode, Texture

if TYPE_CHECKING:
    from ..appearance.scene_views import PlacedCamera
    from .matching_image import MatchableViews, MatchedViews

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

    def __init__(self) -> None:
        self.is_on = False
        self.against: Against = "next"
        """Partner of a captured view; the live view is always matched with the selected one."""
        self.mode: Mode = "picture"
        self.lines = False
        """True if lines show the displacement to the other view."""
        self.shown: MatchResult | None = None
        self.problem: str | None = None
        """Reason why nothing is shown, in a sentence."""
        self.texture: Texture | None = None
        """Overlay on the GPU, with its own alpha."""
        self._thread = ThreadPoolExecutor(max_workers=1, thread_name_prefix="matching")
        self._working: tuple[_MatchRequest, Camera, Future[MatchResult]] | None = None
        self._last: _MatchRequest | None = None
        self._failed: tuple[_MatchRequest, str] | None = None
        self._views: MatchableViews | None = None
        self._image: tuple[MatchResult, Mode, UInt8[np.ndarray, "h w 4"]] | None = None

    @property
    def is_working(self) -> bool:
        return self._working is not None or (self._last is not None and self.shown is None and self.problem is None)

    @property
    def picture(self) -> UInt8[np.ndarray, "h w 4"] | None:
        """Overlay image; the same array until it changes."""
        if self.shown is None:
            return None
        if self._image is None or self._image[0] is not self.shown or self._image[1] != self.mode:
            from .matching_image import matching_image

            self._image = self.shown, self.mode, matching_image(self.shown.matched, self.mode)
        return self._image[2]

    def poll(self, session: EditorServices) -> None:
        """Process finished matches, and start one for the current view. Once a frame."""
        if self._working is not None and self._working[2].done():
            self._take(*self._working)
        wish = self._request(session) if self.is_on else ""
        if isinstance(wish, str):
            self.shown, self.problem, self._last, self._failed = None, wish or None, None, None
            self._views = self._views if self.is_on else None
            return
        self.problem = self._failed[1] if self._failed is not None and self._failed[0] == wish else None
        if self.shown is not None and self.shown.request != wish:
            self.shown = None
        rests = wish == self._last
        self._last = wish
        if rests and self.shown is None and self._working is None and self.problem is None:
            self._begin(session, wish)

    def close(self) -> None:
        self._thread.shutdown(cancel_futures=True)

    def _request(self, session: EditorServices) -> _MatchRequest | str:
        """Request for the current view, or the reason why it can't be matched."""
        captures = session.captures
        capture = captures.capture
        if capture is None or not capture.has_poses:
            return "Open a capture whose cameras are known."
        scene = session.scene if captures.lies_in(session.scene) and session.scene.gaussian_count else None
        of = captures.stands_at(session)
        if of is not None:
            to = neighbor_view(capture, of, self.against, captures.chosen)
            return WHY_NONE[self.against] if to is None else _MatchRequest(capture, scene, of, to)
        shot = session.shot(*captures.viewport_px)
        pose = shot.camera.world_to_camera.tobytes() + np.array([shot.camera.fy, *captures.viewport_px]).tobytes()
        return _MatchRequest(capture, scene, None, captures.chosen, pose, shot.time_s if session.scene.actors else 0.0)

    def _begin(self, session: EditorServices, wish: _MatchRequest) -> None:
        from ..appearance.scene_views import PlacedCamera

        if wish.of is None:
            shot = session.shot(*session.captures.viewport_px)
            camera: Camera = shot.camera
            of: int | PlacedCamera = PlacedCamera("the view", camera, shot.time_s)
        else:
            camera, of = session.captures.cameras(session.scene)[wish.of], wish.of
        self._working = wish, camera, self._thread.submit(self._match, wish, camera, of)

    def _match(self, wish: _MatchRequest, camera: Camera, of: "int | PlacedCamera") -> MatchResult:
        """Compute a match; in the thread, one after another."""
        from .matching_image import MatchableViews, flow_lines, outcome_shares

        views = self._views
        if views is None or views.capture is not wish.capture or views.scene is not wish.scene:
            self._views = views = MatchableViews(wish.capture, wish.scene)
        matched = views.matched(of, wish.to)
        return MatchResult(wish, camera, matched, flow_lines(matched), outcome_shares(matched))

    def _take(self, wish: _MatchRequest, camera: Camera, work: "Future[MatchResult]") -> None:
        self._working = None
        try:
            self.shown, self._failed = work.result(), None
        except (CaptureError, OSError, ValueError, MemoryError) as error:
            self._failed = wish, str(error)
            logger.warning("Matching: %s", error)


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
