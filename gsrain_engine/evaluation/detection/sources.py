"""Views of an evaluation of detectors: chosen cameras and moments of a scene, or images of a capture."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float64

from ...appearance.capture_photos import CapturePhotos
from ...appearance.scene_views import PlacedCamera, chosen_cameras, chosen_views, evenly_spaced_indices
from ...appearance.view_choice import ViewChoice
from ...datasets.capture import Capture, CaptureFrame
from ...datasets.undistort import undistort_frame
from ...rain.settings import RainSettings
from ...rain.simulation import OVERCAST
from ...render.renderer import Renderer
from ...render.sequence import find_rig_cameras
from ...render.sky_color import SkyColor, sky_color
from ...scene.scene import Scene
from .run import ConditionRenderer, EvaluatedFrame, Labels, recorded_frames, scene_frames
from .settings import DetectionSettings

_SLOW_FPS = 2.0  # frame rate of videos of frames far apart in time


@dataclass(frozen=True, slots=True, eq=False)
class DetectionSource:
    """Source of an evaluation: a scene or a capture, and what belongs to it."""

    views: Scene | Capture
    capture: Capture | None = None
    """Recording of a scene, whose images are evaluated, too."""
    labels: Labels | None = None
    """Ground truth of a recording's images; None takes its 3D boxes."""
    name: str | None = None
    """Name of a scene that is built in, of which some have a twin without water."""
    inputs: Mapping[str, str] = field(default_factory=dict[str, str])
    """Hashes of what was read, by name, for the report and for finished results that are kept."""

    @property
    def is_scene(self) -> bool:
        return isinstance(self.views, Scene)

    def with_scene(self, scene: Scene) -> "DetectionSource":
        """The same source with another scene, such as one that has got wet colors."""
        made = {} if scene is self.views else {"wet colors": "computed"}
        return replace(self, views=scene, inputs={**self.inputs, **made})


@dataclass(frozen=True, slots=True, eq=False)
class EvaluatedViews:
    """Views with their ground truth, and the renderer of their images."""

    name: str
    pictures: ConditionRenderer
    frames: list[EvaluatedFrame]
    frame_rate: float
    """Frame rate of a video of the views."""


def place_views(
    renderer: Renderer, source: DetectionSource, settings: DetectionSettings, rain: RainSettings
) -> EvaluatedViews:
    """Place the chosen views in a scene, or among the photographs of a capture.

    Raises ValueError, which begins with the name of a setting, for settings that contradict each other, and for a
    source without anything to find.
    """
    if isinstance(source.views, Capture):
        return _of_capture(renderer, source.views, source, settings, rain)
    scene, width_px = source.views, settings.cameras.width_px
    if source.capture is not None:
        capture = _chosen(source.capture, settings)
        placed = chosen_cameras(scene, ViewChoice(source="recorded", width_px=width_px), capture)
        frames = recorded_frames(scene, placed, capture, source.labels)
    elif source.labels is not None:
        raise ValueError("truth: needs a capture, whose pictures it is about")
    else:
        placed = _placed(scene, settings)
        frames = scene_frames(renderer, scene, placed)
    sky = sky_color(renderer, scene, placed[0].camera, placed[0].time_s)
    return EvaluatedViews(scene.name, ConditionRenderer(renderer, scene, rain, sky), frames, _frame_rate(placed))


def _of_capture(
    renderer: Renderer, capture: Capture, source: DetectionSource, settings: DetectionSettings, rain: RainSettings
) -> EvaluatedViews:
    if source.capture is not None:
        raise ValueError(f"capture: {capture.name} is a capture itself")
    if not capture.is_metric and capture.has_poses:
        raise ValueError(
            f"{capture.name}: its unit of length is unknown, and rain falls in meters; take the folder of its pictures "
            "alone, or a reconstruction that was scaled to meters with --capture"
        )
    capture = _chosen(capture, settings)
    photos = CapturePhotos(capture)
    placed = [_of_view(undistort_frame(view), photos, settings.cameras.width_px) for view in capture]
    frames = recorded_frames(photos.world, placed, capture, source.labels)
    pictures = ConditionRenderer(renderer, photos.world, rain, SkyColor(OVERCAST, False), photos)
    return EvaluatedViews(capture.name, pictures, frames, _frame_rate(placed))


def _of_view(view: CaptureFrame, photos: CapturePhotos, width_px: int | None) -> PlacedCamera:
    """Return the world camera of a captured view without distortion; without poses, a level one over the road."""
    camera = photos.view(view).camera
    return PlacedCamera(view.name, camera, view.time_s, view.sensor).at_width(width_px)


def _chosen(capture: Capture, settings: DetectionSettings) -> Capture:
    """Return the chosen views of each camera, evenly spaced between two times."""
    sensors = () if settings.cameras.sensors == ("all",) else settings.cameras.sensors
    low = -np.inf if settings.first_s is None else settings.first_s
    high = np.inf if settings.last_s is None else settings.last_s
    within = [view for view in chosen_views(capture, ViewChoice(sensors=sensors)) if low <= view.time_s <= high]
    if not within:
        raise ValueError(f"first_s: {capture.name} has no picture between the first and the last moment")
    views: list[CaptureFrame] = []
    for sensor in dict.fromkeys(view.sensor for view in within):
        own = [view for view in within if view.sensor == sensor]
        views += [own[i] for i in evenly_spaced_indices(len(own), settings.frames)]
    return replace(capture, views=tuple(views))


def _placed(scene: Scene, settings: DetectionSettings) -> list[PlacedCamera]:
    """Return every chosen rig camera at every time; in a scene without a rig, cameras along its path or around it."""
    if not scene.rigs or scene.ego is None or not len(scene.ego.times):
        if settings.cameras.sensors:
            raise ValueError(f"sensors: scene {scene.name!r} has no vehicle with cameras")
        return chosen_cameras(scene, ViewChoice(count=settings.frames, width_px=settings.cameras.width_px))
    mounted = find_rig_cameras(scene, settings.cameras.sensors or (_front(scene),))
    placed: list[PlacedCamera] = []
    for time_s in _moments(scene.ego.times, settings):
        for each in mounted:
            camera = PlacedCamera(f"{each.name}_{time_s:07.3f}s", each.at(time_s), time_s, f"{each.rig}/{each.name}")
            placed.append(camera.at_width(settings.cameras.width_px))
    return placed


def _moments(times: Float64[np.ndarray, " t"], settings: DetectionSettings) -> list[float]:
    """Return times from first to last if both are set, else the middle of each equal share of the drive."""
    low = float(times[0]) if settings.first_s is None else settings.first_s
    high = float(times[-1]) if settings.last_s is None else settings.last_s
    if settings.first_s is not None and settings.last_s is None and settings.frames == 1:
        return [low]
    if settings.first_s is not None and settings.last_s is not None and settings.frames > 1:
        return np.linspace(low, high, settings.frames).tolist()
    return (low + (high - low) * (np.arange(settings.frames) + 0.5) / settings.frames).tolist()


def _front(scene: Scene) -> str:
    """Return the camera of the first rig that looks most straight ahead."""
    rig, cameras = next((rig, cameras) for rig, cameras in scene.rigs.items() if cameras)
    return f"{rig}/{max(cameras, key=lambda each: each.camera_to_ego[0, 2]).name}"


def _frame_rate(placed: Sequence[PlacedCamera]) -> float:
    """Return the frame rate of the times if they are dense enough for a video."""
    times = sorted({each.time_s for each in placed})
    step = float(np.median(np.diff(times))) if len(times) > 1 else np.inf
    return float(np.clip(1 / step, _SLOW_FPS, 60.0)) if step > 0 else _SLOW_FPS
