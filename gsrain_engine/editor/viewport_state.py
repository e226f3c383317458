"""A document as it is looked at: from where, at which moment, in which rain; and what is on its way into it."""

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

_VIEW_SIZE = (960, 640)  # shape of the picture that home cameras are chosen for

# § A scene on its way into the picture.


@dataclass(frozen=True, slots=True, eq=False)
class PendingScene:
    """A new scene that is shown as soon as its Gaussians are on the GPU."""

    label: str
    scene: Scene
    is_opened: bool = False
    """Whether it takes the place of the present document instead of being a step of it."""
    is_whole: bool = False
    """Whether it is another scene; else it brings new Gaussians for members of the present one."""
    only_wet_colors: bool = False
    """Whether nothing but its wet colours is wanted: what a person has edited meanwhile stays."""
    gesture: str | None = None
    """Scenes of one gesture make one step: snapshots of a training, and what it ends with."""
    goes_on: bool = False
    """Whether it is only wanted while the step of its gesture is the present one."""


class ViewportState(EditedDocument):
    """The present document with its camera, its clock, and the rain that falls in it."""

    def __init__(self, scene: Scene, rain: RainSettings | None = None) -> None:
        """Begin with a scene; without a rain it is dry."""
        super().__init__(Document(scene, rain or load_preset("clear")), PlaybackClock())
        self.navigation = OrbitCamera()
        self.view = ViewOptions()
        self.timeline = Timeline()
        self.following = ActorFollower()
        self.chase = ChaseCamera()
        """The camera that goes along with a roll-out."""
        self._ride = PathFollower()
        self._core: tuple[Hashable, SceneCore] | None = None
        self.preview: Scene | None = None
        """What a tool wants drawn in place of the scene while something is dragged; to be said again each frame."""
        self._shown_preview: Scene | None = None
        self.staged: PendingScene | None = None
        self.rainfall = RainSimulation.start(self.rain)
        self.sky_seen = SkyColor(OVERCAST, found=False)
        """What the live view saw when it looked at the sky last."""
        self.sky_is_stale = True
        """Whether the live view should look at the sky again: it is another scene's."""
        self._scene_of_sky = scene

    # What is shown

    @property
    def displayed_scene(self) -> Scene:
        """What the viewport shows: the scene, or what a tool drags."""
        return self.scene if self._shown_preview is None else self._shown_preview

    @property
    def displayed_rain(self) -> RainSimulation:
        """The rain that the viewport shows."""
        return self.rainfall

    @property
    def wetness_now(self) -> float:
        """Share of the soaked colours at the present time, 0..1."""
        return self.displayed_rain.wetness_at(self.clock.time_s)

    @property
    def sky(self) -> Color:
        """Colour of the scene's sky at the present time, which drops take."""
        return self.sky_seen.at(self.wetness_now)

    @property
    def span_s(self) -> tuple[float, float]:
        """First and last moment that play: as a person has set them, else those of what happens in the scene."""
        return self.clock.span_s or content_span(self.scene, self.weather)

    @property
    def is_opening(self) -> bool:
        """Whether another scene is about to take the place of this one."""
        return self.staged is not None and self.staged.is_opened

    def stage(self, staged: PendingScene) -> None:
        """Show a scene as soon as its Gaussians are where the next frame needs them."""
        self.staged = staged

    # From where

    @property
    def path(self) -> CameraPath:
        """The way that riding along and recording take, in the world: the person's own, else a default one."""
        return self._ride.path(self.scene)

    def ride(self, on: bool) -> None:
        """Ride along the camera path, or leave it at the place where the camera is now."""
        if on:
            self.view.follow_path = True
        else:
            self.stop_riding()

    def stop_riding(self) -> None:
        """Leave the camera path, at the place where the camera is now."""
        self.chase.let_go()
        if self.view.follow_path:
            self.navigation.look_like(self.shot(*_VIEW_SIZE).camera)
            self.view.follow_path = False

    def shot(self, width: int, height: int, focal_scale: float = 1.0) -> RenderView:
        """What the viewport shows now; `focal_scale` is output size over drawn size."""
        t = self.clock.time_s
        if self.view.follow_path:
            camera = self.path.camera(t, width, height)
            stands = not self.path.is_timed and not self.clock.playing  # photos without times, looked at one by one
            return RenderView(camera, t, None if stands else self.path.velocity(t), camera.fx * focal_scale)
        camera = self.navigation.camera(width, height)
        ride = self.following.velocity_m_s if self.chase.velocity_m_s is None else self.chase.velocity_m_s
        velocity = self.navigation.velocity_m_s if ride is None else self.navigation.velocity_m_s + ride
        return RenderView(camera, t, velocity, camera.fx * focal_scale)

    def frame_scene(self) -> None:
        """Back off until the chosen layer or actor can be seen, or else the scene where it is dense."""
        chosen = next((each for each in self.scene.members if each.key == self.view.member and each.visible), None)
        part = None if chosen is None else self.scene.part(chosen, self.clock.time_s)
        self.navigation.frame(self.core if part is None else core_bounds([part]))

    def dolly(self, steps: float) -> None:
        """Come nearer to what is looked at (positive) or go away; from outside of the scene, to the scene."""
        self.navigation.dolly(steps, self.core)

    @property
    def core(self) -> SceneCore:
        """Where the scene is dense; found anew where something else can be seen."""
        matter = self.scene.geometry_key
        if self._core is None or self._core[0] != matter:
            self._core = matter, find_scene_core(self.scene)
        return self._core[1]

    def go_home(self) -> None:
        """Go to where the scene is first looked at from."""
        self.navigation = home_viewport_camera(self.scene, *_VIEW_SIZE, self.navigation.speed_m_s)

    def enter_scene(self) -> None:
        """Begin anew with the view and the timeline: this is another place."""
        self._ride, self.timeline, self.clock.span_s = PathFollower(), Timeline(), None
        self.go_home()
        self.sky_is_stale = True

    # Going along with the document

    def _follow_document(self) -> None:
        self.preview = self._shown_preview = None
        if self.scene is not self._scene_of_sky:
            before, self._scene_of_sky = self._scene_of_sky, self.scene
            self._stay_in_place(before)
            self.sky_is_stale = self.sky_is_stale or before.geometry_key != self.scene.geometry_key
        if self.rainfall.rain != self.rain or self.rainfall.weather is not self.weather:
            self.rainfall = self.rainfall.changed(self.rain, self.clock.time_s, self.weather)

    def _stay_in_place(self, before: Scene) -> None:
        """Let the camera see the same where the scene has got other metres or another up."""
        old, new = before.scene_to_world, self.scene.scene_to_world
        if not np.array_equal(old, new):
            step = new @ np.linalg.inv(old)
            self.navigation.carry(step)


# § How a scene that was on its way comes into the document.

logger = logging.getLogger("gsrain")


def insert_pending_scene(document: ViewportState, staged: PendingScene) -> None:
    is_present = document.history.gesture == staged.gesture
    if staged.goes_on and not is_present:
        return  # a person has gone on with something else
    if staged.is_whole:
        document.set_scene(staged.label, staged.scene, staged.gesture)
        if staged.gesture is None or not is_present:
            document.enter_scene()
    elif staged.only_wet_colors:
        before = document.scene
        document.edit(staged.label, with_wet_colors_of, staged.scene, gesture=staged.gesture)
        if document.scene is not before:
            logger.info("Wet colours are there: they come with the rain's intensity, or with the Wetness by hand")
    else:
        document.set_scene(staged.label, with_gaussians_of(document.scene, staged.scene), staged.gesture)
