"""Jobs of the command line as functions: copies, evaluations, looks, reconstruction, pages, sweeps.

Each runs what the command of the same name runs, and returns a value with a `table`, a `figure` and `save`.
"""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, cast

import msgspec

from gsrain_engine.appearance.base import TransferSettings
from gsrain_engine.appearance.view_choice import ViewChoice
from gsrain_engine.backends import open_renderer
from gsrain_engine.choices import Backend
from gsrain_engine.dataset_export.open import dataset_source, input_hashes, open_dataset_input
from gsrain_engine.dataset_export.registry import LAYOUTS
from gsrain_engine.dataset_export.session import export_dataset
from gsrain_engine.dataset_export.source import DatasetChoice
from gsrain_engine.datasets.capture import Capture
from gsrain_engine.datasets.image_override import with_images
from gsrain_engine.datasets.open_capture import open_capture
from gsrain_engine.datasets.open_source import names_scene, open_source, source_hash
from gsrain_engine.editor.viewport.camera import default_path, home_camera
from gsrain_engine.evaluation.detection.detector import FunctionDetector, open_detector
from gsrain_engine.evaluation.detection.ground_truth import read_coco
from gsrain_engine.evaluation.detection.report import DetectionReport as DetectionReport
from gsrain_engine.evaluation.detection.report import RainShares as RainShares
from gsrain_engine.evaluation.detection.run import AnyDetector, DetectorProtocol, MatchingDetector
from gsrain_engine.evaluation.detection.session import evaluate_detection as detection_session
from gsrain_engine.evaluation.detection.settings import DetectionSettings
from gsrain_engine.evaluation.detection.sources import DetectionSource
from gsrain_engine.evaluation.lidar.sensor import LidarSensor
from gsrain_engine.evaluation.lidar.session import LidarReport as LidarReport
from gsrain_engine.evaluation.lidar.session import evaluate_lidar as lidar_session
from gsrain_engine.evaluation.lidar.session import open_sensor
from gsrain_engine.evaluation.lidar.settings import LidarSettings
from gsrain_engine.optional_packages import require_package
from gsrain_engine.publish.page import opening_view, publish_page
from gsrain_engine.publish.rain_gaussians import export_rain_gaussians
from gsrain_engine.rain.available import Source, check_available
from gsrain_engine.rain.settings import RainSettings as RainSettings
from gsrain_engine.rain.simulation import RainSimulation
from gsrain_engine.recordings.folders import FileCopies
from gsrain_engine.recordings.rainy_recording import open_recording
from gsrain_engine.recordings.session import check_copy, export_recording
from gsrain_engine.render.export import export_sequences
from gsrain_engine.render.export_settings import DEFAULT_SIZE_PX, ExportSettings
from gsrain_engine.report.result import RunResult as RunResult
from gsrain_engine.report.table import Table as Table
from gsrain_engine.scene.camera import Camera
from gsrain_engine.scene.camera_path import CameraPath
from gsrain_engine.scene.open import load_sorted_scene
from gsrain_engine.scene.progress import Progress, run_to_end
from gsrain_engine.scene.scene import Scene
from gsrain_engine.simulation.scenario import Scenario
from gsrain_engine.sweep.executors import LocalPool, SerialExecutor
from gsrain_engine.sweep.report import SweepReport as SweepReport
from gsrain_engine.sweep.run import run_sweep_and_report
from gsrain_engine.sweep.settings import load_sweep

from .arguments import checked, checked_settings

Report = Callable[[Progress], object]
SourceName = Scene | Capture | Path | str


def _opened(source: SourceName) -> Scene | Capture:
    return open_source(source) if isinstance(source, Path | str) else source


def _inputs(source: SourceName) -> dict[str, str]:
    """Return the hash of a source that is named; a value has none."""
    return {str(source): source_hash(source)} if isinstance(source, Path | str) else {}


def _checked_rain(rain: RainSettings | None, kind: Source) -> RainSettings:
    """Return the rain. Raises `ValueError` for a part of it that such a source can't have."""
    found = rain or RainSettings()
    default = msgspec.structs.asdict(RainSettings())
    changes = {name: value for name, value in msgspec.structs.asdict(found).items() if value != default[name]}
    check_available(changes, found, kind, {name: name for name in default})
    return found


# Rain for other programs


@checked
def export_rain(
    source: Scene | Path | str,
    output: Path | str,
    rain: RainSettings,
    *,
    camera: Camera | CameraPath | None = None,
    time: float = 0.0,
    size: tuple[int, int] = DEFAULT_SIZE_PX,
    with_scene: bool = False,
    scene: Scene | None = None,
    sensor: str = "64",
    hard_links: bool = False,
    progress: Report | None = None,
) -> RunResult[Path]:
    """Write a rainy copy of a recording, or the Gaussians of the rain in a scene; `made` is its path.

    Args:
        source: A recording (nuScenes, KITTI, Waymo, MCAP, ROS 2 bag, folder of images) by its path: its copy in the
            same format has images and lidar in rain, and copies of all other files. Or a scene.
        output: New folder of the copy, or file where the recording is one; of a scene a file such as .ply.
        rain: The rain.
        camera: Scene: camera or path that the Gaussians are made for; None is its home camera.
        time: Scene: moment in seconds.
        size: Scene: width and height in pixels of the picture that the streaks are made for.
        with_scene: Scene: whether to write its Gaussians, too, in the same file.
        scene: Recording: a scene made of it, of which the images are then rendered, wet where it has wet colors.
        sensor: Recording: its lidar, a name that `gsrain evaluate lidar --help` lists or a YAML file.
        hard_links: Recording: whether unchanged files are stored once, so that editing one edits both.
        progress: Called with each step: `fraction` (0..1) and `message`.

    Raises:
        ValueError: For a part of the rain that such a source can't have, and for an output that is there already.
        OSError: When the output can't be written.
    """
    target = Path(output)
    if isinstance(source, Scene) or names_scene(source):
        place = source if isinstance(source, Scene) else open_source(source)
        assert isinstance(place, Scene)
        shot = _checked_rain(rain, "Gaussians with scene" if with_scene else "Gaussians")
        still = ExportSettings(output="rain.png", first_s=time, size_px=size)
        viewpoint = camera or home_camera(place, *size)
        return export_rain_gaussians(place, shot, viewpoint, target, still, with_scene=with_scene)
    recording = open_recording(Path(source))
    check_copy(recording, Path(source), target)
    checked_rain = _checked_rain(rain, "photographs" if scene is None else "scene")
    with open_renderer("cpu") as renderer:
        work = export_recording(
            renderer, recording, target, checked_rain, scene=scene, sensor=open_sensor(sensor),
            files=FileCopies(hard_links),
        )  # fmt: skip
        return run_to_end(work, progress)


@checked
def dataset(
    source: SourceName | Scenario,
    output: Path | str,
    *,
    layout: str = "nuscenes",
    intensities: tuple[float, ...] = (0.0, 2.5, 8.5, 25.0),
    rain: RainSettings | None = None,
    cameras: tuple[str, ...] = (),
    rate: float | None = None,
    moments: int | None = None,
    width: int | None = None,
    sensor: str | None = "64",
    backend: Backend = "auto",
    progress: Report | None = None,
) -> RunResult[Path]:
    """Write a labeled data set in several rains, in a folder; the same call resumes. `made` is its path.

    Args:
        source: A scene, a recording or a scenario, by value or by name.
        output: Folder to write, or to go on with.
        layout: "nuscenes", "kitti" or "coco".
        intensities: Rainfall intensities in mm/h, each in a folder of its own; more may be added later.
        rain: All of the rain but for its intensity; None is the default, of a scenario its own.
        cameras: Names of cameras, of a scene also of rigs; none are those of the first rig, of a recording all.
        rate: Moments per second; None is 2, of a recording all.
        moments: Maximum number of moments, from the first.
        width: Width of the pictures in pixels; None is the cameras' own.
        sensor: Lidar on the roof, or of the recording: a name that `gsrain dataset --help` lists or a YAML file; None
            leaves it out.
        backend: As in `render`; photographs are drawn by the processor.
        progress: As in `export_rain`.

    Raises:
        ValueError: For an unknown layout, camera or sensor, a folder with anything else, and what a layout can't hold.
        CaptureError: For an image that can't be read.
        OSError: When a file can't be written.
    """
    if layout not in LAYOUTS:
        raise ValueError(f"layout {layout!r}: expected {', '.join(LAYOUTS)}")
    opened = open_dataset_input(str(source)) if isinstance(source, Path | str) else source
    scene = load_sorted_scene(opened.scene) if isinstance(opened, Scenario) else opened
    own = rain or (opened.rain if isinstance(opened, Scenario) else RainSettings())
    kind: Source = "photographs" if isinstance(scene, Capture) else "scene"
    base = _checked_rain(own, kind)
    plain, names = msgspec.to_builtins(base), {"intensities": "intensity_mm_h"}
    rains = [checked_settings({**plain, "intensity_mm_h": x}, RainSettings, names) for x in sorted({*intensities})]
    lidar = None if sensor is None else open_sensor(sensor)
    choice = DatasetChoice(cameras=cameras, rate_hz=rate, moments=moments, width_px=width, sensor=lidar)
    facts = {"inputs": input_hashes(str(source), opened) if isinstance(source, Path | str) else {}, "wet": None}
    with open_renderer("cpu" if isinstance(scene, Capture) else backend) as renderer:
        made_of = dataset_source(opened, choice, scene if isinstance(scene, Scene) else None, facts)
        return run_to_end(export_dataset(renderer, made_of, Path(output), rains, LAYOUTS[layout]), progress)


@checked
def publish(
    scene: Scene,
    output: Path | str,
    rain: RainSettings | None = None,
    path: CameraPath | Camera | None = None,
    *,
    start: float = 0.0,
    seconds: float | None = None,
    view: str | None = None,
    progress: Report | None = None,
) -> RunResult[Path]:
    """Write one web page with a scene, a path and its rain under a slider of intensities; `made` is its path.

    Args:
        scene: The scene; wet where it has wet colors.
        output: A name that ends in .html.
        rain: The rain that the page begins with; None is none.
        path: Camera path, or a camera, in the world; None is the path that the scene is shown along.
        start: Moment of scene and rain at the start of the path in seconds.
        seconds: Length of the path; None is all of it.
        view: Named view of the scene at which the page opens; None is the first one, or the path where one is given.
        progress: As in `export_rain`.

    Raises:
        ValueError: For a name of another kind, for a rain that a page can't draw, and for a view that there is not.
        OSError: When the page can't be written.
    """
    target = Path(output)
    if target.suffix.lower() not in (".html", ".htm"):
        raise ValueError(f"output {target}: expected the name of a web page (.html)")
    settings, film = _checked_rain(rain, "page"), ExportSettings(output="page.mp4", first_s=start)
    opening = opening_view(scene, view, has_path=path is not None)
    viewpoint = path or default_path(scene, *DEFAULT_SIZE_PX)
    is_own = path is None and scene.path is not None
    sequence = export_sequences(film, scene, RainSimulation.start(settings), viewpoint, in_scene_time=is_own)[""]
    with open_renderer("cpu") as renderer:
        return run_to_end(publish_page(renderer, scene, settings, sequence, "Path", target, seconds, opening), progress)


# Evaluations


@checked
def evaluate_detection(
    source: SourceName,
    detectors: Any,
    rain: RainSettings | None = None,
    *,
    intensities: tuple[float, ...] = (0.0, 1.2, 8.5, 12.0),
    seeds: int = 5,
    frames: int = 4,
    start: float | None = None,
    end: float | None = None,
    cameras: tuple[str, ...] = (),
    width: int = 960,
    attribute: tuple[str, ...] = (),
    diameter_scales: tuple[float, ...] = (),
    capture: Capture | None = None,
    truth: Path | str | None = None,
    folder: Path | str | None = None,
    video: Path | str | None = None,
    backend: Backend = "auto",
    progress: Report | None = None,
) -> DetectionReport:
    """Measure what rain does to object detectors: confidence, boxes, classes and average precision by intensity.

    Args:
        source: A scene, whose actors are to be found, or a capture, whose 3D boxes are; by value or by name.
        detectors: One or several: an ONNX file; a function of an image (H, W, 3; uint8, RGB) that returns boxes (n, 4;
            left, top, right, bottom in pixels), class names and scores (0..1); or an object with `name` and
            `confidences(image, frame)`, which matches what it finds by itself, as boxes in space, and returns the
            confidence of each object of the view by its id.
        rain: All of the rain but for its intensity and seed; None is the default.
        intensities: Rainfall intensities in mm/h; 0 is always included.
        seeds: Number of rains of each intensity.
        frames: Number of moments of the drive; of a capture, images of each camera.
        start: First moment in seconds of scene time.
        end: Last moment.
        cameras: Names of cameras; none are the one ahead, of a capture all.
        width: Width of the images in pixels.
        attribute: Parts of the rain whose share in its effect is computed, such as ("streaks", "medium"), or ("all",).
        diameter_scales: Factors of all drop diameters, which are compared at equal mm/h.
        capture: Recording of a scene, whose images are evaluated, too.
        truth: COCO file with the ground truth of a capture's images.
        folder: Folder in which results of detectors of files are kept: the same call resumes after a stop.
        video: .mp4 or .webm to write: the views in each rain with the detections.
        backend: As in `render`.
        progress: As in `export_rain`.

    Returns:
        Rows, scores and their `tables`; `report.save("folder")` writes what the command writes.

    Raises:
        ValueError: For a source without anything to find, and for settings that it can't honor.
    """
    values = {
        "intensities_mm_h": intensities, "seeds": seeds, "frames": frames, "first_s": start, "last_s": end,
        "attribute": attribute, "diameter_scales": diameter_scales,
        "cameras": {"sensors": cameras, "width_px": width},
    }  # fmt: skip
    settings = checked_settings(values, DetectionSettings, _DETECTION_FIELDS)
    labels = None if truth is None else read_coco(Path(truth))
    name = source if isinstance(source, str) else None
    opened = DetectionSource(_opened(source), capture, labels, name, _inputs(source))
    found = _checked_rain(rain, "scene" if opened.is_scene else "photographs")
    chosen = detectors if isinstance(detectors, list | tuple) else [detectors]
    kept, film = (None if each is None else Path(each) for each in (folder, video))
    with open_renderer(backend) as renderer:
        each = [_detector(detector, number) for number, detector in enumerate(chosen)]
        return run_to_end(detection_session(renderer, opened, each, found, settings, folder=kept, video=film), progress)


_DETECTION_FIELDS = {
    "intensities": "intensities_mm_h", "start": "first_s", "end": "last_s", "cameras": "sensors", "width": "width_px",
}  # fmt: skip
"""Fields of settings by argument, if their names differ."""


def _detector(detector: Any, number: int) -> AnyDetector:
    if isinstance(detector, Path | str):
        return open_detector(Path(detector))
    if isinstance(detector, DetectorProtocol | MatchingDetector):
        return detector
    if callable(detector):
        return FunctionDetector(getattr(detector, "__name__", f"detector {number + 1}"), cast(Any, detector))
    raise ValueError(f"detectors: {detector!r}: expected an ONNX file, a function of an image, or a detector")


@checked
def attribute(
    source: SourceName,
    detectors: Any,
    rain: RainSettings | None = None,
    *,
    intensity: float = 12.0,
    factors: tuple[str, ...] = ("all",),
    seeds: int = 5,
    frames: int = 4,
    width: int = 960,
    backend: Backend = "auto",
    progress: Report | None = None,
) -> RainShares:
    """Take rain apart: the share of each of its parts in what it does to detectors (Shapley values).

    Args:
        source: As in `evaluate_detection`, as are `detectors`, `rain`, `seeds`, `frames`, `width`, `backend`.
        detectors: See there.
        rain: See there.
        intensity: Rainfall intensity in mm/h, above 0.
        factors: Parts of the rain, such as ("streaks", "medium"), or ("all",).
        seeds: See there.
        frames: See there.
        width: See there.
        backend: See there.
        progress: As in `export_rain`.

    Raises:
        ValueError: As `evaluate_detection`, and for parts that are unknown or that the source lacks.
    """
    report = evaluate_detection(
        source, detectors, rain, intensities=(intensity,), attribute=factors, seeds=seeds, frames=frames, width=width,
        backend=backend, progress=progress,
    )  # fmt: skip
    return RainShares(report)


@checked
def evaluate_lidar(
    source: SourceName,
    rain: RainSettings | None = None,
    *,
    sensor: str = "64",
    intensities: tuple[float, ...] = (0.0, 1.2, 8.5, 12.0),
    seeds: int = 5,
    sweeps: int = 1,
    wet_road: bool = True,
    detector: Callable[..., Any] | None = None,
    folder: Path | str | None = None,
    progress: Report | None = None,
) -> LidarReport:
    """Measure what rain does to a lidar: returns kept, lost and made up, by intensity and range.

    Args:
        source: A scene with a drive, on whose roof a virtual sensor stands, or a capture with lidar; by value or name.
        rain: Fog, calibration and spray; None is the default. Its intensity and seed are those of the arguments.
        sensor: A name that `gsrain evaluate lidar --help` lists, or a YAML file of a sensor.
        intensities: Rainfall intensities in mm/h.
        seeds: Number of rains of each intensity.
        sweeps: Number of turns, evenly over the drive or the capture.
        wet_road: Whether water on the road mirrors beams away, and vehicles throw spray.
        detector: A function of a sweep (`points_m`, `intensities`, `origin_m`, `time_s`; in the world) that returns the
            confidence of each object that it finds, by a name of yours: a 3D detector with its own matching.
        folder: Folder to write each sweep in rain to (.npz).
        progress: As in `export_rain`.

    Raises:
        ValueError: For a source without lidar or drive, and for an unknown sensor.
    """
    values = {"intensities_mm_h": intensities, "seeds": seeds, "sweeps": sweeps, "wet_road": wet_road}
    settings = checked_settings(values, LidarSettings, {"intensities": "intensities_mm_h"})
    chosen: LidarSensor = open_sensor(sensor)
    written = None if folder is None else Path(folder)
    work = lidar_session(
        _opened(source),
        chosen,
        _checked_rain(rain, "lidar"),
        settings,
        inputs=_inputs(source),
        sweeps=written,
        detector=detector,
    )
    return run_to_end(work, progress)


# Rainy looks and scenes


@checked
def transfer(
    source: SourceName,
    output: Path | str,
    *,
    method: str = "wet",
    views: int | None = None,
    width: int | None = None,
    cameras: tuple[str, ...] = (),
    capture: Capture | None = None,
    progress: Report | None = None,
    **settings: Any,
) -> RunResult[Path]:
    """Make views of a scene or of a capture rainy, in a folder that `recolor` and `reconstruct` take as images.

    Args:
        source: A scene or a capture, by value or by name.
        output: Folder to write; `made` is its path.
        method: As in `wet`.
        views: Number of views; None is 24, of a capture all.
        width: Their width in pixels; None is their own, at most 960.
        cameras: Only those of these names.
        capture: Recording with the cameras of a scene.
        progress: As in `export_rain`.
        settings: Fields of the transfer's settings, such as `weights`, `wetness` or `seed`.

    Raises:
        ValueError: For an unknown method or setting, and where what the method needs is missing.
        OSError: When the folder can't be written.
    """
    from gsrain_engine.appearance.session import source_views, transfer_views  # kernels take a second to load

    chosen = checked_settings(settings, TransferSettings, {})
    values = {"count": views, "width_px": width, "sensors": cameras}
    choice = checked_settings(values, ViewChoice, {"views": "count", "width": "width_px", "cameras": "sensors"})
    opened = source_views(_opened(source), choice, capture)
    return run_to_end(transfer_views(opened, method, chosen, choice, Path(output)), progress)


@checked
def recolor(
    scene: Scene,
    images: Path | str,
    *,
    capture: Path | str | None = None,
    progress: Report | None = None,
    **settings: Any,
) -> RunResult[Scene]:
    """Solve a scene's wet colors for images; its geometry and its clear colors stay. `made` is the scene.

    Args:
        scene: The scene.
        images: A capture with cameras in the scene's own units and axes, or a folder of images with those of `capture`.
        capture: Capture with the cameras; images are matched by name.
        progress: As in `export_rain`.
        settings: Fields of the run's options, such as `width_px`, `polish` or `replace_clear`, and `colors`, a mapping
            of those of the solver.

    Raises:
        CaptureError: For an image that can't be read.
        ValueError: When the cameras are unknown, or show nothing of the scene.
    """
    from gsrain_engine.recolor.recolor import RecolorOptions, recolor_to_capture  # kernels take a second to load

    options = checked_settings(settings, RecolorOptions, {})
    pictures = open_capture(capture or images)
    if capture is not None:
        pictures = with_images(pictures, Path(images))
    return run_to_end(recolor_to_capture(scene, pictures, options), progress).result


@checked
def reconstruct(
    capture: Path | str,
    output: Path | str,
    *,
    images: Path | str | None = None,
    masks: Path | str | None = None,
    config: str | None = None,
    resume: bool = False,
    progress: Report | None = None,
    **settings: Any,
) -> RunResult[Path]:
    """Fit Gaussians to a capture, and measure them on held-out views; `gr.load(result.made)` is the scene.

    Args:
        capture: COLMAP, nerfstudio, DGP, nuScenes, KITTI, Waymo, or a capture folder.
        output: Scene folder to write.
        images: Folder of images that replace the capture's own, such as one of `transfer`.
        masks: Folder with a mask for each camera: white is trained on.
        config: Shipped settings by name, or a YAML file.
        resume: Whether to go on from the checkpoint of a stopped run.
        progress: As in `export_rain`.
        settings: Fields of the training's settings, such as `steps`.

    Raises:
        ValueError: For settings that are not allowed, without torch, and for a capture with nothing to train on.
        OSError: When the scene can't be written.
    """
    from gsrain_engine.training.settings import load_settings

    require_package("torch", "gr.reconstruct")
    from gsrain_engine.training.data import ReconstructionTask  # torch is optional
    from gsrain_engine.training.train import reconstruct as work
    from gsrain_engine.training.train import reconstruction_result

    pictures, marked = (None if each is None else Path(each) for each in (images, masks))
    task = ReconstructionTask(
        capture=Path(capture), output=Path(output), settings=load_settings(config, **settings), images=pictures,
        masks=marked, resume=resume,
    )  # fmt: skip
    return reconstruction_result(run_to_end(work(task), progress), task.output)


# Sweeps


@checked
def sweep(
    sweep: Path | str,
    output: Path | str,
    *,
    workers: int | None = None,
    settings: Mapping[str, Any] | None = None,
    progress: Report | None = None,
) -> SweepReport:
    """Run every combination of scenes, scenarios, rains and agents that a sweep names; the same call resumes.

    Args:
        sweep: A shipped name, or a YAML file.
        output: Folder of its rows, tables and figures.
        workers: Processes; None is half of the cores, 0 this process.
        settings: Fields of the sweep to change, such as {"seeds": [0, 1]}.
        progress: As in `export_rain`, after each job.

    Returns:
        Its `tables`, `figures` and `numbers`; `save` copies them to another folder.

    Raises:
        ValueError: For settings that give no jobs, and agents in Python files that are not trusted.
        OSError: When a row can't be written.
    """
    loaded = load_sweep(str(sweep))
    values: Mapping[str, Any] = msgspec.to_builtins(loaded) | dict(settings or {})
    chosen = checked_settings(values, type(loaded), {})
    engine = SerialExecutor() if workers == 0 else LocalPool(workers)
    return run_to_end(run_sweep_and_report(chosen, Path(output), engine), progress)
