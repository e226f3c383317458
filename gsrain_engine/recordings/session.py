"""A rainy copy of a recording, from opening it to the numbers of the copy."""

from collections.abc import Generator
from pathlib import Path
from typing import Any

from ..datasets.bags.containers import MCAP, SQLITE
from ..evaluation.lidar.sensor import SENSORS, LidarSensor
from ..rain.settings import RainSettings
from ..rain.simulation import RainSimulation
from ..render.photograph import light_words
from ..render.renderer import Renderer
from ..report.numbers import write_provenance
from ..report.result import RunResult
from ..report.table import Table, columns
from ..scene.progress import Progress
from ..scene.scene import Scene
from .folders import FileCopies
from .lidar import LidarRain
from .pictures import PhotoRain, ScenePictures
from .rainy_recording import Recording


def export_recording(
    renderer: Renderer,
    recording: Recording,
    target: Path,
    rain: RainSettings,
    *,
    scene: Scene | None = None,
    sensor: LidarSensor | None = None,
    full_intensity: float | None = None,
    files: FileCopies | None = None,
) -> Generator[Progress, None, RunResult[Path]]:
    """Write a copy of a recording in its own format, whose images and lidar are in rain.

    Args:
        renderer: Draws the images.
        recording: What is copied; names, times, calibration, labels and all else stay as they are.
        target: New file or folder of the copy; TARGET.provenance.json beside it says what each image holds, and
            names all files that differ.
        rain: The rain.
        scene: Scene of the recording, of which the images are then rendered; None draws rain over the photographs.
        sensor: Lidar of the recording, for its limits of detection; None is one of 64 beams.
        full_intensity: The lidar's intensity of white; None is 1, or 100 if values exceed 1.
        files: How unchanged files are copied.

    Raises:
        ValueError: For a target that can't be, and for water on the glass of cameras with a lens.
        CaptureError: For an image that can't be read.
        OSError: When the copy can't be written.
    """
    capture, files = recording.capture, files or FileCopies()
    bent = next((view.sensor or view.name for view in capture if view.lens is not None), None)
    if rain.glass != "none" and bent is not None:
        raise ValueError(f"glass {rain.glass}: water on glass is drawn for pinholes, and camera {bent} has a lens")
    lidar = None
    if recording.has_lidar and not RainSimulation.start(rain).is_dry:
        lidar = LidarRain(capture, rain, sensor or SENSORS["64"], full=full_intensity, estimates_range=True)
    photos = PhotoRain(renderer, capture, rain) if scene is None else None
    pictures = photos or ScenePictures(renderer, scene or Scene(capture.name), capture, rain)
    yield from recording.write(target, pictures, lidar, files)
    sidecar = target.with_name(f"{target.name}.provenance.json")
    write_provenance(target, pictures.provenance, sidecar, {"changed_files": sorted(files.changed)})
    numbers: dict[str, Any] = {"images": pictures.written, "intensity_mm_h": rain.intensity_mm_h}
    how = "of the scene"
    if photos is not None:
        numbers["images_with_distances"] = photos.with_distances
        how = f"{photos.with_distances} of them with distances for the haze"
        how += ", the others as over a level road" if photos.with_distances < photos.written else ""
    lines = [*capture.problems, *(f"left as it was: {each}" for each in recording.untouched)]
    lines += [f"left out: {each}" for each in files.left_out]
    lines.append(f"{target}: {_counted(pictures.written, 'rainy image')} ({how}), {rain.intensity_mm_h:g} mm/h")
    light: dict[str, Any] = {}
    if photos is not None and photos.lights:
        light = {"light": dict(photos.lights)}
        lines.append(f"light: {light_words(photos.lights)}")
    if lidar is not None:
        lost = lidar.recorded - (lidar.written - lidar.false)
        numbers |= {"lidar_turns": lidar.turns, "lidar_points": lidar.recorded}
        numbers |= {"lidar_lost": lost, "lidar_false": lidar.false}
        what = f"{lost:,} of {lidar.recorded:,} points lost, {lidar.false:,} of drops"
        lines.append(f"{_counted(lidar.turns, 'lidar turn')}: {what}")
    counts = {
        "changed": len(files.changed),
        "copied": files.copied,
        "linked": files.linked,
        "left out": len(files.left_out),
    }
    lines.append(f"files: {', '.join(f'{count:,} {what}' for what, count in counts.items())}")
    numbers |= {f"files_{what.replace(' ', '_')}": count for what, count in counts.items()}
    rows = [(name.replace("_", " "), value) for name, value in numbers.items()]
    table = Table(f"Rainy copy of {capture.name}", columns({"number of": "", "value": ",g"}), rows)
    numbers |= {**light, "cameras": list(capture.sensors)}
    return RunResult(made=target, table=table, numbers=numbers, lines=tuple(lines), draw=pictures.draw)


def check_copy(recording: Recording, source: Path, target: Path) -> None:
    """Raise ValueError, which begins with `output`, if something is there already, or is in the recording."""
    if recording.is_file and target.suffix.lower() != source.suffix.lower():
        raise ValueError(f"output {target}: expected the name of a {source.suffix} file, as {source.name} is one")
    if not recording.is_file and target.suffix.lower() in (MCAP, SQLITE):
        raise ValueError(f"output {target}: expected the name of a new folder, as {source.name} is one")
    if not recording.is_file and target.resolve().is_relative_to(recording.folder.resolve()):
        raise ValueError(f"output {target}: lies in the recording itself")
    if target.exists() and (recording.is_file or not target.is_dir() or any(target.iterdir())):
        kind = "file" if recording.is_file else "folder"
        raise ValueError(f"output {target}: there is something already; expected the name of a new {kind}")


def _counted(count: int, noun: str) -> str:
    return f"{count:,} {noun}" + ("" if count == 1 else "s")
