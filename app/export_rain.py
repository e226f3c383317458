"""`gsrain export-rain`: rain for other programs, as Gaussians or as a rainy copy of a recording."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from gsrain_engine.evaluation.lidar.settings import SENSOR_NAMES
from gsrain_engine.rain.settings import RainSettings
from gsrain_engine.render.export_settings import ExportSettings

from .console import print, run_with_progress
from .options import (
    JsonFile,
    Orientation,
    Wet,
    check_within,
    flag,
    named_options,
    option,
    options_of,
    parse_size,
    setting,
    takes_set,
)
from .outputs import check_writable, lock_outputs, write_numbers
from .render import CameraOption, RainOptions

if TYPE_CHECKING:
    from gsrain_engine.rain.available import Source
    from gsrain_engine.recordings.folders import FileCopies
    from gsrain_engine.report.result import RunResult
    from gsrain_engine.scene.scene import Scene


@Parameter(name="*")  # fields are options of the command, without a prefix
@dataclass(frozen=True, kw_only=True)
class PhotoOptions(options_of(RainSettings, "export-rain", "", topic="Rain")):
    """Options about the photographs of a recording."""

    def added_to(self, rain: RainOptions, scene: "Scene", source: "Source") -> RainSettings:
        """Return the rain with these options; raises ValueError for one without an effect on the source."""
        from gsrain_engine.rain.available import check_available

        settings = self.settings(rain.for_scene(scene, source))
        check_available(self.changes(), settings, source)
        return settings


@Parameter(name="*")  # fields are options of the command, without a prefix
@dataclass(frozen=True, kw_only=True)
class RecordingLidar:
    """Options about the lidar of a recording."""

    lidar_sensor: Annotated[
        str,
        option(f"Lidar of a recording: {', '.join(SENSOR_NAMES)} (beams, or nm), or a YAML file.", topic="Recording"),
    ] = "64"
    full_intensity: Annotated[
        float | None,
        option("Lidar's intensity of white; default: 1, or 100 if values exceed 1.", topic="Recording", rare=True),
    ] = None


@takes_set
def export_rain(
    source: Annotated[
        str,
        option(
            'Scene, "street", or a recording (nuScenes, KITTI, Argoverse 2, Waymo, MCAP, ROS 2 bag, folder of images).'
        ),
    ],
    /,
    *,
    output: Annotated[
        Path,
        setting(
            ExportSettings,
            "output",
            topic="Output",
            text="File to write (.ply .spz ...) for a scene; for a recording a folder, or a file if it is one (.mcap).",
        ),
    ],
    rain: RainOptions | None = None,
    photos: PhotoOptions | None = None,
    time: Annotated[float, setting(ExportSettings, "first_s", "Scenes only.")] = 0.0,
    camera: CameraOption = None,
    size: Annotated[str, setting(ExportSettings, "size_px", "The streaks are made for it.")] = "960x640",
    scene: Annotated[
        str | None,
        option("Recording: scene made of it by gsrain reconstruct; images are of the scene.", topic="Recording"),
    ] = None,
    wet: Wet = None,
    lidar: RecordingLidar | None = None,
    key_frames_only: Annotated[bool, flag("nuScenes: only the annotated samples get rain.", "Recording")] = False,
    hard_links: Annotated[
        bool,
        flag(
            "Recording: unchanged files are stored once, so that editing one edits both; saves disk space.", "Recording"
        ),
    ] = False,
    with_scene: Annotated[bool, flag("Scene: write the scene's Gaussians, too, in one file.", "Output")] = False,
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
    from gsrain_engine.datasets.open_source import names_scene
    from gsrain_engine.publish.rain_gaussians import export_rain_gaussians
    from gsrain_engine.recordings.folders import FileCopies
    from gsrain_engine.scene.formats.registry import check_written_format
    from gsrain_engine.scene.open import load_sorted_scene

    from .render import rainy_light, viewpoint_of

    if names_scene(source):
        check_writable(output, json)
        check_written_format(output)
        check_within("--time", time, 0, 1e6, "s")
        opened = (orientation or Orientation()).of(load_sorted_scene(source))
        kind: Source = "Gaussians with scene" if with_scene else "Gaussians"
        settings = (photos or PhotoOptions()).added_to(rain or RainOptions(), opened, kind)
        if with_scene or wet is not None:
            opened, settings = rainy_light(opened, settings, wet, settings.intensity_mm_h)
        still = ExportSettings(output="rain.png", first_s=time, size_px=parse_size(size))
        viewpoint = viewpoint_of(opened, camera, None, still)
        lock_outputs(output)
        done = export_rain_gaussians(opened, settings, viewpoint, output, still, with_scene=with_scene)
    else:
        is_file = Path(source).is_file()
        check_writable(json, *([output] if is_file else []), folders=[] if is_file else [output])
        options = rain or RainOptions(), photos or PhotoOptions(), lidar or RecordingLidar()
        done = _copy(Path(source), output, scene, wet, *options, key_frames_only, FileCopies(hard_links))
    for line in done.lines:
        print(line)
    write_numbers(json, done.numbers)


def _copy(
    source: Path,
    output: Path,
    scene: str | None,
    wet: bool | None,
    rain: RainOptions,
    photos: PhotoOptions,
    lidar: RecordingLidar,
    key_frames_only: bool,
    files: "FileCopies",
) -> "RunResult[Path]":
    from gsrain_engine.backends import open_renderer
    from gsrain_engine.evaluation.lidar.session import open_sensor
    from gsrain_engine.recordings.rainy_recording import open_recording
    from gsrain_engine.recordings.session import check_copy, export_recording
    from gsrain_engine.scene.open import load_sorted_scene
    from gsrain_engine.scene.scene import Scene

    from .render import rainy_light

    recording = open_recording(source, key_frames_only=key_frames_only)
    world = None if scene is None else load_sorted_scene(scene)
    place = world or Scene(recording.capture.name)
    settings = photos.added_to(rain, place, "photographs" if world is None else "scene")
    if world is None and wet:
        raise ValueError("--wet: photographs have no surfaces for it; --scene names a scene of the recording")
    if world is not None:
        world, settings = rainy_light(world, settings, wet, settings.intensity_mm_h)
    check_within("--full-intensity", lidar.full_intensity, 0, 1e6, is_open=True)
    with named_options(RainSettings, "output", "sensor"), open_renderer("cpu") as renderer:
        check_copy(recording, source, output)
        lock_outputs(output)
        return run_with_progress(
            export_recording(
                renderer, recording, output, settings, scene=world, sensor=open_sensor(lidar.lidar_sensor),
                full_intensity=lidar.full_intensity, files=files,
            )
        )  # fmt: skip
