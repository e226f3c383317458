"""What `gsrain evaluate detection` looks at: views of a scene, of a scene and its capture, or of a capture alone."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import msgspec
import numpy as np
from jaxtyping import Float64

from gsrain_engine.appearance.views.choice import ViewChoice, chosen_cameras, chosen_views, evenly
from gsrain_engine.appearance.views.placed_camera import PlacedCamera
from gsrain_engine.datasets.capture import Capture, View
from gsrain_engine.datasets.open_capture import open_capture
from gsrain_engine.datasets.prepared import prepared
from gsrain_engine.evaluate.comparison.stamp import stamp
from gsrain_engine.evaluate.detection.coco_file import read_coco
from gsrain_engine.evaluate.detection.detector import Detector
from gsrain_engine.evaluate.detection.frames import JudgedFrame, recorded_frames, scene_frames
from gsrain_engine.evaluate.detection.pictures import Pictures, Trial, trials_of
from gsrain_engine.evaluate.detection.sweep import JudgedPicture, Memory, judged_pictures
from gsrain_engine.rain.presets import load_preset
from gsrain_engine.rain.rain import Rain
from gsrain_engine.rain.rainfall import OVERCAST
from gsrain_engine.render.mounted_camera import mounted_cameras
from gsrain_engine.render.renderer import Renderer
from gsrain_engine.render.sky_color import Sky, sky_color
from gsrain_engine.scene.camera import Camera
from gsrain_engine.scene.content_hash import file_hash, scene_hash
from gsrain_engine.scene.open_scene import open_to_draw
from gsrain_engine.scene.scene import Scene

from ..converted_options import RAIN_OPTIONS, converted_options
from ..progress import followed
from ..sources import names_scene

_SLOW_FPS = 2.0
"""Of videos whose frames lie far apart."""
_LEVEL = np.array([[0.0, -1, 0, 0], [0, 0, -1, 1.5], [1, 0, 0, 0], [0, 0, 0, 1]])
"""World to camera of one that looks ahead over a road, for pictures of which nobody knows where they were taken."""


@dataclass(frozen=True, slots=True)
class DetectionSource:
    """What was asked for."""

    source: str | None
    capture: Path | None
    truth: Path | None
    frames: int
    first_s: float | None
    last_s: float | None
    cameras: tuple[str, ...]
    width_px: int
    is_wet: bool


@dataclass(frozen=True, slots=True, eq=False)
class PreparedSource:
    """Views with what is to be found in them, and what makes their pictures."""

    name: str
    pictures: Pictures
    frames: list[JudgedFrame]
    frame_rate: float
    """Of a video of them."""
    inputs: dict[str, str]
    """What the pictures follow from, by name: hashes of files, of a capture one of names, sizes and times."""

    def trials(self, intensities_mm_h: tuple[float, ...], seeds: tuple[int, ...]) -> list[Trial]:
        """All that each view is shown in."""
        originals = all(frame.original is not None for frame in self.frames)
        return trials_of(intensities_mm_h, seeds, originals=originals, scene=not self.pictures.is_in_front)

    def judged(
        self, detectors: Sequence[Detector], trials: Sequence[Trial], memory: Memory | None = None
    ) -> Iterator[JudgedPicture]:
        """Show each view in each trial to each detector, except what the memory knows."""
        return judged_pictures(self.pictures, detectors, self.frames, trials, memory)


def base_rain(preset: str | None, exposure_s: float | None) -> Rain:
    """Everything about the rain but its intensity and its seed."""
    rain = load_preset(preset) if preset is not None else Rain()
    values = msgspec.to_builtins(rain) | ({} if exposure_s is None else {"exposure_s": exposure_s})
    return converted_options(values, Rain, RAIN_OPTIONS)


def opened_source(renderer: Renderer, asked: DetectionSource, rain: Rain) -> PreparedSource:
    """Open what was named. Raises ValueError, which names the option, where something does not fit."""
    if asked.source is None or names_scene(asked.source):
        return _of_scene(renderer, asked, rain)
    if asked.capture is not None:
        raise ValueError(f"--capture: {asked.source} is a capture itself")
    if asked.is_wet:
        raise ValueError(f"--wet: {asked.source} is a capture; gsrain reconstruct makes a scene of it")
    return _of_capture(renderer, asked, rain)


def _of_scene(renderer: Renderer, asked: DetectionSource, rain: Rain) -> PreparedSource:
    scene = open_to_draw(asked.source)
    if asked.is_wet:
        from gsrain_engine.reconstruct.wet_scene import wet_scene  # kernels take a second to load

        scene = followed(wet_scene(scene))
    if asked.capture is not None:
        capture = _chosen(open_capture(asked.capture), asked)
        placed = chosen_cameras(scene, ViewChoice(source="recorded", width_px=asked.width_px), capture)
        labels = None if asked.truth is None else read_coco(asked.truth)
        frames = recorded_frames(scene, placed, capture, labels)
    else:
        if asked.truth is not None:
            raise ValueError("--truth: needs --capture, whose pictures the file is about")
        placed = _placed(scene, asked)
        frames = scene_frames(renderer, scene, placed)
    sky = sky_color(renderer, scene, placed[0].camera, placed[0].time_s)
    inputs = {"scene": scene_hash(asked.source)} | _hashes(asked)
    return PreparedSource(scene.name, Pictures(renderer, scene, rain, sky), frames, _frame_rate(placed), inputs)


def _of_capture(renderer: Renderer, asked: DetectionSource, rain: Rain) -> PreparedSource:
    capture = _chosen(open_capture(str(asked.source)), asked)
    if not capture.is_metric and capture.has_poses:
        raise ValueError(
            f"{capture.name}: its unit of length is unknown, and rain falls in metres; take the folder of its pictures "
            "alone, or a reconstruction that was scaled to metres with --capture"
        )
    world = Scene(capture.name, up=capture.up, ego=capture.ego)
    placed = [_of_view(prepared(view), world, capture, asked.width_px) for view in capture]
    labels = None if asked.truth is None else read_coco(asked.truth)
    frames = recorded_frames(world, placed, capture, labels)
    pictures = Pictures(renderer, world, rain, Sky(OVERCAST, False), is_in_front=True)
    inputs = {"capture": stamp(Path(str(asked.source)))} | _hashes(asked)
    return PreparedSource(capture.name, pictures, frames, _frame_rate(placed), inputs)


def _hashes(asked: DetectionSource) -> dict[str, str]:
    """Of what was named beside the source."""
    found = {} if asked.capture is None else {"capture": stamp(asked.capture)}
    return found if asked.truth is None else found | {"truth": file_hash(asked.truth)}


def _of_view(view: View, world: Scene, capture: Capture, width_px: int) -> PlacedCamera:
    """Camera of a taken picture in the world; of one that nobody placed, level over the road."""
    camera = view.camera.moved(world.scene_to_world) if capture.has_poses else _level(view.camera)
    return PlacedCamera(view.name, camera, view.time_s, view.sensor).at_width(width_px)


def _level(camera: Camera) -> Camera:
    return replace(camera, world_to_camera=_LEVEL)


def _chosen(capture: Capture, asked: DetectionSource) -> Capture:
    """The views to try: of each of the chosen cameras as many as were asked for, evenly between two moments."""
    sensors = () if asked.cameras == ("all",) else asked.cameras
    there = chosen_views(capture, ViewChoice(sensors=sensors))
    low, high = asked.first_s, asked.last_s
    within = [view for view in there if (low is None or view.time_s >= low) and (high is None or view.time_s <= high)]
    if not within:
        raise ValueError(f"--from --to: {capture.name} has no picture between these moments")
    views: list[View] = []
    for sensor in dict.fromkeys(view.sensor for view in within):
        own = [view for view in within if view.sensor == sensor]
        views += [own[i] for i in evenly(len(own), asked.frames)]
    return replace(capture, views=tuple(views))


def _placed(scene: Scene, asked: DetectionSource) -> list[PlacedCamera]:
    """Every chosen rig camera at every moment; in a scene without a rig, along its path or around it."""
    if not scene.rigs or scene.ego is None or not len(scene.ego.times):
        if asked.cameras:
            raise ValueError(f"--cameras: scene {scene.name!r} has no vehicle with cameras")
        return chosen_cameras(scene, ViewChoice(count=asked.frames, width_px=asked.width_px))
    mounted = mounted_cameras(scene, asked.cameras or (_front(scene),))
    placed: list[PlacedCamera] = []
    for time_s in _moments(scene.ego.times, asked):
        for each in mounted:
            camera = PlacedCamera(f"{each.name}_{time_s:07.3f}s", each.at(time_s), time_s, f"{each.rig}/{each.name}")
            placed.append(camera.at_width(asked.width_px))
    return placed


def _moments(times: Float64[np.ndarray, " t"], asked: DetectionSource) -> list[float]:
    """With two ends given, from the one to the other; else each in the middle of its share of the drive."""
    low = float(times[0]) if asked.first_s is None else asked.first_s
    high = float(times[-1]) if asked.last_s is None else asked.last_s
    if asked.first_s is not None and asked.last_s is None and asked.frames == 1:
        return [low]
    if asked.first_s is not None and asked.last_s is not None and asked.frames > 1:
        return np.linspace(low, high, asked.frames).tolist()
    return (low + (high - low) * (np.arange(asked.frames) + 0.5) / asked.frames).tolist()


def _front(scene: Scene) -> str:
    """The camera of the first rig that looks most straight ahead."""
    rig, cameras = next((rig, cameras) for rig, cameras in scene.rigs.items() if cameras)
    return f"{rig}/{max(cameras, key=lambda each: each.camera_to_ego[0, 2]).name}"


def _frame_rate(placed: Sequence[PlacedCamera]) -> float:
    """That of the moments where they lie close enough together to be a film."""
    times = sorted({each.time_s for each in placed})
    step = float(np.median(np.diff(times))) if len(times) > 1 else np.inf
    return float(np.clip(1 / step, _SLOW_FPS, 60.0)) if step > 0 else _SLOW_FPS
