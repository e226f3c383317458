"""Draws the rig's cameras small, one a frame in turn. Lives in the window's OpenGL context and on its thread."""

from collections.abc import Hashable

import moderngl
import numpy as np

from gsrain_engine.drive.simulation.rig_pictures import of_width, placed_camera
from gsrain_engine.render.scene_view import Shot
from gsrain_engine.render.screen import Screen
from gsrain_engine.scene.scene import RigCamera, Scene

from ..session import Session
from ..view.texture import Texture
from .live_view import LiveView


class MosaicPictures:
    """Keeps a picture of each camera, and goes on with the one that has waited longest."""

    def __init__(self, context: moderngl.Context) -> None:
        self._context = context
        self._screens: dict[str, Screen] = {}
        self._states: dict[str, Hashable] = {}
        self._turn: list[str] = []
        """Names of the cameras, the one that was drawn last at the end."""

    def update(self, session: Session, view: LiveView) -> None:
        """Draw one camera that is out of date, if the mosaic is to be seen. Once a frame, after the viewport."""
        mosaic = session.drives.mosaic
        wanted, mosaic.is_wanted, mosaic.is_behind = mosaic.is_wanted, False, False
        scene = session.drives.rig_scene(session)
        if not wanted or scene.ego is None:
            return
        cameras = {each.name: each for each in mosaic.cameras(scene)}
        self._keep_only(cameras)
        mosaic.pictures = {name: each for name, each in mosaic.pictures.items() if name in cameras}
        stale = [name for name in self._turn if self._states.get(name) != _state(session, scene, cameras[name])]
        if not stale:
            return
        name = stale[0]
        picture = self._draw(session, view, scene, cameras[name])
        if picture is not None:
            mosaic.pictures[name] = picture
            self._states[name] = _state(session, scene, cameras[name])
        self._turn = [each for each in self._turn if each != name] + [name]
        mosaic.is_behind = len(stale) > 1 or picture is None

    def _keep_only(self, cameras: dict[str, RigCamera]) -> None:
        self._turn = [name for name in self._turn if name in cameras]
        self._turn += [name for name in cameras if name not in self._turn]
        self._screens = {name: screen for name, screen in self._screens.items() if name in cameras}
        self._states = {name: state for name, state in self._states.items() if name in cameras}

    def _draw(self, session: Session, view: LiveView, scene: Scene, mounted: RigCamera) -> Texture | None:
        time_s = session.clock.time_s
        pose = scene.ego_to_world(time_s)
        if pose is None:
            return None
        small = of_width(mounted, session.drives.mosaic.width_px)
        shot = Shot(placed_camera(small, pose), time_s, _velocity(scene, time_s), mounted.fx)
        screen = self._screens.setdefault(mounted.name, Screen(self._context))
        texture = view.draw_aside(scene, shot, screen)
        return None if texture is None else Texture(texture.glo, texture.width, texture.height)


_STEP_S = 0.05


def _velocity(scene: Scene, time_s: float) -> np.ndarray | None:
    """Of the ego vehicle in the world, m/s, over the tenth of a second around a moment."""
    before, after = scene.ego_to_world(time_s - _STEP_S), scene.ego_to_world(time_s + _STEP_S)
    return None if before is None or after is None else (after[:3, 3] - before[:3, 3]) / (2 * _STEP_S)


def _state(session: Session, scene: Scene, camera: RigCamera) -> Hashable:
    return (
        scene.appearance,
        session.shown_rainfall,
        session.sky,
        session.clock.time_s,
        session.drives.mosaic.width_px,
        camera,
        session.clock.playing,
        session.view.gain_ev,
    )
