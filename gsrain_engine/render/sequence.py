"""Frame sequences: cameras and times of a video; frame k doesn't depend on the other frames."""

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
from jaxtyping import Float32, Float64, UInt8

from ..choices import Mark, RenderMode
from ..rain.settings import RainSettings
from ..rain.simulation import OVERCAST, RainSimulation
from ..scene.camera import Camera
from ..scene.camera_path import CameraPath
from ..scene.rig import rig_camera
from ..scene.scene import PoseTrack, RigCamera, Scene
from ..water.glass import CameraMotion, GlassState
from .bands import PictureBands, has_one_band
from .draw import draw, filters_of, meter
from .export_settings import Projection
from .frame_input import FALLING, FILTERS, CameraMemory, FrameInput, Mount, Quality, Sky
from .images import to_display, to_linear_light
from .level_of_detail import LodCut
from .panorama import compose, views_of
from .passes.glass import glass_state
from .passes.spray import has_spray
from .plan_marks import draw_marks
from .renderer import Frame, PendingImage, PictureFilter, Renderer
from .sky_color import SkyColor, sky_color
from .view import RenderView


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
class FollowingCamera:
    """Camera that moves with a road user or the ego vehicle, and keeps its own orientation. World frame, meters."""

    scene: Scene
    track: PoseTrack
    """In scene units and axes, with at least one valid sample; the camera rests before the first and after the last."""
    camera: Camera
    """Of the first valid sample."""

    def at(self, time_s: float) -> Camera:
        """Camera at a time."""
        track, to_world = self.track, self.scene.scene_to_world[:3, :3]
        times, places = track.times[track.valid], track.positions[track.valid]
        now = np.array([np.interp(time_s, times, column) for column in places.T])
        moved = self.camera.world_to_camera[:3, :3] @ to_world @ (now - places[0])
        return self.camera.shifted(*moved.tolist())

    @property
    def times_s(self) -> Float64[np.ndarray, " t"]:
        """Times of the valid samples."""
        return self.track.times[self.track.valid]


@dataclass(frozen=True, slots=True, eq=False)
class FrameSequence:
    """Scene, rain, camera and timing of a sequence of frames. World frame, meters."""

    scene: Scene
    rainfall: RainSimulation
    camera: Camera | CameraPath | RigCameraView | FollowingCamera
    """Fixed camera, camera path, camera of the ego vehicle's rig, or one that follows a road user."""
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
    marks: tuple[Mark, ...] = ()
    """Marks over the 8-bit images of an orthographic camera."""
    sky_scene: Scene | None = None
    """Scene whose sky gives drops and medium their colors, if another: that of a transparent background has none."""
    _memory: CameraMemory = field(default_factory=CameraMemory, init=False)
    _sampled: dict[str, SkyColor] = field(default_factory=dict[str, SkyColor], init=False)
    """Sky by back end."""

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
            case RigCameraView() | FollowingCamera():
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
            case FollowingCamera():
                return RenderView(self.camera.at(time_s).resized(self.width, self.height), time_s)

    def sky(self, renderer: Renderer) -> SkyColor:
        """Sample the sky from the start of the sequence, once; all cameras of a rig use the same position."""
        if renderer.name in self._sampled:
            return self._sampled[renderer.name]
        match self.camera:
            case Camera():
                place = self.camera
            case CameraPath():
                place = self.camera.camera(0.0, self.width, self.height)
            case FollowingCamera():
                place = self.camera.camera
            case RigCameraView():
                rig, ego = self.camera.rig, self.scene.ego
                assert ego is not None
                front = max(self.scene.rigs[rig], key=lambda each: each.camera_to_ego[0, 2])
                place = rig_camera(self.scene, rig, front.name, float(ego.times[int(np.argmax(ego.valid))]))
        scene, thinning = self.sky_scene or self.scene, LodCut() if self.lod else None
        found = sky_color(renderer, scene, place, thinning=thinning, dry=self.rainfall.is_never_overcast)
        self._sampled[renderer.name] = found
        return found

    def frame(
        self,
        renderer: Renderer,
        number: int,
        sky: SkyColor | None,
        *,
        with_depth: bool = False,
        mode: RenderMode = "splats",
        face: int | None = None,
    ) -> Frame:
        """Render a frame; `sky=None` omits the rain. Depth is the scene's at the frame's time, one sample per pixel.

        That of an orthographic camera counts from its picture plane.
        Samples inside a pixel are averaged as the renderer blends: premultiplied, in display values. Sub-frames are
        averaged as on a sensor: in linear light. `face` is one of the views of a panorama or a stereo image.
        """
        if self.projection != "perspective" and face is None:
            faces = range(len(views_of(self.shot(number), self.projection)))
            frames = [self.frame(renderer, number, sky, with_depth=with_depth, mode=mode, face=each) for each in faces]
            return compose(frames, self.projection, self.width, self.height)

        middle, shots, side = self.shot(number), self.shots(number), self.supersampling
        if face is not None:
            middle, *shots = (views_of(shot, self.projection)[face] for shot in (middle, *shots))
        whole = self.frame_input(middle, sky, mode)
        has_own_depth = with_depth and len(shots) == side == 1 and not has_spray(whole)
        filters = ()
        if face is None:
            self._meter(renderer, whole)
            filters = filters_of(renderer, whole)
        bands = PictureBands(renderer, side)
        quality = replace(whole.quality, with_depth=has_own_depth, bands=bands)
        quality = replace(quality, thinning=None) if has_own_depth else quality
        frame: Frame | None = None
        total: Float32[np.ndarray, "h w 4"] | None = None
        for shot in shots:
            if side > 1:  # the choice of drops still follows the output image's focal length
                camera = shot.camera
                finer = camera.resized(side * camera.width, side * camera.height)
                shot = replace(shot, camera=finer, focal_px=shot.focal_px or float(np.sqrt(camera.fx * camera.fy)))
            frame = draw(renderer, whole.changed(view=shot, quality=quality, without=whole.without | FILTERS)).frame()
            if len(shots) > 1:
                light = to_linear_light(frame.rgba)
                total = light if total is None else total + light
        assert frame is not None
        if total is not None:
            frame = replace(frame, rgba=to_display(total / np.float32(len(shots))))
        if self.sky_scene is not None and whole.falling is not None and whole.falling.extinction_per_m > 0:
            frame = self._without_airlight(renderer, frame, whole)
        if with_depth and not has_own_depth:
            alone = Quality(with_depth=True, bands=PictureBands(renderer))
            depth = draw(renderer, whole.changed(quality=alone, is_clear=True, without=FILTERS)).frame().depth
            frame = replace(frame, depth=depth)
        if frame.depth is not None and middle.camera.is_orthographic:
            behind_m = np.maximum(frame.depth - np.float32(middle.camera.plane_m), 0)
            frame = replace(frame, depth=behind_m)
        return replace(frame, filters=filters + self._marks_of(middle))

    def frame_input(self, shot: RenderView, sky: Sky | None, mode: RenderMode = "splats") -> FrameInput:
        """Everything that a picture of the sequence holds; `sky=None` leaves out the rain."""
        mount = Mount(self._memory, past=self._motion, camera_to_vehicle=self._camera_to_vehicle)
        is_cut = self.lod and mode == "splats" and not shot.camera.is_orthographic
        quality = Quality(mode, thinning=LodCut() if is_cut else None)
        without = frozenset[str]() if self.falls else FALLING
        return FrameInput.of(
            self.scene, self.rainfall, sky or OVERCAST, shot, quality,
            is_clear=sky is None, without=without, mount=mount,
        )  # fmt: skip

    def _meter(self, renderer: Renderer, frame: FrameInput) -> None:
        """Meter automatic exposure at the start of the sequence, once."""
        if frame.is_image:
            meter(renderer, frame.changed(view=self.shot_at(self.start_s)))

    def _without_airlight(self, renderer: Renderer, frame: Frame, whole: FrameInput) -> Frame:
        """Remove the medium's light behind the scene, as far as there is nothing but the transparent background.

        What covers a pixel is the scene and the streaks, drawn once more without the medium, which covers the rest.
        """
        assert whole.falling is not None
        quality = replace(whole.quality, thinning=None, bands=PictureBands(renderer))
        clear_air = whole.changed(quality=quality, without=whole.without | FILTERS | {"medium"})
        alpha = draw(renderer, clear_air).frame().rgba[..., 3:]
        airlight = whole.falling.airlight.astype(np.float32)
        color = np.maximum(frame.rgba[..., :3] - np.maximum(frame.rgba[..., 3:] - alpha, 0) * airlight, 0)
        return replace(frame, rgba=np.concatenate([np.minimum(color, alpha), alpha], axis=-1))

    def image(
        self, renderer: Renderer, number: int, sky: SkyColor | None, *, mode: RenderMode = "splats"
    ) -> UInt8[np.ndarray, "h w 3"]:
        """Render a frame as bytes, those of `frame(...).to_uint8()`; one sample is converted before it is read back."""
        return self.request(renderer, number, sky, mode=mode)()

    def request(
        self, renderer: Renderer, number: int, sky: SkyColor | None, *, mode: RenderMode = "splats"
    ) -> PendingImage:
        """Draw a frame as `image` does, and start to read it back: others can be drawn meanwhile."""
        shot = self.shot(number)
        is_composed = self.motion_blur > 1 or self.supersampling > 1 or self.projection != "perspective"
        if is_composed or not has_one_band(shot.camera):
            return self.frame(renderer, number, sky, mode=mode).to_uint8
        whole = self.frame_input(shot, sky, mode)
        self._meter(renderer, whole)
        drawn, marks = draw(renderer, whole), self._marks_of(shot)
        return replace(drawn, filters=drawn.filters + marks).request_uint8()

    def _marks_of(self, shot: RenderView) -> tuple[PictureFilter, ...]:
        marks = partial(draw_marks, self.scene, shot, self.marks)
        return (PictureFilter("marks", marks),) if self.marks else ()

    def glass_state(self, number: int) -> GlassState:
        """Figures of the water on the glass at a frame; all 0 without glass."""
        return glass_state(self.frame_input(self.shot(number), OVERCAST))

    def _motion(self, time_s: float) -> CameraMotion:
        """Orientation and velocity at a time; before the path or drive those of its start."""
        match self.camera:
            case Camera() | FollowingCamera():
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
