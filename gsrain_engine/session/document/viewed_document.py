"""A document as it is looked at: from where, at which moment, in which rain; and what is on its way into it."""

from collections.abc import Hashable

import numpy as np

from gsrain_engine.rain.presets import load_preset
from gsrain_engine.rain.rain import Rain
from gsrain_engine.rain.rainfall import OVERCAST, Rainfall
from gsrain_engine.render.frame import Color
from gsrain_engine.render.scene_view import Shot
from gsrain_engine.render.sky_color import Sky
from gsrain_engine.scene.bounds import Core, core_bounds
from gsrain_engine.scene.paths.camera_path import CameraPath
from gsrain_engine.scene.scene import Scene

from ..timeline.clock import Clock
from ..timeline.rows import content_span
from ..timeline.timeline import Timeline
from ..view.chase import Chase
from ..view.following import Following
from ..view.home_camera import home_navigation, scene_core
from ..view.navigation import Navigation
from ..view.ride import Ride
from ..view.view_options import ViewOptions
from .document import Document
from .edited_document import EditedDocument
from .staged_scene import StagedScene

_VIEW_SIZE = (960, 640)  # shape of the picture that home cameras are chosen for


class ViewedDocument(EditedDocument):
    """The present document with its camera, its clock, and the rain that falls in it."""

    def __init__(self, scene: Scene, rain: Rain | None = None) -> None:
        """Begin with a scene; without a rain it is dry."""
        super().__init__(Document(scene, rain or load_preset("clear")), Clock())
        self.navigation = Navigation()
        self.view = ViewOptions()
        self.timeline = Timeline()
        self.following = Following()
        self.chase = Chase()
        """The camera that goes along with a roll-out."""
        self._ride = Ride()
        self._core: tuple[Hashable, Core] | None = None
        self.preview: Scene | None = None
        """What a tool wants drawn in place of the scene while something is dragged; to be said again each frame."""
        self._shown_preview: Scene | None = None
        self.staged: StagedScene | None = None
        self.rainfall = Rainfall.start(self.rain)
        self.sky_seen = Sky(OVERCAST, found=False)
        """What the live view saw when it looked at the sky last."""
        self.sky_is_stale = True
        """Whether the live view should look at the sky again: it is another scene's."""
        self._scene_of_sky = scene

    # What is shown

    @property
    def shown_scene(self) -> Scene:
        """What the viewport shows: the scene, or what a tool drags."""
        return self.scene if self._shown_preview is None else self._shown_preview

    @property
    def shown_rainfall(self) -> Rainfall:
        """The rain that the viewport shows."""
        return self.rainfall

    @property
    def wetness_now(self) -> float:
        """Share of the soaked colours at the present time, 0..1."""
        return self.shown_rainfall.wetness_at(self.clock.time_s)

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

    def stage(self, staged: StagedScene) -> None:
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

    def shot(self, width: int, height: int, focal_scale: float = 1.0) -> Shot:
        """What the viewport shows now; `focal_scale` is output size over drawn size."""
        t = self.clock.time_s
        if self.view.follow_path:
            camera = self.path.camera(t, width, height)
            stands = not self.path.is_timed and not self.clock.playing  # photos without times, looked at one by one
            return Shot(camera, t, None if stands else self.path.velocity(t), camera.fx * focal_scale)
        camera = self.navigation.camera(width, height)
        ride = self.following.velocity_m_s if self.chase.velocity_m_s is None else self.chase.velocity_m_s
        velocity = self.navigation.velocity_m_s if ride is None else self.navigation.velocity_m_s + ride
        return Shot(camera, t, velocity, camera.fx * focal_scale)

    def frame_scene(self) -> None:
        """Back off until the chosen layer or actor can be seen, or else the scene where it is dense."""
        chosen = next((each for each in self.scene.members if each.key == self.view.member and each.visible), None)
        part = None if chosen is None else self.scene.part(chosen, self.clock.time_s)
        self.navigation.frame(self.core if part is None else core_bounds([part]))

    def dolly(self, steps: float) -> None:
        """Come nearer to what is looked at (positive) or go away; from outside of the scene, to the scene."""
        self.navigation.dolly(steps, self.core)

    @property
    def core(self) -> Core:
        """Where the scene is dense; found anew where something else can be seen."""
        matter = self.scene.matter
        if self._core is None or self._core[0] != matter:
            self._core = matter, scene_core(self.scene)
        return self._core[1]

    def go_home(self) -> None:
        """Go to where the scene is first looked at from."""
        self.navigation = home_navigation(self.scene, *_VIEW_SIZE, self.navigation.speed_m_s)

    def enter_scene(self) -> None:
        """Begin anew with the view and the timeline: this is another place."""
        self._ride, self.timeline, self.clock.span_s = Ride(), Timeline(), None
        self.go_home()
        self.sky_is_stale = True

    # Going along with the document

    def _follow_document(self) -> None:
        self.preview = self._shown_preview = None
        if self.scene is not self._scene_of_sky:
            before, self._scene_of_sky = self._scene_of_sky, self.scene
            self._stay_in_place(before)
            self.sky_is_stale = self.sky_is_stale or before.matter != self.scene.matter
        if self.rainfall.rain != self.rain or self.rainfall.weather is not self.weather:
            self.rainfall = self.rainfall.changed(self.rain, self.clock.time_s, self.weather)

    def _stay_in_place(self, before: Scene) -> None:
        """Let the camera see the same where the scene has got other metres or another up."""
        old, new = before.scene_to_world, self.scene.scene_to_world
        if not np.array_equal(old, new):
            step = new @ np.linalg.inv(old)
            self.navigation.carry(step)
