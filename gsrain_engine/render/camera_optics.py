"""Optics of cameras over time: water on the glass in front of them, and the response of their sensors."""

from collections.abc import Hashable
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64

from ..rain.frame import SkyLight
from ..rain.simulation import OVERCAST, RainSimulation
from ..scene.scene import Scene
from ..water.glass import CameraMotion, GlassHistory, GlassState, PastMotion
from ..water.glass_drops import GlassDrops
from ..water.pane import GlassKind, Pane, pane_of
from ..water.refraction import GlassView, WetGlass, wide_view
from ..water.spray import spray_of
from .camera_response import CameraResponse, PictureOptics, metered_gain
from .cpu.renderer import CpuRenderer
from .draw import LodSample, RenderView, draw_view, ego_view
from .renderer import Renderer

WIDE_SHARE = 1 / 32
"""Share of the Gaussians in the wide view behind the glass (docs/physics.md, section 18)."""

WIDE_PX2 = 1.0
"""Area of the wide view, in its pixels, below which fewer Gaussians are drawn."""


class CameraOptics:
    """Optics of one or more cameras. A frame does not depend on those drawn before."""

    def __init__(self) -> None:
        self._gains: dict[Hashable, float] = {}
        self._water: dict[Hashable, tuple[RainSimulation, GlassHistory]] = {}

    def of(
        self,
        renderer: Renderer,
        scene: Scene,
        rainfall: RainSimulation,
        sky: SkyLight,
        shot: RenderView,
        *,
        camera: Hashable = "",
        past: PastMotion | None = None,
        camera_to_vehicle: Float64[np.ndarray, "3 3"] | None = None,
        falls: bool = True,
    ) -> PictureOptics | None:
        """Return the optics of a frame, before it is drawn: metering, and the view behind drops, are drawn here.

        None if nothing acts on the picture. Automatic exposure is metered in the scene without rain, dry, at the first
        frame of each `camera`: a rainy picture and its twin without rain have the same gain. `past` is the camera's
        motion up to the frame; None is a camera that does not move. Glass is dry unless rain `falls`.
        """
        response = self._response(renderer, scene, rainfall, shot, camera)
        through = self.glass_view(
            renderer, scene, rainfall, sky, shot,
            camera=camera, past=past, camera_to_vehicle=camera_to_vehicle, falls=falls,
        )  # fmt: skip
        return None if through is None and response is None else PictureOptics(through, response)

    def glass_view(
        self,
        renderer: Renderer,
        scene: Scene,
        rainfall: RainSimulation,
        sky: SkyLight,
        shot: RenderView,
        *,
        camera: Hashable = "",
        past: PastMotion | None = None,
        camera_to_vehicle: Float64[np.ndarray, "3 3"] | None = None,
        falls: bool = True,
    ) -> GlassView | None:
        """Return the glass in front of a camera, as `of` does, without the sensor; None without glass."""
        pane = pane_in_front(rainfall, shot, camera_to_vehicle)
        if pane is None:
            return None
        if shot.camera.lens is not None:
            raise ValueError("glass: water on glass is drawn for pinhole cameras; choose none for a camera with a lens")
        glass = self._glass(pane, scene, rainfall, shot.time_s, camera, past or at_rest(shot), falls=falls)
        lens = rainfall.lens(shot.camera)
        wide = wide_view(shot.camera, pane, lens)
        if len(glass.drops):
            # Drops on glass shrink streaks and splashes to nothing, and of the mirror leave what wet colors have baked
            # in.
            view = replace(shot, camera=wide, focal_px=None)
            thinning = LodSample(WIDE_SHARE, WIDE_PX2 if isinstance(renderer, CpuRenderer) else 0.0)
            draw_view(renderer, scene, rainfall, sky, view, thinning=thinning, only_medium=True)
            behind = renderer.read_uint8().copy()
        else:
            behind = np.zeros((wide.height, wide.width, 3), np.uint8)
        return GlassView(glass, shot.camera, lens, behind)

    def meter(
        self, renderer: Renderer, scene: Scene, rainfall: RainSimulation, shot: RenderView, camera: Hashable = ""
    ) -> None:
        """Meter automatic exposure at a view, unless it was metered before."""
        self._response(renderer, scene, rainfall, shot, camera)

    def _response(
        self, renderer: Renderer, scene: Scene, rainfall: RainSimulation, shot: RenderView, camera: Hashable
    ) -> CameraResponse | None:
        sensor = rainfall.picture_sensor
        if sensor is None:
            return None
        if sensor.mean_gray is not None and camera not in self._gains:
            draw_view(renderer, scene, None, OVERCAST, shot)
            self._gains[camera] = metered_gain(renderer.read_uint8(), sensor)
        return CameraResponse(sensor, shot.camera, shot.time_s, rainfall.rain.seed, self._gains.get(camera, 1.0))

    def _glass(
        self, pane: Pane, scene: Scene, rainfall: RainSimulation, time_s: float, camera: Hashable, past: PastMotion,
        *, falls: bool,
    ) -> WetGlass:  # fmt: skip
        rain = rainfall.rain
        is_wet = falls and rainfall.weather.heaviest_mm_h(rain) > 0
        drops, film_m, blade_rad = np.zeros((0, 10)), np.zeros((1, 1), np.float32), None
        if is_wet:
            known = self._water.get(camera)
            is_same = known is not None and known[0].rain == rain and known[1].pane.key == pane.key
            if known is None or not is_same or known[0].weather is not rainfall.weather:
                known = self._water[camera] = rainfall, glass_history(pane, rainfall, past)
            history = known[1]
            history.past, history.spray = past, partial(spray_of, scene, rainfall)
            history.at(time_s)
            drops, film_m = history.drops.present(), history.drops.film_m
            blade_rad = history.wiper.angle_rad if pane.kind == "windshield" and rain.wiper != "off" else None
        return WetGlass(
            pane, drops, film_m, GlassDrops.film_cell_m, rain.contact_angle_deg, blade_rad, rain.glass_dirt, rain.seed
        )


def pane_in_front(
    rainfall: RainSimulation, shot: RenderView, camera_to_vehicle: Float64[np.ndarray, "3 3"] | None = None
) -> Pane | None:
    """Pane of the glass that the rain names, in the view of a camera; None without one."""
    rain = rainfall.rain
    if rain.glass == "none":
        return None
    kind: GlassKind = rain.glass
    return pane_of(kind, shot.camera, rain.glass_distance_m, camera_to_vehicle)


def glass_history(pane: Pane, rainfall: RainSimulation, past: PastMotion) -> GlassHistory:
    """Water on a pane with the settings of the rain."""
    rain = rainfall.rain
    return GlassHistory(
        pane, rainfall, past,
        contact_angle_deg=rain.contact_angle_deg, wet_s=rain.glass_wet_s, wiper=rain.wiper,
    )  # fmt: skip


def glass_state(
    rainfall: RainSimulation,
    shot: RenderView,
    past: PastMotion | None = None,
    camera_to_vehicle: Float64[np.ndarray, "3 3"] | None = None,
) -> GlassState:
    """Figures of the water on the glass in front of a camera at a time; all 0 without glass."""
    pane = pane_in_front(rainfall, shot, camera_to_vehicle)
    if pane is None:
        return GlassState(impacts=0, expected_impacts=0.0, seconds=0.0, area_m2=0.0)
    return glass_history(pane, rainfall, past or at_rest(shot)).at(shot.time_s)


def at_rest(shot: RenderView) -> PastMotion:
    """Past motion of a camera that keeps the pose and the velocity of a view."""
    velocity = np.zeros(3) if shot.velocity_m_s is None else shot.velocity_m_s
    motion = CameraMotion(shot.camera.camera_to_world[:3, :3], velocity, shot.camera.position)
    return lambda time_s: motion


class EgoMotion(NamedTuple):
    """Motion of a camera that is fixed to the scene's ego vehicle."""

    motion: PastMotion
    camera_to_ego: Float64[np.ndarray, "3 3"] | None
    """Orientation on the vehicle; None without one."""


def ego_motion(scene: Scene, shot: RenderView) -> EgoMotion:
    """Motion of the camera of `ego_view` over time: with the ego vehicle where it is present, else at rest."""
    now = scene.ego_to_world(shot.time_s)
    if now is None:
        return EgoMotion(at_rest(shot), None)
    camera_to_ego = np.linalg.inv(now) @ shot.camera.camera_to_world

    def motion(time_s: float) -> CameraMotion:
        then = scene.ego_to_world(time_s)
        if then is None:
            return CameraMotion(shot.camera.camera_to_world[:3, :3], np.zeros(3))
        pose = then @ camera_to_ego
        camera = replace(shot.camera, world_to_camera=np.linalg.inv(pose))
        velocity = ego_view(scene, camera, time_s).velocity_m_s
        return CameraMotion(pose[:3, :3], np.zeros(3) if velocity is None else velocity, pose[:3, 3])

    return EgoMotion(motion, camera_to_ego[:3, :3])
