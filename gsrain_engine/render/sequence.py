"""Frame sequences: cameras and times of a video; frame k doesn't depend on the other frames."""

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace

import msgspec
import numpy as np
from jaxtyping import Float32, Float64, UInt8

from ..rain.frame import SkyLight
from ..rain.settings import RainSettings
from ..rain.simulation import OVERCAST, RainSimulation
from ..scene.camera import Camera
from ..scene.camera_path import CameraPath
from ..scene.rig import rig_camera
from ..scene.scene import RigCamera, Scene
from ..water.glass import CameraMotion, GlassState
from .bands import PictureBands, has_one_band
from .camera_optics import CameraOptics, glass_state
from .camera_response import PictureOptics
from .draw import LodCut, RenderView, draw_view, has_spray, request_picture
from .export_settings import Projection
from .images import to_display, to_linear_light
from .panorama import compose, views_of
from .renderer import Frame, PendingImage, Renderer, RenderMode
from .sky_color import SkyColor, sky_color


@dataclass(frozen=True, slots=True, eq=False)
class RigCameraView:
    """One camera of the ego vehicle's rig during the drive. World frame, meters."""

    scene: Scene
    rig: str
    name: str

    @property
    def camera_to_ego(self) -> Float64[np.ndarray, "4 4"]:
        """Pose in the frame of the vehicle (x forward, y left, z up)."""
        return next(each for each in self.scene.rigs[self.rig] if each.name == self.name).camera_to_ego

    def at(self, time_s: float) -> Camera:
        """Camera at a time, in its own size; raises `ValueError` if the vehicle is absent."""
        return rig_camera(self.scene, self.rig, self.name, time_s)

    def velocity(self, time_s: float) -> Float64[np.ndarray, "3"]:
        """Velocity at a time; zero outside the drive, and when the vehicle appears or disappears."""
        times = self.times_s
        before, after = np.clip([time_s - _STEP_S, time_s + _STEP_S], times[0], times[-1])
        if before < after and times[0] <= time_s <= times[-1]:
            with suppress(ValueError):
                return (self.at(float(after)).position - self.at(float(before)).position) / (after - before)
        return np.zeros(3)

    @property
    def times_s(self) -> Float64[np.ndarray, " t"]:
        assert self.scene.ego is not None
        return self.scene.ego.times


@dataclass(frozen=True, slots=True, eq=False)
class FrameSequence:
    """Scene, rain, camera and timing of a sequence of frames. World frame, meters."""

    scene: Scene
    rainfall: RainSimulation
    camera: Camera | CameraPath | RigCameraView
    """Fixed camera, camera path, or camera of the ego vehicle's rig."""
    width: int
    height: int
    fps: float = 30.0
    start_s: float = 0.0
    in_scene_time: bool = False
    """True if a path's times are the scene's own; otherwise its first keyframe is at 0 s."""
    supersampling: int = 1
    """Factor by which width and height are multiplied for drawing."""
    motion_blur: int = 1
    """Number of sub-frames over the exposure."""
    at_rest: bool = False
    """True if the camera is at rest during the exposure, for paths without times."""
    falls: bool = True
    """False draws the light and the wet colors of the rain, without its drops and its medium."""
    lod: bool = False
    """True if images without depth merge details smaller than a pixel, in members that have a tree."""
    projection: Projection = "perspective"
    sky_scene: Scene | None = None
    """Scene whose sky gives drops and medium their colors, if another: that of a transparent background has none."""
    _optics: CameraOptics = field(default_factory=CameraOptics, init=False)

    def time_s(self, number: int) -> float:
        """Time of a frame, the middle of its exposure."""
        return self.start_s + number / self.fps

    @property
    def length_s(self) -> float | None:
        """Time from the start to the end of the path or drive; None for a fixed camera."""
        match self.camera:
            case Camera():
                return None
            case CameraPath():
                return (self.camera.end_s if self.in_scene_time else self.camera.duration_s) - self.start_s
            case RigCameraView():
                return float(self.camera.times_s[-1]) - self.start_s

    def shot(self, number: int) -> RenderView:
        return self.shot_at(self.time_s(number))

    def shot_at(self, time_s: float) -> RenderView:
        match self.camera:
            case Camera():
                return RenderView(self.camera, time_s)
            case CameraPath():
                along = time_s if self.in_scene_time else float(self.camera.times_s[0]) + time_s
                velocity = None if self.at_rest else self.camera.velocity(along)
                return RenderView(self.camera.camera(along, self.width, self.height), time_s, velocity)
            case RigCameraView():
                camera = self.camera.at(time_s).resized(self.width, self.height)
                return RenderView(camera, time_s, self.camera.velocity(time_s))

    def sky(self, renderer: Renderer) -> SkyColor:
        """Sample the sky from the start of the sequence; all cameras of a rig use the same position."""
        match self.camera:
            case Camera():
                place = self.camera
            case CameraPath():
                place = self.camera.camera(0.0, self.width, self.height)
            case RigCameraView():
                rig, ego = self.camera.rig, self.scene.ego
                assert ego is not None
                front = max(self.scene.rigs[rig], key=lambda each: each.camera_to_ego[0, 2])
                place = rig_camera(self.scene, rig, front.name, float(ego.times[int(np.argmax(ego.valid))]))
        return sky_color(
            renderer,
            self.sky_scene or self.scene,
            place,
            thinning=LodCut() if self.lod else None,
            dry=self.rainfall.is_never_overcast,
        )

    def frame(
        self,
        renderer: Renderer,
        number: int,
        sky: SkyColor | None,
        *,
        with_depth: bool = False,
        look: RenderMode = "splats",
        face: int | None = None,
    ) -> Frame:
        """Render a frame; `sky=None` omits the rain. Depth is the scene's at the frame's time, one sample per pixel.

        Samples inside a pixel are averaged as the renderer blends: premultiplied, in display values. Sub-frames are
        averaged as on a sensor: in linear light. `face` is one of the views of a panorama or a stereo image.
        """
        if self.projection != "perspective" and face is None:
            faces = range(len(views_of(self.shot(number), self.projection)))
            frames = [self.frame(renderer, number, sky, with_depth=with_depth, look=look, face=each) for each in faces]
            return compose(frames, self.projection, self.width, self.height)

        def face_view(shot: RenderView) -> RenderView:
            return shot if face is None else views_of(shot, self.projection)[face]

        rainfall = None if sky is None else self.rainfall
        color = OVERCAST if sky is None else sky.at(self.rainfall.overcast_at(self.time_s(number)))
        shots, side = list(map(face_view, self.shots(number))), self.supersampling
        bands = PictureBands(renderer, side)
        has_own_depth = with_depth and len(shots) == side == 1
        has_own_depth = has_own_depth and not has_spray(self.scene, rainfall, shots[0].time_s)
        thinning = LodCut() if self.lod and look == "splats" and not has_own_depth else None
        optics = None
        if face is None:
            optics = self._optics_of(renderer, self.shot(number), color, look, falls=sky is not None)
        frame: Frame | None = None
        total: Float32[np.ndarray, "h w 4"] | None = None
        for shot in shots:
            if side > 1:  # the choice of drops still follows the output image's focal length
                camera = shot.camera
                finer = camera.resized(side * camera.width, side * camera.height)
                shot = replace(shot, camera=finer, focal_px=shot.focal_px or float(np.sqrt(camera.fx * camera.fy)))
            draw_view(
                renderer, self.scene, rainfall, color, shot, with_depth=has_own_depth, look=look, thinning=thinning,
                falls=self.falls, bands=bands,
            )  # fmt: skip
            frame = bands.frame
            if len(shots) > 1:
                light = to_linear_light(frame.rgba)
                total = light if total is None else total + light
        assert frame is not None
        if total is not None:
            frame = replace(frame, rgba=to_display(total / np.float32(len(shots))))
        has_medium = rainfall is not None and rainfall.state_at(self.time_s(number)).extinction_per_m > 0
        if self.sky_scene is not None and has_medium and self.falls:
            frame = self._without_airlight(renderer, frame, color, face_view(self.shot(number)))
        if with_depth and not has_own_depth:
            bands = PictureBands(renderer)
            draw_view(renderer, self.scene, None, color, face_view(self.shot(number)), with_depth=True, bands=bands)
            frame = replace(frame, depth=bands.frame.depth)
        return replace(frame, optics=optics)

    def _without_airlight(self, renderer: Renderer, frame: Frame, sky: SkyLight, shot: RenderView) -> Frame:
        """Remove the medium's light behind the scene, as far as there is nothing but the transparent background.

        What covers a pixel is the scene and the streaks, drawn once more without the medium, which covers the rest.
        """
        rain = msgspec.structs.replace(self.rainfall.rain, haze="none", visibility_m=None)
        clear_air = RainSimulation.start(rain, weather=self.rainfall.weather)
        bands = PictureBands(renderer)
        draw_view(renderer, self.scene, clear_air, sky, shot, falls=self.falls, bands=bands)
        alpha = bands.frame.rgba[..., 3:]
        airlight = np.array(self.rainfall.rain.drop_color or sky.airlight, np.float32)
        color = np.maximum(frame.rgba[..., :3] - np.maximum(frame.rgba[..., 3:] - alpha, 0) * airlight, 0)
        return replace(frame, rgba=np.concatenate([np.minimum(color, alpha), alpha], axis=-1))

    def image(
        self, renderer: Renderer, number: int, sky: SkyColor | None, *, look: RenderMode = "splats"
    ) -> UInt8[np.ndarray, "h w 3"]:
        """Render a frame as bytes, those of `frame(...).to_uint8()`; one sample is converted before it is read back."""
        return self.request(renderer, number, sky, look=look)()

    def request(
        self, renderer: Renderer, number: int, sky: SkyColor | None, *, look: RenderMode = "splats"
    ) -> PendingImage:
        """Draw a frame as `image` does, and start to read it back: others can be drawn meanwhile."""
        rainfall, shot = None if sky is None else self.rainfall, self.shot(number)
        is_composed = self.motion_blur > 1 or self.supersampling > 1 or self.projection != "perspective"
        if is_composed or not has_one_band(shot.camera):
            return self.frame(renderer, number, sky, look=look).to_uint8
        color = OVERCAST if sky is None else sky.at(self.rainfall.overcast_at(shot.time_s))
        optics = self._optics_of(renderer, shot, color, look, falls=sky is not None)
        thinning = LodCut() if self.lod and look == "splats" else None
        draw_view(renderer, self.scene, rainfall, color, shot, look=look, thinning=thinning, falls=self.falls)
        return request_picture(renderer, optics)

    def _optics_of(
        self, renderer: Renderer, shot: RenderView, sky: SkyLight, look: RenderMode, *, falls: bool
    ) -> PictureOptics | None:
        """Glass and sensor for a frame, with rain or without; None for other render modes than splats.

        Automatic exposure is that of the start of the sequence.
        """
        if look != "splats":
            return None
        if self.rainfall.picture_sensor is not None:
            self._optics.meter(renderer, self.scene, self.rainfall, self.shot_at(self.start_s))
        return self._optics.of(
            renderer, self.scene, self.rainfall, sky, shot,
            past=self._motion, camera_to_vehicle=self._camera_to_vehicle, falls=falls and self.falls,
        )  # fmt: skip

    def glass_state(self, number: int) -> GlassState:
        """Figures of the water on the glass at a frame; all 0 without glass."""
        return glass_state(self.rainfall, self.shot(number), self._motion, self._camera_to_vehicle)

    def _motion(self, time_s: float) -> CameraMotion:
        """Orientation and velocity at a time; before the path or drive those of its start."""
        match self.camera:
            case Camera():
                first_s = time_s
            case CameraPath():
                first_s = self.camera.start_s if self.in_scene_time else 0.0
            case RigCameraView():
                ego = self.camera.scene.ego
                assert ego is not None
                first_s = float(ego.times[int(np.argmax(ego.valid))])
        shot = self.shot_at(max(time_s, first_s))
        velocity = np.zeros(3) if shot.velocity_m_s is None else shot.velocity_m_s
        return CameraMotion(shot.camera.camera_to_world[:3, :3], velocity, shot.camera.position)

    @property
    def _camera_to_vehicle(self) -> Float64[np.ndarray, "3 3"] | None:
        """Orientation of a camera of a rig; None for others, which look ahead."""
        return self.camera.camera_to_ego[:3, :3] if isinstance(self.camera, RigCameraView) else None

    def shots(self, number: int) -> list[RenderView]:
        """Views of the sub-frames, evenly spaced over the exposure around the frame's time."""
        middle, k = self.shot(number), self.motion_blur
        if k == 1:
            return [middle]
        exposure_s = self.rainfall.frozen_at(middle.time_s).exposure_s(middle.camera)
        times = middle.time_s + exposure_s * ((np.arange(k) + 0.5) / k - 0.5)
        places = times
        if self.at_rest:
            places = np.full(k, middle.time_s)
        elif isinstance(self.camera, CameraPath) and not self.camera.loop:
            # A path has no speed beyond its ends: there the camera keeps its last position on the path.
            start = self.camera.start_s if self.in_scene_time else 0.0
            if start <= middle.time_s <= start + self.camera.duration_s:
                places = np.clip(times, start, start + self.camera.duration_s)
        return [
            replace(self.shot_at(float(place)), time_s=float(t), exposure_share=1 / k)
            for place, t in zip(places, times, strict=True)
        ]


def common_sky(renderer: Renderer, sequences: Mapping[str, FrameSequence]) -> SkyColor:
    """Sky that gives the drops of all cameras of a picture their color: sampled from the first one's start."""
    return next(iter(sequences.values())).sky(renderer)


_STEP_S = 0.005  # half the time span for velocities: tracks are linear between samples 100 ms apart


def find_rig_cameras(scene: Scene, names: tuple[str, ...]) -> list[RigCameraView]:
    """Find rig cameras by RIG (all of a rig), RIG/NAME, NAME, or "all"; each once, in the order of the names.

    Cameras that one name finds are in the order of the rigs.

    Raises `ValueError` for an unmatched name, or a scene without an ego vehicle.
    """

    def fits(name: str, rig: str, camera: RigCamera) -> bool:
        return name in ("all", rig, camera.name, f"{rig}/{camera.name}")

    every = [(rig, camera) for rig, cameras in scene.rigs.items() for camera in cameras]
    if not every or scene.ego is None or not len(scene.ego.times):
        raise ValueError(f"scene {scene.name!r} has no vehicle with cameras")
    for name in names:
        if not any(fits(name, rig, camera) for rig, camera in every):
            known = ", ".join(f"{rig}/{camera.name}" for rig, camera in every)
            raise ValueError(f"scene {scene.name!r} has no camera {name!r}, only {known}")
    found = [(rig, camera.name) for name in names for rig, camera in every if fits(name, rig, camera)]
    return [RigCameraView(scene, rig, name) for rig, name in dict.fromkeys(found)]


# Single image


def render_image(
    renderer: Renderer,
    scene: Scene,
    rain: RainSettings,
    camera: Camera,
    time_s: float = 0.0,
    *,
    with_depth: bool = False,
) -> Frame:
    """Draw a scene in its rain from a fixed camera (world, meters, z up) at a time of scene and rain.

    The result is the frame that `gsrain render` writes: wet colors follow the rain's wetness, and depth (m) is the
    scene's, without rain. Each call samples the sky for the color of the drops (paper, eq. 3): for many frames, reuse
    one `FrameSequence`. Raises `ValueError` for a missing calibration named by the rain.
    """
    rainfall = RainSimulation.start(rain)
    sequence = FrameSequence(scene, rainfall, camera, camera.width, camera.height, start_s=time_s)
    sky = sequence.sky(renderer) if rainfall.can_rain else SkyColor(OVERCAST, found=False)  # unused without drops
    return sequence.frame(renderer, 0, sky, with_depth=with_depth)
