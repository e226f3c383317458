"""Video of a roll-out: front camera, plan on the road, status line and top view."""

from collections.abc import Iterable, Iterator
from itertools import chain, pairwise
from pathlib import Path
from typing import NamedTuple

import cv2
import msgspec
import numpy as np
from jaxtyping import Float64, UInt8
from PIL import Image, ImageDraw, ImageFont

from ..evaluation.detection.detector import Detection
from ..evaluation.detection.drawing import draw_boxes
from ..rain.simulation import RainSimulation
from ..render.draw import draw, meter
from ..render.export_settings import Lod
from ..render.frame_input import CameraMemory, FrameInput, Mount, Quality
from ..render.level_of_detail import LodCut, lod_cut
from ..render.provenance import provenance_of
from ..render.renderer import PendingImage, Renderer
from ..render.sky_color import SkyColor, sky_color
from ..render.video import VideoWriter
from ..render.view import RenderView
from ..scene.camera import Camera
from ..scene.progress import Progress
from ..scene.scene import RigCamera, Scene
from ..water.glass import CameraMotion
from .agents.base import SensorRequirements
from .geometry import PlanarBox, arc_lengths, points_along
from .ground import road_surface_of
from .metrics.collisions import LONGEST_S, gaps_m, times_to_collision_s
from .obstacles import occupied_space_of
from .playback import RolloutPlayback
from .rollout import CameraImage, RolloutStep
from .sensors import needed_cameras
from .vehicle import vehicle_box

Color = tuple[int, int, int]
RgbImage = UInt8[np.ndarray, "h w 3"]
_PAPER, _INK, _FAINT, _SOLID = (18, 20, 24), (232, 234, 238), (128, 134, 144), (92, 98, 108)
_EGO, _PLAN, _USER, _HIT = (86, 180, 233), (0, 214, 160), (230, 159, 0), (255, 70, 70)
"""Distinguishable with any color vision (Okabe and Ito 2008)."""

_BEHIND_M, _AHEAD_M, _ACROSS_M = 12.0, 68.0, 14.0
"""Extent of the top view: behind and ahead of the ego vehicle, and total width."""

_COLUMNS, _END = (0.015, 0.14, 0.36, 0.46, 0.57, 0.7, 0.86), 5
"""Horizontal positions of status values, shares of the width; from the sixth on replaced at the end by its reason."""

_LETTER, _SMALLEST_PX = 1 / 52, 11
"""Letter size of status values as a share of the width that holds them in one line, and the minimum in pixels."""

_ENDS = {"time": "time is up", "completed": "end of the route", "agent": "the agent gave up"}
_NEAR_M = 0.3
_DOT_M = 0.14
_SURE = 0.3  # minimum confidence of detections that are drawn


class RolloutCamera:
    """A camera of the ego vehicle in a played roll-out, in the scenario's rain. A picture is a function of its time."""

    def __init__(
        self, played: RolloutPlayback, renderer: Renderer, mounted: RigCamera, cut: LodCut | None = None,
        sky: SkyColor | None = None,
    ) -> None:  # fmt: skip
        """Use a camera of the rig, without its lens; `sky` is that of the other cameras of the rig, if it is known."""
        self._played, self._renderer, self._mounted, self._cut = played, renderer, mounted, cut
        self._rainfall = RainSimulation.start(played.scenario.rain)
        self._memory = CameraMemory()
        start = played.scene(0.0)
        self.sky = sky or sky_color(renderer, start, self.camera(0.0), thinning=cut)
        """Sky at the start."""
        first = self._frame(start, RenderView(self.camera(0.0), played.scene_time_s(0.0)))
        self.provenance = provenance_of(first)
        """Of the first picture."""
        meter(renderer, first)

    def camera(self, time_s: float) -> Camera:
        """Camera in the world at a time of the roll-out."""
        return self._mounted.camera(self._played.rig_to_world(time_s)).pinhole

    def frame(self, time_s: float) -> FrameInput:
        """Everything that the picture at a time holds."""
        played, state = self._played, self._played.state(time_s)
        velocity = state.speed_m_s * played.rig_to_world(time_s)[:3, 0]
        view = RenderView(self.camera(time_s), played.scene_time_s(time_s), velocity)
        return self._frame(played.scene(time_s), view)

    def request(self, time_s: float) -> PendingImage:
        """Draw the picture at a time, and start to read it back."""
        return draw(self._renderer, self.frame(time_s)).request_uint8()

    def _frame(self, scene: Scene, view: RenderView) -> FrameInput:
        mount = Mount(self._memory, past=self._motion, camera_to_vehicle=self._mounted.camera_to_ego[:3, :3])
        return FrameInput.of(scene, self._rainfall, self.sky, view, Quality(thinning=self._cut), mount=mount)

    def _motion(self, scene_time_s: float) -> CameraMotion:
        """Motion of the camera at a time of the scene; before the drive that of its start."""
        since_s = scene_time_s - self._played.scene_time_s(0.0)
        time_s = max(since_s, 0.0)
        rig = self._played.rig_to_world(time_s)
        camera, velocity_m_s = self.camera(time_s), self._played.state(time_s).speed_m_s * rig[:3, 0]
        place_m = camera.position + min(since_s, 0.0) * velocity_m_s
        return CameraMotion(camera.camera_to_world[:3, :3], velocity_m_s, place_m)


class RolloutVideo:
    """Video frames of a roll-out, all of one size. The same roll-out gives the same bytes."""

    def __init__(
        self, played: RolloutPlayback, renderer: Renderer, lod: Lod | None = None, mounted: RigCamera | None = None
    ) -> None:
        """Use a rig camera, by default the one that faces forward most, and the level of detail of an export.

        Raises ValueError if the scene has no rig.
        """
        if not played.rig.cameras:
            raise ValueError(f"scene {played.rollout.scene!r} has no rig whose front camera could film the drive")
        (front,) = needed_cameras(played.rig.cameras, SensorRequirements(cameras=("front",)))
        self._mounted = mounted or front
        self._played = played
        self._gaps_m, self._times_s = gaps_m(played.rollout), times_to_collision_s(played.rollout)
        self._path = np.array([(each.ego.x_m, each.ego.y_m) for each in played.rollout.steps])
        self._solid = occupied_space_of(played.base, road_surface_of(played.base)).places
        self._camera = RolloutCamera(played, renderer, self._mounted, lod_cut(played.base, lod))
        self.provenance = self._camera.provenance
        """Of the first camera image."""

    def times(self, fps: float) -> list[float]:
        """Return the times of the frames; the last one is held for a second."""
        times = np.arange(0.0, self._played.end_s, 1 / fps).tolist()
        return [*times, *[self._played.end_s] * (1 + round(fps))]

    def camera_images(self) -> Iterator[CameraImage]:
        """Images of the camera at each step, without plan and readouts; drawn while the one before is used."""
        waiting: tuple[RolloutStep, PendingImage] | None = None
        for step in self._played.rollout.steps:
            ahead = step, self._camera.request(step.time_s)
            if waiting is not None:
                yield self._camera_at(*waiting)
            waiting = ahead
        if waiting is not None:
            yield self._camera_at(*waiting)

    def _camera_at(self, step: RolloutStep, image: PendingImage) -> CameraImage:
        return CameraImage(step.step, self._mounted.name, image(), self._camera.camera(step.time_s))

    def pictures(self, times_s: Iterable[float]) -> Iterator[RgbImage]:
        """Frames at some times, each composed while the camera image of the next one is drawn."""
        waiting: tuple[float, PendingImage] | None = None
        for time_s in times_s:
            ahead = time_s, self._camera.request(time_s)
            if waiting is not None:
                yield self._composed(*waiting)
            waiting = ahead
        if waiting is not None:
            yield self._composed(*waiting)

    def picture(self, time_s: float) -> RgbImage:
        return self._composed(time_s, self._camera.request(time_s))

    def _composed(self, time_s: float, image: PendingImage) -> RgbImage:
        ahead = self._camera_panel(time_s, image())
        width = ahead.shape[1]
        whole = np.concatenate([ahead, self._readout_panel(time_s, width), self._above(time_s, width)])
        return np.ascontiguousarray(whole[: whole.shape[0] // 2 * 2])

    def _camera_panel(self, time_s: float, pixels: RgbImage) -> RgbImage:
        """Draw the plan and the agent's latest detections on the camera image."""
        step, state = self._played.step(time_s), self._played.state(time_s)
        camera = self._camera.camera(time_s)
        picture = draw_boxes(pixels, (), _noted(step), _SURE)
        if step.plan:
            points = self._played.state(step.time_s).to_world(np.array([(0.0, 0.0), *step.plan]))
            ahead = points[state.from_world(points)[:, 0] > 0]
            if len(ahead):
                _draw_plan(picture, camera, ahead, step.ego.z_m + 0.02)
        return picture

    def _readout_panel(self, time_s: float, width: int) -> RgbImage:
        played, step = self._played, self._played.step(time_s)
        state = played.state(time_s)
        at = step.step - played.rollout.steps[0].step
        gap, ttc = float(self._gaps_m[at]), float(self._times_s[at])
        words = [
            f"{played.scenario.rain.intensity_mm_h:g} mm/h",
            played.rollout.agent,
            f"{time_s:5.2f} s",
            f"{state.speed_m_s:4.1f} m/s",
            f"{round(step.ego.acceleration_m_s2, 1) + 0.0:+.1f} m/s\u00b2",
            f"gap {gap:.1f} m" if np.isfinite(gap) else "nobody ahead",
            f"TTC {ttc:.1f} s" if ttc < LONGEST_S else "",
        ]
        if time_s >= played.end_s - 1e-9:
            hit = played.rollout.steps[-1].collision
            words[_END:] = [_ENDS.get(played.rollout.end, played.rollout.end) if hit is None else f"collision: {hit}"]
        size = max(_SMALLEST_PX, round(width * _LETTER))
        slots = figure_slots(width)
        tall = round(2.1 * size)
        strip = Image.new("RGB", (width, tall * (1 + slots[-1].line)), _PAPER)
        draw = ImageDraw.Draw(strip)
        for number, (slot, word) in enumerate(zip(slots, words, strict=False)):
            is_last = number == len(words) - 1
            color = _HIT if number == _END and "collision" in word else _INK
            room = width - slot.left_px if is_last else slot.room_px
            fitting = _fitted(draw, word, room, _font(size))
            draw.text((round(slot.left_px), (slot.line + 0.5) * tall), fitting, color, _font(size), anchor="lm")
        return np.asarray(strip)

    def _above(self, time_s: float, width: int) -> RgbImage:
        """Draw the top view; the ego vehicle drives to the right."""
        played, state, step = self._played, self._played.state(time_s), self._played.step(time_s)
        plan = _TopView(width, (state.x_m, state.y_m, state.yaw_rad))
        plan.specks(self._solid)
        plan.dots(self._path, (70, 76, 86), 0.25)
        for user in played.users(time_s):
            plan.box(user.box, _HIT if user.id == step.collision and time_s >= step.time_s else _USER)
        plan.box(vehicle_box(played.scenario.vehicle, state), _EGO)
        if step.plan:
            plan.dots(played.state(step.time_s).to_world(np.array(step.plan)), _PLAN, 0.45)
        plan.scale_bar()
        return plan.picture


class ReadoutSlot(NamedTuple):
    """Position of a status value."""

    line: int
    left_px: float
    room_px: float


def figure_slots(width: int) -> list[ReadoutSlot]:
    """Return positions of status values for a frame width in pixels: one line, or more in a narrow frame."""
    whole = max(width, _SMALLEST_PX / _LETTER)
    slots: list[ReadoutSlot] = []
    line, first = 0, _COLUMNS[0]
    for left, right in pairwise((*_COLUMNS, 1.0)):
        if left > first and (right - first + _COLUMNS[0]) * whole > width:
            line, first = line + 1, left
        slots.append(ReadoutSlot(line, (left - first + _COLUMNS[0]) * whole, (right - left) * whole))
    return slots


def _fitted(draw: ImageDraw.ImageDraw, word: str, room_px: float, font: ImageFont.FreeTypeFont) -> str:
    """Shorten text that would overlap the next value."""
    if draw.textlength(word, font) <= room_px:
        return word
    while word and draw.textlength(f"{word}\u2026", font) > room_px:
        word = word[:-1]
    return f"{word}\u2026"


class _NotedDetection(msgspec.Struct):
    class_name: str = msgspec.field(name="class")
    confidence: float
    box_xyxy: tuple[float, float, float, float]


def _noted(step: RolloutStep) -> list[Detection]:
    """Return the detections in the agent's notes; empty if it records none."""
    try:
        noted = msgspec.convert(step.notes.get("detections", []), list[_NotedDetection])
    except msgspec.ValidationError:
        return []
    return [Detection(each.class_name, each.confidence, each.box_xyxy) for each in noted]


class _TopView:
    """Top-view drawing in the frame of the ego vehicle."""

    def __init__(self, width: int, pose: tuple[float, float, float]) -> None:
        self._scale = width / (_BEHIND_M + _AHEAD_M)
        height = round(_ACROSS_M * self._scale)
        self.picture: RgbImage = np.full((height, width, 3), _PAPER, np.uint8)
        x, y, yaw = pose
        self._origin = np.array([x, y])
        self._turn = np.array([[np.cos(yaw), np.sin(yaw)], [-np.sin(yaw), np.cos(yaw)]])

    def box(self, box: PlanarBox, color: Color) -> None:
        corners = self._pixels(box.corners)
        shade = tuple(round(0.45 * value) for value in color)
        cv2.fillPoly(self.picture, [corners], shade, cv2.LINE_AA, 4)
        cv2.polylines(self.picture, [corners], True, color, 1, cv2.LINE_AA, 4)

    def specks(self, points: Float64[np.ndarray, "n 2"]) -> None:
        """Draw single pixels."""
        x, y = (self._pixels(points) // 16).T
        height, width = self.picture.shape[:2]
        inside = (x >= 0) & (x < width) & (y >= 0) & (y < height)
        self.picture[y[inside], x[inside]] = _SOLID

    def dots(self, points: Float64[np.ndarray, "n 2"], color: Color, radius_m: float) -> None:
        radius = max(16, round(radius_m * self._scale * 16))
        for x, y in self._pixels(points):
            cv2.circle(self.picture, (int(x), int(y)), radius, color, cv2.FILLED, cv2.LINE_AA, 4)

    def scale_bar(self) -> None:
        """Draw a bar of ten meters in the lower right corner."""
        height, width = self.picture.shape[:2]
        right, y, size = width - 12, height - 12, max(9, round(width / 80))
        cv2.line(self.picture, (right - round(10 * self._scale), y), (right, y), _FAINT, 1)
        image = Image.fromarray(self.picture)
        ImageDraw.Draw(image).text((right, y - 3), "10 m", _FAINT, _font(size), anchor="rb")
        self.picture = np.array(image)

    def _pixels(self, points: Float64[np.ndarray, "n 2"]) -> np.ndarray:
        local = (points - self._origin) @ self._turn.T
        across = self.picture.shape[0] / 2 - local[:, 1] * self._scale
        return np.round(16 * np.stack([(local[:, 0] + _BEHIND_M) * self._scale, across], axis=1)).astype(np.int32)


def _draw_plan(picture: RgbImage, camera: Camera, points: Float64[np.ndarray, "n 2"], height_m: float) -> None:
    """Draw planned points as a line with dots, in perspective on the road."""
    # Resampled to half a meter, so that a line from behind the camera is clipped near it.
    along = arc_lengths(points)
    line = points_along(points, along, np.append(np.arange(0.0, along[-1], 0.5), along[-1]))
    pixels, depth = _projected(camera, line, height_m)
    visible = [_fixed(pixel) for pixel, far in zip(pixels, depth, strict=True) if far > _NEAR_M]
    for width, color in ((5, (0, 40, 30)), (3, _PLAN)):
        cv2.polylines(picture, [np.array(visible, np.int32).reshape(-1, 2)], False, color, width, cv2.LINE_AA, 4)
    pixels, depth = _projected(camera, points, height_m)
    for pixel, far in zip(pixels, depth, strict=True):
        if far > _NEAR_M:
            radius = float(np.clip(_DOT_M * camera.fx / far, 2.5, 9))
            cv2.circle(picture, _fixed(pixel), round(16 * radius), _PLAN, cv2.FILLED, cv2.LINE_AA, 4)


def _projected(
    camera: Camera, points: Float64[np.ndarray, "n 2"], height_m: float
) -> tuple[Float64[np.ndarray, "n 2"], Float64[np.ndarray, " n"]]:
    """Return pixels of points on the ground, and their depth in meters."""
    places = np.column_stack([points, np.full(len(points), height_m)])
    local = places @ camera.world_to_camera[:3, :3].T + camera.world_to_camera[:3, 3]
    depth = local[:, 2]
    safe = np.maximum(depth, _NEAR_M)[:, None]
    return local[:, :2] / safe * (camera.fx, camera.fy) + (camera.cx, camera.cy), depth


def _fixed(pixel: Float64[np.ndarray, "2"]) -> tuple[int, int]:
    """Return OpenCV's fixed-point coordinates (sixteenths of a pixel), clipped to its range."""
    x, y = np.clip(np.round(16 * (pixel - 0.5)), -(2**20), 2**20)
    return int(x), int(y)


def _font(size: int) -> ImageFont.FreeTypeFont:
    import matplotlib as mpl  # provides the font; imported here because the window loads this module at startup

    return ImageFont.truetype(Path(mpl.get_data_path()) / "fonts" / "ttf" / "DejaVuSans.ttf", size)


_PREVIEW_PX = 320


def render_rollout_video(path: Path, video: RolloutVideo, fps: float) -> Iterator[Progress]:
    """Write a video with `fps` frames per second; yields progress after each frame.

    If the caller stops early, the written part is playable. Raises ValueError for an unknown video suffix, and OSError
    if the file can't be written.
    """
    times = video.times(fps)
    pictures = video.pictures(times)
    first = next(pictures)
    every = max(first.shape[1] // _PREVIEW_PX, 1)
    with VideoWriter(path, first.shape[1], first.shape[0], fps) as writer:
        for number, picture in enumerate(chain([first], pictures), start=1):
            writer.write(picture)
            yield Progress(number / len(times), f"Frame {number} of {len(times)}", picture[::every, ::every].copy())
