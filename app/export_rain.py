"""`gsrain export-rain`: rain for other programs, as Gaussians or as a rainy copy of a recording."""

from pathlib import Path
from typing import Annotated, Any

from gsrain_engine.appearance.rainy_recording import write_rainy_recording
from gsrain_engine.backends import open_renderer
from gsrain_engine.datasets.open_capture import open_capture
from gsrain_engine.rain.settings import RainSettings
from gsrain_engine.rain.simulation import RainSimulation
from gsrain_engine.render.draw import rain_camera
from gsrain_engine.render.export import export_sequences
from gsrain_engine.render.export_settings import ExportSettings
from gsrain_engine.scene.formats.registry import check_written_format, write_gaussians
from gsrain_engine.scene.gaussians import Gaussians
from gsrain_engine.scene.open import load_sorted_scene
from gsrain_engine.scene.scene import Scene
from gsrain_engine.scene.transforms import flatten_scene, transform_gaussians, with_wetness_baked, world_to_file

from .console import counted, print, run_with_progress
from .options import JsonFile, check_within, flag, option, parse_size, setting
from .outputs import check_writable, lock_outputs, write_numbers
from .render import RainOptions, viewpoint_of
from .scene import Orientation, names_scene


def export_rain(
    source: Annotated[str, option('Scene, "street", or a recording (nuScenes, KITTI, or a folder of images).')],
    /,
    *,
    output: Annotated[
        Path,
        setting(ExportSettings, "output", "Here a file (.ply .spz ...) for a scene, a new folder for a recording."),
    ],
    rain: RainOptions | None = None,
    time: Annotated[float, setting(ExportSettings, "first_s", "Scenes only.")] = 0.0,
    camera: Annotated[Path | None, option("Scene: camera file (JSON); default: the scene's own path or drive.")] = None,
    size: Annotated[str, setting(ExportSettings, "size_px", "The streaks are made for it.")] = "960x640",
    with_scene: Annotated[bool, flag("Scene: write the scene's Gaussians, too, in one file.")] = False,
    orientation: Orientation | None = None,
    json: JsonFile = None,
) -> None:
    """Write rain for other programs.

    Of a scene: the rain's Gaussians at a moment, in meters with -y upwards, as `gsrain convert` writes scenes. They are
    made for one camera: what it does not see is left out. Of a recording: a copy in its own format whose images are
    rainy; lidar, calibration and boxes stay as they are. In both, haze is of the paper's Gaussians.
    """
    if names_scene(source):
        check_writable(output, json)
        check_written_format(output)
        check_within("--time", time, 0, 1e6, "s")
        opened = (orientation or Orientation()).of(load_sorted_scene(source))
        numbers = _export_gaussians(opened, rain or RainOptions(), output, time, camera, parse_size(size), with_scene)
    else:
        check_writable(json, folders=[output])
        numbers = _export_recording(Path(source), rain or RainOptions(), output)
    write_numbers(json, numbers)


def _export_gaussians(
    scene: Scene,
    rain: RainOptions,
    output: Path,
    time_s: float,
    camera: Path | None,
    size_px: tuple[int, int],
    with_scene: bool,
) -> dict[str, Any]:
    simulation = RainSimulation.start(_without_fog(rain, scene).without_medium)  # a file has Gaussians only
    still = ExportSettings(output="rain.png", first_s=time_s, size_px=size_px)
    viewpoint = viewpoint_of(scene, camera, None, still, is_frame=False)
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


def _without_fog(rain: RainOptions, scene: Scene) -> RainSettings:
    """Return the rain; raises ValueError for fog, which neither Gaussians nor photographs without distances have."""
    settings = rain.for_scene(scene)
    if settings.visibility_m is not None:
        raise ValueError(f"--visibility {settings.visibility_m:g}: fog needs distances; gsrain render draws it")
    return settings


def _export_recording(source: Path, rain: RainOptions, output: Path) -> dict[str, Any]:
    capture = open_capture(source)
    folder = source if source.is_dir() else source.parent  # NUSCENES/scene-0061 names a scene, not a folder
    if output.resolve().is_relative_to(folder.resolve()):
        raise ValueError(f"--output {output}: lies in the recording itself")
    if output.exists() and (not output.is_dir() or any(output.iterdir())):
        raise ValueError(f"--output {output}: there is something already; expected the name of a new folder")
    lock_outputs(output)
    settings = _without_fog(rain, Scene(capture.name))
    with open_renderer("cpu") as renderer:
        run_with_progress(write_rainy_recording(renderer, capture, folder, settings, output))
    for problem in capture.problems:
        print(problem)
    print(f"{output}: {counted(len(capture), 'rainy image')}, {settings.intensity_mm_h:g} mm/h; all else as it was")
    return {"images": len(capture), "intensity_mm_h": settings.intensity_mm_h, "cameras": list(capture.sensors)}
