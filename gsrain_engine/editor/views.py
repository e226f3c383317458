"""Named views in the editor: save the present one, go to one, and the small pictures of their list."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import cv2
import msgspec
import numpy as np
from jaxtyping import UInt8
from msgspec import structs

from ..datasets.capture import CaptureError
from ..datasets.io.images import opened_image
from ..rain.keyframes import saved_rain
from ..rain.settings import RainSettings
from ..render.images import jpeg_file
from ..safe_io.errors import convert_checked
from ..scene.camera import Camera
from ..scene.named_view import MAX_VIEWS, NamedView, view_named
from ..scene.orthographic import orthographic
from ..scene.scene import Scene
from .document import Document
from .edits.members import unique_name
from .edits.views import move_view, remove_view, rename_view, save_view
from .status import StatusBus
from .timeline import Playback
from .viewport.camera import find_scene_core
from .viewport.options import Texture
from .viewport_state import ViewportState

_VIEW_SIZE = (960, 640)  # of a camera of which only pose and field of view count
_PICTURE_PX, _PICTURE_QUALITY = (144, 96), 80
_ON_LINE = 1e-6  # share of its distance by which an orbit target may be beside the line of sight
_WIND = "wind_speed_m_s", "wind_from_deg"


class NamedViews:
    """Named views of the document. Main thread only."""

    def __init__(self, document: Document, viewport: ViewportState, playback: Playback, status: StatusBus) -> None:
        self._document, self._viewport, self._playback, self._status = document, viewport, playback, status
        self.with_time = self.with_rain = True
        """True if views that are saved hold the time, and the rain."""
        self.chosen = ""
        """Name of the view to rename, move and delete; "" for none."""
        self.textures: Mapping[str, Texture] = {}
        """Pictures of the views by name, in the window's OpenGL context."""
        self.typed = ""
        """Name typed for the next view; empty for a numbered one."""
        self.renamed = self.new_name = ""
        """View that is being renamed, "" for none, and the typed name."""
        self.is_naming_new = False
        """True if the field of the new name is to get the keyboard."""
        self._gesture = ""

    @property
    def views(self) -> tuple[NamedView, ...]:
        """Views of the document, in their order."""
        return self._document.scene.views

    @property
    def has_chosen(self) -> bool:
        """True if a view of the document is chosen."""
        return any(view.name == self.chosen for view in self.views)

    @property
    def unused_name(self) -> str:
        """Name of the next view if none is typed: "View 1", "View 2", ..."""
        return unique_name("View 1", {view.name for view in self.views})

    @property
    def can_save(self) -> bool:
        """True if the scene has something to look at and room for another view."""
        return bool(self._document.scene.members) and len(self.views) < MAX_VIEWS

    def save(self, name: str = "") -> bool:
        """Save the present view under a name, or an unused one, in place of one of that name; return whether it was."""
        name = name.strip() or self.unused_name
        try:
            view = self._present(name)
        except ValueError as error:
            self._status.report(error)
            return False
        is_known = any(each.name == name for each in self.views)
        label = f"Set view to current: {name}" if is_known else f"Save view: {name}"
        self._document.end_gesture()
        self._gesture = f"save view {name}"
        if not self._document.edit(label, save_view, view, gesture=self._gesture):
            return False
        self.chosen, self._viewport.thumbnail_requested = name, True
        return True

    def save_typed(self) -> bool:
        """Save the present view under the typed name; return whether it was saved."""
        if not self.save(self.typed):
            return False
        self.typed = ""
        return True

    def take_picture(self, pixels: UInt8[np.ndarray, "h w 3"]) -> None:
        """Give the view that was just saved its picture, in the same step of the history."""
        step = self._document.history.step
        if self._document.history.continues(self._gesture) and step.arguments:
            view = structs.replace(step.arguments[0], picture=small_picture(pixels))
            self._document.edit(step.label, save_view, view, gesture=self._gesture)
            self._document.end_gesture()

    def go_to(self, name: str) -> None:
        """Look from a view: its camera, time and rain, of which the latter is a step of the history if it differs."""
        try:
            view = view_named(self.views, name, self._document.scene.name)
            changes = {} if view.rain is None else self._rain_changes(rain_of_view(self._document.scene, view))
        except ValueError as error:
            self._status.report(error)
            return
        viewport, to_world = self._viewport, self._document.scene.scene_to_world
        viewport.chase.begin("free")
        viewport.look_from(view.camera(*_VIEW_SIZE).moved(to_world))
        viewport.options.orthographic = view.orthographic
        if view.target is not None:
            navigation = viewport.navigation
            navigation.set_pivot(to_world[:3, :3] @ view.target + to_world[:3, 3])
            if np.linalg.norm(navigation.target - navigation.pivot) < _ON_LINE * navigation.distance_m:
                navigation.pivot = None
        if view.time_s is not None:
            self._playback.clock.seek(view.time_s)
        if changes:
            self._document.change_rain(f"Rain of view: {name}", **changes)
        self.chosen = name

    def go_to_number(self, number: int) -> None:
        """Go to a view by its place in the list, which counts from 0."""
        self.go_to(self.views[number].name)

    def begin_renaming(self, name: str) -> None:
        """Let the panel ask for another name of a view."""
        self.renamed, self.new_name, self.is_naming_new = name, name, True

    def rename(self, name: str, other: str) -> None:
        """Rename a view; a name that is in use or not allowed is reported, and nothing changes."""
        other = other.strip()
        if other != name and self._document.edit(f"Rename view: {name} to {other}", rename_view, name, other):
            self.chosen = other

    def remove(self, name: str) -> None:
        self._document.edit(f"Delete view: {name}", remove_view, name)

    def move(self, name: str, steps: int) -> None:
        """Move a view in the list: -1 is one place up."""
        at = [view.name for view in self.views].index(name)
        self._document.edit(f"Move view {'up' if steps < 0 else 'down'}: {name}", move_view, name, at + steps)

    def _present(self, name: str) -> NamedView:
        """The present view of the viewport, in units and axes of the scene."""
        document, viewport, navigation = self._document, self._viewport, self._viewport.navigation
        to_scene = np.linalg.inv(document.scene.scene_to_world)
        is_plan = viewport.is_orthographic
        camera = navigation.camera(*_VIEW_SIZE) if is_plan else viewport.shot(*_VIEW_SIZE).camera
        pivot = navigation.target if navigation.pivot is None else navigation.pivot
        if viewport.options.follow_path:  # the pivot is that of the camera which was left
            pivot = camera.position + navigation.distance_m * camera.world_to_camera[2, :3]
        x, y, z = (to_scene[:3, :3] @ pivot + to_scene[:3, 3]).tolist()
        return NamedView.of(
            name,
            camera.moved(to_scene),
            target=(x, y, z),
            orthographic=is_plan,
            time_s=float(self._playback.clock.time_s) if self.with_time else None,
            rain=plain_rain(document.rain) if self.with_rain else None,
        )

    def _rain_changes(self, rain: RainSettings) -> dict[str, Any]:
        """Fields in which a rain differs from the present one, without those that follow keyframes."""
        keyframes, present = self._document.keyframes, self._document.rain
        return {
            name: value
            for name, value in structs.asdict(rain).items()
            if value != getattr(present, name) and not keyframes.is_keyed("wind_m_s" if name in _WIND else name)
        }


# Views outside of the window


def camera_of_view(scene: Scene, view: NamedView, width: int, height: int) -> Camera:
    """Camera of a view for an image size in pixels, in the world (meters)."""
    camera = view.camera(width, height).moved(scene.scene_to_world)
    if not view.orthographic or view.target is None:
        return camera
    depth_m = float(np.linalg.norm(np.subtract(view.target, view.position))) * scene.metres_per_unit
    return orthographic(camera, depth_m, find_scene_core(scene))


def rain_of_view(scene: Scene, view: NamedView) -> RainSettings:
    """Rain of a view that has one. Raises `ValueError`, which names view and field, if its values are invalid."""
    try:
        return convert_checked(saved_rain(replace(scene, rain=view.rain)), RainSettings)
    except ValueError as error:
        raise ValueError(f"view {view.name!r}: its rain can't be used: {error}") from None


def scene_at_view(scene: Scene, view: NamedView) -> Scene:
    """Scene with the rain of a view in place of its own, if the view has one.

    Raises `ValueError`, which names view and field, if the values of that rain are invalid.
    """
    return scene if view.rain is None else replace(scene, rain=plain_rain(rain_of_view(scene, view)))


def plain_rain(rain: RainSettings) -> dict[str, Any]:
    """Rain as JSON values, as views hold it."""
    return msgspec.json.decode(msgspec.json.encode(rain))


# Pictures of the list


def small_picture(pixels: UInt8[np.ndarray, "h w 3"]) -> bytes:
    """Middle of a picture in the shape of the list's, as a small JPEG file."""
    (width, height), (rows, columns) = _PICTURE_PX, pixels.shape[:2]
    scale = min(columns / width, rows / height)
    wide, high = max(round(scale * width), 1), max(round(scale * height), 1)
    left, top = (columns - wide) // 2, (rows - high) // 2
    part = np.ascontiguousarray(pixels[top : top + high, left : left + wide])
    return jpeg_file(cv2.resize(part, _PICTURE_PX, interpolation=cv2.INTER_AREA), _PICTURE_QUALITY)


def picture_pixels(picture: bytes) -> UInt8[np.ndarray, "h w 3"] | None:
    """Pixels of the small picture of a view; None if it is damaged, or too large for one."""
    try:
        with opened_image(picture, "picture") as image:
            if max(image.size) > _LARGEST_PX:
                return None
            return np.asarray(image.convert("RGB"))
    except CaptureError:
        return None


_LARGEST_PX = 512
