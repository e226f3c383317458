"""`gsrain export-rain`: rain for other programs, as Gaussians or as a rainy copy of a recording."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter

from gsrain_engine.backends import open_renderer
from gsrain_engine.datasets.bags.containers import MCAP, SQLITE
from gsrain_engine.datasets.capture import Capture
from gsrain_engine.evaluation.lidar.sensor import SENSORS
from gsrain_engine.rain.available import Source, check_available
from gsrain_engine.rain.settings import RainSettings
from gsrain_engine.rain.simulation import RainSimulation
from gsrain_engine.recordings.folders import FileCopies
from gsrain_engine.recordings.lidar import LidarRain
from gsrain_engine.recordings.pictures import PhotoRain, ScenePictures
from gsrain_engine.recordings.rainy_recording import Recording, open_recording
from gsrain_engine.render.export import export_sequences
from gsrain_engine.render.export_settings import ExportSettings
from gsrain_engine.render.photograph import light_words
from gsrain_engine.render.view import rain_camera
from gsrain_engine.scene.formats.registry import check_written_format, write_gaussians
from gsrain_engine.scene.gaussians import Gaussians
from gsrain_engine.scene.open import load_sorted_scene
from gsrain_engine.scene.scene import Scene
from gsrain_engine.scene.transforms import flatten_scene, transform_gaussians, with_wetness_baked, world_to_file

from .console import counted, print, run_with_progress
from .evaluate.lidar import read_sensor
from .options import JsonFile, Wet, check_within, flag, option, options_of, parse_size, setting
from .outputs import check_writable, lock_outputs, write_numbers, write_provenance
from .render import RainOptions, rainy_light, viewpoint_of
from .scene import Orientation, names_scene


@Parameter(name="*")  # fields are options of the command, without a prefix
@dataclass(frozen=True, kw_only=True)
class PhotoOptions(options_of(RainSettings, "export-rain", "")):
    """Options about the photographs of a recording."""

    def added_to(self, rain: RainOptions, scene: Scene, source: Source) -> RainSettings:
        """Return the rain with these options; raises ValueError for one without an effect on the source."""
        settings = self.settings(rain.for_scene(scene, source))
        check_available(self.changes(), settings, source)
        return settings


@Parameter(name="*")  # fields are options of the command, without a prefix
@dataclass(frozen=True, kw_only=True)
class RecordingLidar:
    """Options about the lidar of a recording."""

    lidar_sensor: Annotated[
        str, option(f"Lidar of a recording: {', '.join(SENSORS)} (beams, or nm), or a YAML file.")
    ] = "64"
    full_intensity: Annotated[
        float | None, option("Lidar's intensity of white; default: 1, or 100 if values exceed 1.")
    ] = None

    def of(self, capture: Capture, rain: RainSettings) -> LidarRain:
        """Return the rain on a capture's lidar."""
        check_within("--full-intensity", self.full_intensity, 0, 1e6, is_open=True)
        return LidarRain(
            capture, rain, read_sensor(self.lidar_sensor, {}), full=self.full_intensity, estimates_range=True
        )


def export_rain(
    source: Annotated[
        str, option('Scene, "street", or a recording (nuScenes, KITTI, Waymo, MCAP, ROS 2 bag, folder of images).')
    ],
    /,
    *,
    output: Annotated[
        Path,
        setting(
            ExportSettings,
            "output",
            "Here a file (.ply .spz ...) for a scene; for a recording a new folder, or a file if it is one (.mcap).",
        ),
    ],
    rain: RainOptions | None = None,
    photos: PhotoOptions | None = None,
    time: Annotated[float, setting(ExportSettings, "first_s", "Scenes only.")] = 0.0,
    camera: Annotated[Path | None, option("Scene: camera file (JSON); default: the scene's own path or drive.")] = None,
    size: Annotated[str, setting(ExportSettings, "size_px", "The streaks are made for it.")] = "960x640",
    scene: Annotated[
        str | None, option("Recording: scene made of it by gsrain reconstruct; images are of the scene.")
    ] = None,
    wet: Wet = None,
    lidar: RecordingLidar | None = None,
    key_frames_only: Annotated[bool, flag("nuScenes: only the annotated samples get rain.")] = False,
    hard_links: Annotated[
        bool, flag("Recording: unchanged files are stored once, so that editing one edits both; saves disk space.")
    ] = False,
    with_scene: Annotated[bool, flag("Scene: write the scene's Gaussians, too, in one file.")] = False,
    orientation: Orientation | None = None,
    json: JsonFile = None,
) -> None:
    """Write rain for other programs.

    Of a scene: the rain's Gaussians at a moment, in meters with -y upwards, as `gsrain convert` writes scenes. They are
    made for one camera: what it does not see is left out, and haze is of the paper's Gaussians. Of a recording: a copy
    in its own format whose images and lidar are in rain; names, times, calibration, labels and all else stay as they
    are.
    Images have streaks in front of the photograph, and haze by the distances that lidar or points tell (without any:
    those of a level road); surfaces stay dry. Above 2.5 mm/h, sun and shadows of photographs with distances and a
    certain sky are softened to an overcast day; --keep-light leaves them as taken. With --scene images are rendered,
    wet, through a scene of the recording.
    COPY.provenance.json, beside the copy, says what each image holds.
    """
    if names_scene(source):
        check_writable(output, json)
        check_written_format(output)
        check_within("--time", time, 0, 1e6, "s")
        opened = (orientation or Orientation()).of(load_sorted_scene(source))
        size_px, options = parse_size(size), rain or RainOptions()
        numbers = _export_gaussians(
            opened, options, photos or PhotoOptions(), output, time, camera, size_px, wet, with_scene
        )
    else:
        check_writable(
            json, *([output] if Path(source).is_file() else []), folders=[] if Path(source).is_file() else [output]
        )
        turns = lidar or RecordingLidar()
        numbers = _export_recording(
            Path(source),
            rain or RainOptions(),
            photos or PhotoOptions(),
            output,
            scene,
            wet,
            turns,
            key_frames_only,
            FileCopies(hard_links),
        )
    write_numbers(json, numbers)


def _export_gaussians(
    scene: Scene,
    rain: RainOptions,
    photos: PhotoOptions,
    output: Path,
    time_s: float,
    camera: Path | None,
    size_px: tuple[int, int],
    wet: bool | None,
    with_scene: bool,
) -> dict[str, Any]:
    settings = photos.added_to(rain, scene, "Gaussians with scene" if with_scene else "Gaussians")
    if settings.visibility_m is not None:  # of a preset, or saved with the scene
        raise ValueError(f"fog, visibility {settings.visibility_m:g} m: needs distances; gsrain render draws it")
    if with_scene or wet is not None:
        scene, settings = rainy_light(scene, settings, wet, settings.intensity_mm_h)
    simulation = RainSimulation.start(settings.without_medium)  # a file has Gaussians only
    still = ExportSettings(output="rain.png", first_s=time_s, size_px=size_px)
    viewpoint = viewpoint_of(scene, camera, None, still)
    (sequence,) = export_sequences(still, scene, simulation, viewpoint, in_scene_time=scene.path is not None).values()
    shot = sequence.shot(0)
    with open_renderer("cpu") as renderer:
        sky = sequence.sky(renderer)
    wetness, overcast = simulation.soaked_share_at(shot.time_s), simulation.overcast_at(shot.time_s)
    frame = simulation.frame(shot.time_s, rain_camera(scene, simulation, shot), sky.at(overcast))
    found = transform_gaussians(frame.gaussians, world_to_file())
    if with_scene:
        found = Gaussians.concatenate([flatten_scene(with_wetness_baked(scene, wetness, overcast), shot.time_s), found])
    lock_outputs(output)
    write_gaussians(found, output)
    streaks, haze = len(frame.streaks), len(frame.haze)
    state = simulation.state_at(shot.time_s)
    kinds = f"{counted(streaks, 'streak Gaussian')} and {counted(haze, 'haze Gaussian')}"
    print(f"{output}: {kinds} at {shot.time_s:g} s, {state.intensity_mm_h:g} mm/h")
    return {
        "gaussians": len(found),
        "streaks": streaks,
        "haze": haze,
        "time_s": shot.time_s,
        "intensity_mm_h": state.intensity_mm_h,
    }


def _export_recording(
    source: Path,
    rain: RainOptions,
    photos: PhotoOptions,
    output: Path,
    scene: str | None,
    wet: bool | None,
    lidar: RecordingLidar,
    key_frames_only: bool,
    files: FileCopies,
) -> dict[str, Any]:
    recording = open_recording(source, key_frames_only=key_frames_only)
    capture = recording.capture
    target = _copy_path(recording, source, output)
    world = Scene(capture.name) if scene is None else load_sorted_scene(scene)
    settings = photos.added_to(rain, world, "photographs" if scene is None else "scene")
    if scene is None and wet:
        raise ValueError("--wet: photographs have no surfaces for it; --scene names a scene of the recording")
    bent = next((view.sensor or view.name for view in capture if view.lens is not None), None)
    if settings.glass != "none" and bent is not None:
        raise ValueError(
            f"--glass {settings.glass}: water on glass is drawn for pinholes, and camera {bent} has a lens"
        )
    lock_outputs(target)
    turns = lidar.of(capture, settings) if recording.has_lidar and not RainSimulation.start(settings).is_dry else None
    with open_renderer("cpu") as renderer:
        if scene is None:
            pictures = PhotoRain(renderer, capture, settings)
        else:
            world, settings = rainy_light(world, settings, wet, settings.intensity_mm_h)
            pictures = ScenePictures(renderer, world, capture, settings)
        run_with_progress(recording.write(target, pictures, turns, files))
    problems = [f"left as it was: {each}" for each in recording.untouched]
    for problem in (*capture.problems, *problems, *(f"left out: {each}" for each in files.left_out)):
        print(problem)
    numbers: dict[str, Any] = {"images": pictures.written, "intensity_mm_h": settings.intensity_mm_h}
    how = "of the scene"
    if isinstance(pictures, PhotoRain):
        numbers["images_with_distances"] = pictures.with_distances
        numbers["light"] = dict(pictures.lights)
        how = f"{pictures.with_distances} of them with distances for the haze"
        if pictures.with_distances < pictures.written:
            how += ", the others as over a level road"
    print(f"{target}: {counted(pictures.written, 'rainy image')} ({how}), {settings.intensity_mm_h:g} mm/h")
    if isinstance(pictures, PhotoRain) and pictures.lights:
        print(f"light: {light_words(pictures.lights)}")
    if turns is not None:
        lost = turns.recorded - (turns.written - turns.false)
        numbers |= {"lidar_turns": turns.turns, "lidar_points": turns.recorded, "lidar_lost": lost}
        numbers["lidar_false"] = turns.false
        what = f"{lost:,} of {turns.recorded:,} points lost, {turns.false:,} of drops"
        print(f"{counted(turns.turns, 'lidar turn')}: {what}")
    counts = {"changed": files.changed, "copied": files.copied, "linked": files.linked, "left out": len(files.left_out)}
    print(f"files: {', '.join(f'{count:,} {what}' for what, count in counts.items())}")
    numbers |= {f"files_{what.replace(' ', '_')}": count for what, count in counts.items()}
    write_provenance(target, pictures.provenance, target.with_name(f"{target.name}.provenance.json"))
    return numbers | {"cameras": list(capture.sensors)}


def _copy_path(recording: Recording, source: Path, output: Path) -> Path:
    """Path of the copy; raises ValueError if something is there already, or if it lies in the recording."""
    if recording.is_file and output.suffix.lower() != source.suffix.lower():
        raise ValueError(f"--output {output}: expected the name of a {source.suffix} file, as {source.name} is one")
    if not recording.is_file and output.suffix.lower() in (MCAP, SQLITE):
        raise ValueError(f"--output {output}: expected the name of a new folder, as {source.name} is one")
    if not recording.is_file and output.resolve().is_relative_to(recording.folder.resolve()):
        raise ValueError(f"--output {output}: lies in the recording itself")
    if output.exists() and (recording.is_file or not output.is_dir() or any(output.iterdir())):
        kind = "file" if recording.is_file else "folder"
        raise ValueError(f"--output {output}: there is something already; expected the name of a new {kind}")
    return output
