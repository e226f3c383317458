"""Glass: water on a windshield or a lens in front of the camera, and what its drops show."""

from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64, UInt8

from ...rain.simulation import RainSimulation
from ...scene.camera import Camera
from ...scene.scene import Scene
from ...water.glass import CameraMotion, GlassHistory, GlassState, PastMotion
from ...water.glass_drops import GlassDrops
from ...water.pane import GlassKind, Pane, pane_of
from ...water.refraction import GlassView, WetGlass, wide_view
from ...water.spray import spray_of
from ..cpu.renderer import CpuRenderer
from ..frame_input import FALLING, FrameInput, Quality
from ..level_of_detail import LodSample
from ..photograph import widened
from ..renderer import PictureFilter
from ..view import RenderView, ego_view
from .base import Factor, FrameParts

WIDE_SHARE = 1 / 32
"""Share of the Gaussians in the wide view behind the glass (docs/physics/glass.md)."""

WIDE_PX2 = 1.0
"""Area of the wide view, in its pixels, below which fewer Gaussians are drawn."""

_NOT_BEHIND = {"glass", "sensor", "streaks", "rings", "mirror", "splashes"}
"""Left out of the view behind drops, which shrink streaks and splashes to nothing, and of the mirror leave what wet
colors have baked in."""


class Glass:
    """Wet glass of each camera, dry where nothing falls. The view behind its drops is drawn before the picture."""

    name = "glass"
    factor = Factor(name, "glass", {"glass": "none"}, {"glass": "windshield"})

    def active(self, frame: FrameInput) -> bool:
        return frame.is_image and pane_in_front(frame) is not None

    def add(self, frame: FrameInput, parts: FrameParts) -> None:
        view = frame.view
        pane = pane_in_front(frame)
        assert pane is not None and frame.simulation is not None
        if view.camera.lens is not None:
            raise ValueError("glass: water on glass is drawn for pinhole cameras; choose none for a camera with a lens")
        glass, lens = _glass(pane, frame), frame.simulation.lens(view.camera)
        wide = wide_view(view.camera, pane, lens)

        def draw_behind() -> UInt8[np.ndarray, "h w 3"]:
            thinning = LodSample(WIDE_SHARE, WIDE_PX2 if isinstance(parts.renderer, CpuRenderer) else 0.0)
            shown = replace(view, camera=wide, focal_px=None)
            drawn = frame.changed(view=shown, quality=Quality(thinning=thinning), without=frame.without | _NOT_BEHIND)
            return parts.draw(drawn).read_uint8().copy()

        behind, reuse = np.zeros((wide.height, wide.width, 3), np.uint8), frame.quality.reuse
        if len(glass.drops) and frame.photograph is None:
            size_px = wide.width, wide.height
            behind = draw_behind() if reuse is None else reuse.behind_glass(frame.scene, size_px, draw_behind)
        found = GlassView(glass, view.camera, lens, behind)
        if frame.photograph is None:
            parts.filters.append(PictureFilter(self.name, found.picture))
        else:
            parts.filters.append(PictureFilter(self.name, partial(_photographed, found, wide)))


def _photographed(glass: GlassView, wide: Camera, picture: UInt8[np.ndarray, "h w 3"]) -> UInt8[np.ndarray, "h w 3"]:
    """A photograph through glass: behind its drops is the photograph itself, its border going on beyond its edges."""
    return replace(glass, wide=widened(picture, glass.camera, wide)).picture(picture)


def _glass(pane: Pane, frame: FrameInput) -> WetGlass:
    rainfall, past, camera = frame.simulation, frame.mount.past or at_rest(frame.view), frame.mount.camera
    assert rainfall is not None
    rain, water = rainfall.rain, frame.mount.memory.water
    drops, film_m, blade_rad = np.zeros((0, 10)), np.zeros((1, 1), np.float32), None
    falls = not frame.is_clear and not frame.without >= FALLING
    if falls and rainfall.weather.heaviest_mm_h(rain) > 0:
        known = water.get(camera)
        is_same = known is not None and known[0].rain == rain and known[1].pane.key == pane.key
        if known is None or not is_same or known[0].weather is not rainfall.weather:
            known = water[camera] = rainfall, glass_history(pane, rainfall, past)
        history = known[1]
        history.past, history.spray = past, partial(spray_of, frame.scene, rainfall)
        history.at(frame.time_s)
        drops, film_m = history.drops.present(), history.drops.film_m.copy()  # the history goes on
        blade_rad = history.wiper.angle_rad if pane.kind == "windshield" and rain.wiper != "off" else None
    return WetGlass(
        pane, drops, film_m, GlassDrops.film_cell_m, rain.contact_angle_deg, blade_rad, rain.glass_dirt, rain.seed
    )


def pane_in_front(frame: FrameInput) -> Pane | None:
    """Pane of the glass that the rain names, in the view of a camera; None without one."""
    if frame.simulation is None or frame.simulation.rain.glass == "none":
        return None
    rain = frame.simulation.rain
    kind: GlassKind = frame.simulation.rain.glass
    return pane_of(kind, frame.view.camera, rain.glass_distance_m, frame.mount.camera_to_vehicle)


def glass_history(pane: Pane, rainfall: RainSimulation, past: PastMotion) -> GlassHistory:
    """Water on a pane with the settings of the rain."""
    rain = rainfall.rain
    return GlassHistory(
        pane, rainfall, past,
        contact_angle_deg=rain.contact_angle_deg, wet_s=rain.glass_wet_s, wiper=rain.wiper,
    )  # fmt: skip


def glass_state(frame: FrameInput) -> GlassState:
    """Figures of the water on the glass in front of a camera; all 0 without glass."""
    pane = pane_in_front(frame)
    if pane is None:
        return GlassState(impacts=0, expected_impacts=0.0, seconds=0.0, area_m2=0.0)
    assert frame.simulation is not None
    return glass_history(pane, frame.simulation, frame.mount.past or at_rest(frame.view)).at(frame.time_s)


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
