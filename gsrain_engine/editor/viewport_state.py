"""Viewport state: the document with camera, clock, rain and sky, and scenes waiting to be shown."""

import logging
from collections.abc import Hashable
from dataclasses import dataclass

import numpy as np

from ..rain.settings import RainSettings, load_preset
from ..rain.simulation import OVERCAST, RainSimulation
from ..render.draw import RenderView
from ..render.renderer import Color
from ..render.sky_color import SkyColor
from ..scene.camera_path import CameraPath
from ..scene.scene import Scene, SceneCore, core_bounds
from ..scene.transforms import with_wet_colors_of
from .document import Document, EditedDocument
from .edits.members import with_gaussians_of
from .timeline import PlaybackClock, Timeline, content_span
from .viewport.camera import OrbitCamera, find_scene_core, home_viewport_camera
from .viewport.camera_follow import ActorFollower, ChaseCamera, PathFollower
from .viewport.options import ViewOptions

_VIEW_SIZE = (960, 640)  # aspect ratio for home cameras

# Pending scenes


@dataclass(frozen=True, slots=True, eq=False)
class PendingScene:
    """A new scene, shown as soon as its Gaussians are on the GPU."""

    label: str
    scene: Scene
    is_opened: bool = False
    """True if it replaces the present document instead of being a step of it."""
    is_whole: bool = False
    """True if it is another scene; otherwise it has new Gaussians for members of the present one."""
    only_wet_colors: bool = False
    """True to take only its wet colors, so that concurrent edits stay."""
    gesture: str | None = None
    """Scenes of one gesture form one undo step: snapshots and the final result of a training."""
    goes_on: bool = False
    """True if it is only used while the step of its gesture is the present one."""


class ViewportState(EditedDocument):
    """The present document with its camera, its clock, and its rain."""

    def __init__(self, scene: Scene, rain: RainSettings | None = None) -> None:
        """Start with a scene; without `rain` it is dry."""
        super().__init__(Document(scene, rain or load_preset("clear")), PlaybackClock())
        self.navigation = OrbitCamera()
        self.view = ViewOptions()
        self.timeline = Timeline()
        self.following = ActorFollower()
        self.chase = ChaseCamera()
        """Camera that follows the vehicle of a roll-out."""
        self._ride = PathFollower()
        self._core: tuple[Hashable, SceneCore] | None = None
        self.preview: Scene | None = None
        """Scene to draw during a drag; tools set it again in each frame."""
        self._shown_preview: Scene | None = None
        self.staged: PendingScene | None = None
        self.rainfall = RainSimulation.start(self.rain)
        self.sky_seen = SkyColor(OVERCAST, found=False)
        """Last sky color sample of the live view."""
        self.sky_is_stale = True
        """True if the live view has to sample the sky again, e.g. for another scene."""
        self._scene_of_sky = scene

    # Displayed state

    @property
    def displayed_scene(self) -> Scene:
        """Scene of the viewport: the drag preview if there is one."""
        return self.scene if self._shown_preview is None else self._shown_preview

    @property
    def displayed_rain(self) -> RainSimulation:
        return self.rainfall

    @property
    def wetness_now(self) -> float:
        """Wetness (share of the wet colors) at the present time, 0..1."""
        return self.displayed_rain.wetness_at(self.clock.time_s)

    @property
    def sky(self) -> Color:
        """Sky color at the present time, used for drops."""
        return self.sky_seen.at(self.wetness_now)

    @property
    def span_s(self) -> tuple[float, float]:
        """Start and end of playback: as set by the user, else those of the scene's content."""
        return self.clock.span_s or content_span(self.scene, self.weather)

    @property
    def is_opening(self) -> bool:
        """True if another scene is about to replace this one."""
        return self.staged is not None and self.staged.is_opened

    def stage(self, staged: PendingScene) -> None:
        """Show a scene as soon as its Gaussians are ready for the next frame."""
        self.staged = staged

    # Camera

    @property
    def path(self) -> CameraPath:
        """Path to ride along and to record, in the world: the user's own, else a default one."""
        return self._ride.path(self.scene)

    def ride(self, on: bool) -> None:
        """Start to ride along the camera path, or leave it at the camera's present pose."""
        if on:
            self.view.follow_path = True
        else:
            self.stop_riding()

    def stop_riding(self) -> None:
        """Leave the camera path, at the camera's present pose."""
        self.chase.let_go()
        if self.view.follow_path:
            self.navigation.look_like(self.shot(*_VIEW_SIZE).camera)
            self.view.follow_path = False

    def shot(self, width: int, height: int, focal_scale: float = 1.0) -> RenderView:
        """Present view of the viewport; `focal_scale` is output size over rendered size."""
        t = self.clock.time_s
        if self.view.follow_path:
            camera = self.path.camera(t, width, height)
            stands = not self.path.is_timed and not self.clock.playing  # untimed photos, viewed one by one
            return RenderView(camera, t, None if stands else self.path.velocity(t), camera.fx * focal_scale)
        camera = self.navigation.camera(width, height)
        ride = self.following.velocity_m_s if self.chase.velocity_m_s is None else self.chase.velocity_m_s
        velocity = self.navigation.velocity_m_s if ride is None else self.navigation.velocity_m_s + ride
        return RenderView(camera, t, velocity, camera.fx * focal_scale)

    def frame_scene(self) -> None:
        """Move back until the selected layer or actor is visible, or else the dense part of the scene."""
        chosen = next((each for each in self.scene.members if each.key == self.view.member and each.visible), None)
        part = None if chosen is None else self.scene.part(chosen, self.clock.time_s)
        self.navigation.frame(self.core if part is None else core_bounds([part]))

    def dolly(self, steps: float) -> None:
        """Move toward the target (positive) or away; from outside of the scene, toward the scene."""
        self.navigation.dolly(steps, self.core)

    @property
    def core(self) -> SceneCore:
        """Dense part of the scene; recomputed when its visible geometry changes."""
        matter = self.scene.geometry_key
        if self._core is None or self._core[0] != matter:
            self._core = matter, find_scene_core(self.scene)
        return self._core[1]

    def go_home(self) -> None:
        self.navigation = home_viewport_camera(self.scene, *_VIEW_SIZE, self.navigation.speed_m_s)

    def enter_scene(self) -> None:
        """Reset the view and the timeline for another scene."""
        self._ride, self.timeline, self.clock.span_s = PathFollower(), Timeline(), None
        self.go_home()
        self.sky_is_stale = True

    # Update after document changes

    def _follow_document(self) -> None:
        self.preview = self._shown_preview = None
        if self.scene is not self._scene_of_sky:
            before, self._scene_of_sky = self._scene_of_sky, self.scene
            self._stay_in_place(before)
            self.sky_is_stale = self.sky_is_stale or before.geometry_key != self.scene.geometry_key
        if self.rainfall.rain != self.rain or self.rainfall.weather is not self.weather:
            self.rainfall = self.rainfall.changed(self.rain, self.clock.time_s, self.weather)

    def _stay_in_place(self, before: Scene) -> None:
        """Keep the camera's view when the scene's scale or up direction changes."""
        old, new = before.scene_to_world, self.scene.scene_to_world
        if not np.array_equal(old, new):
            step = new @ np.linalg.inv(old)
            self.navigation.carry(step)


# Insertion of pending scenes

logger = logging.getLogger("gsrain")


def insert_pending_scene(document: ViewportState, staged: PendingScene) -> None:
    is_present = document.history.gesture == staged.gesture
    if staged.goes_on and not is_present:
        return  # the user has continued with something else
    if staged.is_whole:
        document.set_scene(staged.label, staged.scene, staged.gesture)
        if staged.gesture is None or not is_present:
            document.enter_scene()
    elif staged.only_wet_colors:
        before = document.scene
        document.edit(staged.label, with_wet_colors_of, staged.scene, gesture=staged.gesture)
        if document.scene is not before:
            logger.info("Wet colors are ready: the intensity, or Wetness in the Rain panel, blends them in")
    else:
        document.set_scene(staged.label, with_gaussians_of(document.scene, staged.scene), staged.gesture)
