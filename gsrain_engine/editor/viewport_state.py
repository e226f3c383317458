"""State of the viewport: camera, followers, options, quality, previews, and scenes waiting to be displayed."""

import time
from collections.abc import Callable, Hashable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, get_args

import numpy as np

from ..choices import Mark
from ..render.view import RenderView
from ..scene.camera import Camera
from ..scene.camera_path import CameraPath
from ..scene.orthographic import fitted_scale, orientation, orthographic
from ..scene.scene import Actor, DrawItem, Layer, Scene, SceneCore, core_bounds
from .background import Background
from .document import Document, DocumentState, Recipe
from .edits.members import members_title, replace_scene
from .timeline import Playback
from .viewport.camera import NavigationMotion, OrbitCamera, find_scene_core, home_viewport_camera
from .viewport.camera_follow import ActorFollower, ChaseCamera, PathFollower
from .viewport.obstacles import ObstacleFinder
from .viewport.options import FULL_QUALITY, AdaptiveQuality, QualityLevel, Texture, ViewOptions
from .viewport.picking import SkyColorPick, pick_point
from .viewport.picture_rate import PictureRate

_VIEW_SIZE = (960, 640)  # aspect ratio for home cameras


@dataclass(frozen=True, slots=True, eq=False)
class PendingScene:
    """A new scene, displayed as soon as its Gaussians are on the GPU."""

    label: str
    scene: Scene
    is_opened: bool = False
    """True if it replaces the present document instead of being a step of it."""
    change: Callable[[Scene, Scene], Scene] = replace_scene
    """Edit of the present scene that takes this one as its argument; `replace_scene` also resets the view."""
    recipe: Recipe | None = None
    """See `Step.recipe`."""
    gesture: str | None = None
    """Scenes of one gesture form one undo step: snapshots and the final result of a training."""
    goes_on: bool = False
    """True if it is only used while the step of its gesture is the present one."""


class ViewportState:
    """Camera and options of the viewport, and what it draws besides the document. Follows the document."""

    def __init__(self, document: Document, playback: Playback, background: Background) -> None:
        self.document, self.playback = document, playback
        self.navigation = OrbitCamera()
        self.options = ViewOptions()
        self.following = ActorFollower()
        self.chase = ChaseCamera()
        """Camera that follows the vehicle of a roll-out."""
        self.preview: Scene | None = None
        """Scene to draw during a drag; tools set it again in each frame."""
        self.drawn_preview: Scene | None = None
        """The preview that was set in the last frame, drawn in this one."""
        self.is_reading = False
        """True while a scene that will replace this one is read."""
        self.staged: PendingScene | None = None
        """Scene to display as soon as its Gaussians are ready for the next frame."""
        self.budget = AdaptiveQuality()
        self.detail: QualityLevel = FULL_QUALITY
        """Quality of the present image."""
        self.is_moving = False
        """True if the camera has moved since the last frame."""
        self.motion = NavigationMotion()
        self.rate = PictureRate()
        """Pictures on the screen."""
        self.statistics: dict[str, float] = {}
        """Figures of the last frame by name, in the order of the Statistics panel."""
        self.full_ms_per_megapixel: float | None = None
        """Drawing time of the last picture of full quality, by its size."""
        self.backend = self.backend_reason = ""
        self.is_compiling = self.is_preparing = False
        """True if the viewport can't be drawn before kernels are compiled or loaded."""
        self.kernels: int | None = None
        """Number of kernels that are compiled so far while the renderer is prepared; None if it is unknown."""
        self.is_catching_up = False
        """True if the next frames continue unfinished work although nothing moves."""
        self.screenshot: Path | None = None
        """Path at which the next image is saved."""
        self.thumbnail_requested = False
        """True if the next image goes to the list of named views."""
        self.sky_pick: SkyColorPick | None = None
        """Region of the next image whose color is to become the drop color."""
        self.job_previews: Mapping[Any, Texture] = {}
        """Image of each running job that has one."""
        self.picture_view: RenderView | None = None
        """View of the picture on the screen, in the size of the viewport; it may be a moment behind the camera."""
        self.obstacles = ObstacleFinder(background)
        self._given_m = np.full(3, np.nan)  # position of a recorded camera, from which nothing stops an orbit
        self._path = PathFollower()
        self._range_from = ""  # key of the layer or actor from which a range extends
        self._core: tuple[Hashable, SceneCore] | None = None
        self._last_view: RenderView | None = None
        self._last_content: Hashable = None
        self._observed_at = 0.0
        document.followers.append(self._follow)

    @property
    def is_opening(self) -> bool:
        """True if another scene is about to replace this one."""
        return self.is_reading or (self.staged is not None and self.staged.is_opened)

    # Layers and actors that are chosen

    @property
    def active_member(self) -> Layer | Actor | None:
        """The layer or actor that was chosen last; None if none is, or it has gone."""
        return next((each for each in self.document.scene.members if each.key == self.options.member), None)

    @property
    def chosen_members(self) -> list[Layer | Actor]:
        """All layers and actors that are chosen and have not gone, in the order in which they were."""
        active, members = self.active_member, {each.key: each for each in self.document.scene.members}
        keys = self.options.members if self.options.member in self.options.members else (self.options.member,)
        return [] if active is None else [members[key] for key in keys if key in members]

    @property
    def chosen_title(self) -> str:
        """Name of the chosen layer or actor, or how many there are; empty for none."""
        return members_title(self.chosen_members)

    def choose(self, *keys: str) -> None:
        """Choose layers and actors in place of others; the last is the active one."""
        self.options.members = tuple(dict.fromkeys(keys))
        self.options.member = self._range_from = keys[-1] if keys else ""

    def choose_also(self, key: str) -> None:
        """Choose one more layer or actor, or choose it no longer."""
        chosen = [each.key for each in self.chosen_members]
        self.choose(*(each for each in chosen if each != key), *([] if key in chosen else [key]))

    def choose_range(self, key: str, *, adds: bool = False) -> None:
        """Choose all rows of the list from the last one that was chosen alone to this one, which becomes active."""
        rows, chosen = [each.key for each in self.document.scene.members], [each.key for each in self.chosen_members]
        start = self._range_from if self._range_from in chosen else self.options.member
        start = start if start in rows else key
        low, high = sorted((rows.index(start), rows.index(key)))
        between = [each for each in rows[low : high + 1] if each != key]
        self.choose(*(each for each in chosen if adds and each != key), *between, key)
        self._range_from = start

    def choose_all(self) -> None:
        """Choose all layers and actors; the active one stays."""
        rows, active = [each.key for each in self.document.scene.members], self.options.member
        self.choose(*(each for each in rows if each != active), *([active] if active in rows else []))

    # Camera

    @property
    def path(self) -> CameraPath:
        """Path to ride along and to record, in the world: the user's own, else a default one."""
        return self._path.path(self.document.scene)

    def ride(self, on: bool) -> None:
        """Start to ride along the camera path, or leave it at the camera's present pose."""
        if on:
            self.options.follow_path = True
        else:
            self.stop_riding()

    def stop_riding(self) -> None:
        self.chase.let_go()
        if self.options.follow_path:
            self.navigation.look_like(self.shot(*_VIEW_SIZE).camera)
            self.options.follow_path = False

    def shot(self, width: int, height: int, focal_scale: float = 1.0, *, ahead_s: float = 0.0) -> RenderView:
        """View of the viewport, at present or as expected in a moment; `focal_scale` is output size over drawn size."""
        t = self.playback.time_ahead(ahead_s) if ahead_s else self.playback.clock.time_s
        if self.options.follow_path:
            camera = self.path.camera(t, width, height)
            is_still = not self.path.is_timed and not self.playback.clock.playing  # untimed photos, viewed one by one
            return RenderView(camera, t, None if is_still else self.path.velocity(t), camera.fx * focal_scale)
        camera = self.motion.expected(self.navigation, ahead_s).camera(width, height)
        if self.options.orthographic:
            camera = orthographic(camera, self.navigation.distance_m, self.core)
        ride = self.following.velocity_m_s if self.chase.velocity_m_s is None else self.chase.velocity_m_s
        velocity = self.navigation.velocity_m_s if ride is None else self.navigation.velocity_m_s + ride
        return RenderView(camera, t, velocity, camera.fx * focal_scale)

    @property
    def is_orthographic(self) -> bool:
        """True if the view is to scale; along the path it is that of the path's camera."""
        return self.options.orthographic and not self.options.follow_path

    @property
    def marks(self) -> tuple[Mark, ...]:
        """Marks over the view; none unless it is orthographic."""
        shown = self.options.marks if self.is_orthographic else ()
        return tuple(each for each in get_args(Mark) if each in shown)

    def look_from_above(self) -> None:
        """Show the scene from above, to scale, with +y upwards; leave paths and actors."""
        self.stop_riding()
        self.following.follow("")
        eye, options, core = self.navigation, self.options, self.core
        options.orthographic, eye.pivot, eye.heading, eye.pitch = True, None, np.pi / 2, -np.pi / 2
        camera = None if self.picture_view is None else self.picture_view.camera
        width, height = _VIEW_SIZE if camera is None else (camera.width, camera.height)
        down_m = height / fitted_scale(core, orientation(self.document.scene, "top"), width, height)
        eye.distance_m = down_m / (2 * float(np.tan(np.radians(eye.vertical_fov_deg) / 2)))
        eye.position = core.middle - eye.distance_m * eye.forward

    def canvas_view(self, width: int, height: int) -> RenderView:
        """View of the picture on the screen, for what is drawn over it and picked in it; at first the present one."""
        view = self.picture_view
        is_fitting = view is not None and (view.camera.width, view.camera.height) == (width, height)
        return view if view is not None and is_fitting else self.shot(width, height)

    def scaled_shot(
        self,
        width: int,
        height: int,
        content: Hashable = None,
        *,
        is_animated: bool,
        stands: bool = False,
        ahead_s: float = 0.0,
    ) -> tuple[RenderView, QualityLevel]:
        """View of the next frame, in the resolution of its quality: reduced if needed while something changes.

        It is the one expected in `ahead_s`. `content` is what the picture shows, but for camera and time. `is_animated`
        is true if it changes although the camera rests; `stands`, if it can be drawn over a backdrop then.
        """
        detail = self._observe(self.shot(width, height), content, is_animated=is_animated, stands=stands)
        if self.screenshot is not None:
            detail = FULL_QUALITY
        scale = detail.scale / self.options.shrink
        drawn_height = max(1, round(height * scale))
        focal_scale = detail.focal_share * height / drawn_height
        return self.shot(max(1, round(width * scale)), drawn_height, focal_scale, ahead_s=ahead_s), detail

    def _observe(self, now: RenderView, content: Hashable, *, is_animated: bool, stands: bool) -> QualityLevel:
        before, at = self._last_view, time.perf_counter()
        self.is_moving = before is not None and (
            now.camera.world_to_camera.tobytes() != before.camera.world_to_camera.tobytes()
            or now.camera.fx != before.camera.fx
        )
        resized = before is not None and now.camera.height != before.camera.height
        is_same, self._last_content = content == self._last_content, content
        self._last_view, real_s, self._observed_at = now, at - self._observed_at, at
        stands = stands and is_same and not (self.is_moving or resized)
        moving = is_animated or (self.is_moving and not resized)
        return self.budget.observe(moving=moving, real_s=real_s, stands=stands, edited=not is_same)

    def look_from(self, camera: Camera) -> None:
        """Take the pose of a camera (without roll) and its field of view; follow nothing any more."""
        self.stop_riding()
        self.following.follow("")
        self.options.orthographic = False
        self.navigation.stop()
        self.navigation.look_like(camera)
        self._given_m = self.navigation.position.copy()

    def follow_actor(self, key: str) -> None:
        """Follow an actor, or stop if it is followed already."""
        self.following.follow("" if self.following.key == key else key)
        self.options.follow_path = False

    def frame_scene(self) -> None:
        """Move back until the selected Gaussians are visible, else the chosen layers and actors, else the dense scene.

        Once that is framed, frame the next of these, and after the scene the first again.
        """
        scene, time_s = self.document.scene, self.playback.clock.time_s
        cores = [core_bounds(selected)] if (selected := selected_items(scene, time_s)) else []
        parts = [scene.part(each, time_s) for each in self.chosen_members if each.visible]
        there = [part for part in parts if part is not None]
        cores += [core_bounds(there)] if there else []
        cores.append(self.core)
        present = self.navigation.position
        framed = [self._framing(core) for core in cores]
        near = [np.allclose(each.position, present, atol=1e-6 * (1 + each.distance_m)) for each in framed]
        last = max((number for number, is_near in enumerate(near) if is_near), default=-1)
        self.navigation = framed[(last + 1) % len(framed)]

    def _framing(self, core: SceneCore) -> OrbitCamera:
        """The camera with a core framed."""
        camera = replace(self.navigation)
        camera.frame(core)
        return camera

    def set_pivot(self, x: float, y: float, width: int, height: int) -> bool:
        """Orbit around the surface at a pixel of the picture; return whether there is one."""
        point_m = pick_point(self.document.scene, self.canvas_view(width, height), x, y)
        if point_m is not None:
            self.stop_riding()
            eye, scale_m = self.navigation, self.navigation.distance_m
            eye.set_pivot(point_m)
            if self.options.orthographic:  # along the line of sight, so that the view and its scale stay
                eye.position, eye.distance_m = eye.position + (eye.distance_m - scale_m) * eye.forward, scale_m
        return point_m is not None

    def orbit(self, right_rad: float, up_rad: float) -> None:
        """Turn around the pivot; near a wall the camera stops in front of it."""
        before = replace(self.navigation)
        self.navigation.orbit(right_rad, up_rad)
        if self.options.orthographic or np.array_equal(before.position, self._given_m):
            return
        obstacles = self.obstacles.of(self.document.scene, self.core.radius_m)
        if obstacles is not None and obstacles.stops(before.position, self.navigation.position):
            self.navigation = before

    def dolly(self, steps: float) -> None:
        """Move toward the target (positive) or away; from outside of the scene, toward the scene.

        Of an orthographic view it changes the scale.
        """
        if self.options.orthographic:
            self.navigation.zoom(steps)
        else:
            self.navigation.dolly(steps, self.core)

    @property
    def core(self) -> SceneCore:
        """Dense part of the scene; recomputed when its visible geometry changes."""
        key = self.document.scene.geometry_key
        if self._core is None or self._core[0] != key:
            self._core = key, find_scene_core(self.document.scene)
        return self._core[1]

    def go_home(self) -> None:
        self.options.orthographic = False
        self.navigation = home_viewport_camera(self.document.scene, *_VIEW_SIZE, self.navigation.speed_m_s)

    def reset(self) -> None:
        """Reset the camera for another scene, and forget how long the last one took to draw."""
        self._path, self.full_ms_per_megapixel = PathFollower(), None
        self.go_home()

    def _follow(self, old: DocumentState, new: DocumentState) -> None:
        self.preview = self.drawn_preview = None
        if old.scene is new.scene:
            return
        before, after = old.scene.scene_to_world, new.scene.scene_to_world
        if not np.array_equal(before, after):  # keep the view when the scale or the up direction changes
            self.navigation.carry(after @ np.linalg.inv(before))


def selected_items(scene: Scene, time_s: float) -> list[DrawItem]:
    """Items of the visible members at a time with their selected Gaussians alone."""
    items = list[DrawItem]()
    for member in scene.members:
        chosen, part = member.marks.selected, scene.part(member, time_s) if member.visible else None
        if part is not None and chosen:
            hidden = member.marks.left_out
            items.append(part._replace(left_out=~chosen if hidden is None else ~chosen | hidden))
    return items
