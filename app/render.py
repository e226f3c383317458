"""`gsrain render SCENE -o OUT`: images and videos without a window."""

import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter
from msgspec import structs

from gsrain_engine.choices import FOUND_LAMPS, Backend, LabelFormat, RenderMode
from gsrain_engine.fields import option_names
from gsrain_engine.rain.settings import RainSettings, load_preset
from gsrain_engine.render.export_settings import DEFAULT_SIZE_PX, ExportSettings, export_outputs
from gsrain_engine.safe_io.errors import convert_checked

from .console import counted, print, progress_bar, run_with_progress
from .options import (
    BACKEND,
    JsonFile,
    Orientation,
    Preset,
    StructOptions,
    Wet,
    check_within,
    option,
    options_of,
    parse_intensities,
    takes_set,
)
from .outputs import check_image, check_writable, lock_outputs, write_numbers
from .plan import is_plan, plan_camera

if TYPE_CHECKING:
    import numpy as np
    from jaxtyping import Float64

    from gsrain_engine.rain.available import Source
    from gsrain_engine.rain.keyframes import Keyed, RainKeyframes
    from gsrain_engine.rain.properties import RainProperties
    from gsrain_engine.rain.simulation import RainSimulation
    from gsrain_engine.render.provenance import PictureProvenance
    from gsrain_engine.render.renderer import Renderer
    from gsrain_engine.render.sequence import FrameSequence
    from gsrain_engine.scene.camera import Camera
    from gsrain_engine.scene.camera_path import CameraPath
    from gsrain_engine.scene.named_view import NamedView
    from gsrain_engine.scene.progress import Progress
    from gsrain_engine.scene.scene import Scene

    from .scene import TimedPath


_FILE_ENDINGS = (".png", ".jpg", ".jpeg", ".exr", ".npy", ".mp4", ".webm", ".json")
"""Extensions of written files; any other output is a folder, even with dots: frames.clear, clip.depth."""


@Parameter(name="*")  # fields are options of the command, without a prefix
@dataclass(frozen=True, kw_only=True)
class RainOptions(options_of(RainSettings, "render", "", topic="Rain")):
    """Rain on the command line."""

    preset: Preset = None

    def for_scene(self, scene: "Scene", source: "Source" = "scene") -> RainSettings:
        """Return the preset, else the scene's saved rain, else no rain, with the options set.

        Raises `ValueError`, which names the option, for one that has no effect on such a source.
        """
        from gsrain_engine.rain.available import check_available
        from gsrain_engine.rain.keyframes import saved_rain

        values = saved_rain(scene)
        saved = None if values is None else convert_checked(values, RainSettings)
        rain = self.settings(saved if self.preset is None else load_preset(self.preset))
        check_available(self.changes(), rain, source)
        return rain


RecordingOptions = options_of(
    ExportSettings, "render", defaults={"size_px": "960x640, or the camera's own"}, topic="Output"
)


_CAMERA_HELP = (
    "Six numbers with commas: X,Y,Z of the camera and of the point it looks at, in meters with z up (gsrain info "
    "tells where a scene lies). Or a camera file (JSON, .glb, .gltf), in the scene's own units and axes."
)
CameraOption = Annotated[str | None, option(_CAMERA_HELP, topic="Camera and time", allow_leading_hyphen=True)]


ViewOption = Annotated[
    str | None,
    option(
        "Named view of the scene: its camera, and its time and rain unless options set these (gsrain info lists them).",
        topic="Camera and time",
        rare=True,
    ),
]


@takes_set
def render(
    scene: Annotated[str | None, option("Scene file or folder; default: the built-in street.")] = None,
    /,
    *,
    recording: RecordingOptions,
    rain: RainOptions | None = None,
    camera: Annotated[
        str | None,
        option(
            f"{_CAMERA_HELP} Or top or ortho: to scale, from above (+y up) or aslant; top:X,Y around a place, top:NAME "
            "along with a road user or ego.",
            topic="Camera and time",
            allow_leading_hyphen=True,
        ),
    ] = None,
    pixels_per_meter: Annotated[
        float | None,
        option("Scale of --camera top or ortho; default: all of the scene.", topic="Camera and time", rare=True),
    ] = None,
    camera_path: Annotated[
        Path | None,
        option("Camera path: ours, nerfstudio's, 3DGS's cameras.json, a .glb or .gltf.", topic="Camera and time"),
    ] = None,
    view: ViewOption = None,
    rain_keyframes: Annotated[
        Path | None,
        option(
            "Rain keyframes (YAML or JSON) in place of the scene's: intensity, wind, wetness, lamps.",
            topic="Rain",
            rare=True,
        ),
    ] = None,
    speed: Annotated[
        float | None,
        option(
            "Speed on the camera path in m/s; default: its own, or walking pace.", topic="Camera and time", rare=True
        ),
    ] = None,
    duration: Annotated[
        float | None, option("Seconds of video; default: the path's length, at most 10.", topic="Camera and time")
    ] = None,
    frame: Annotated[
        int | None,
        option("Render only this frame of the path or drive, counted from 0.", topic="Camera and time", rare=True),
    ] = None,
    depth: Annotated[
        bool, option("Add depth to the passes: PNG (16 bit, cm), NPY (m) or EXR (m).", topic="Output", rare=True)
    ] = False,
    labels: Annotated[
        LabelFormat | None,
        option("Also write boxes, visibility, instance masks and depth.", topic="Output", rare=True),
    ] = None,
    sheet: Annotated[
        str | None,
        option(
            "Image with these intensities (0,1.2,8.5,12) below each other, and what is seen of each.", topic="Output"
        ),
    ] = None,
    mode: Annotated[
        RenderMode, option("splats for the image; others show the scene without rain.", topic="Output", rare=True)
    ] = "splats",
    wet: Wet = None,
    orientation: Orientation | None = None,
    backend: Annotated[Backend, BACKEND] = "auto",
    json: JsonFile = None,
) -> int:
    """Render a scene in the rain: an image, a video, frames, or raw floats (premultiplied, before tone mapping).

    Prints the rain rate that is drawn, and the maximum visible distance of streaks, at which a drop covers one pixel.
    """
    from gsrain_engine.backends import open_renderer
    from gsrain_engine.rain.available import PLAN_SHOWS
    from gsrain_engine.rain.calibration import load_calibration
    from gsrain_engine.rain.keyframes import NO_KEYFRAMES
    from gsrain_engine.rain.simulation import RainSimulation
    from gsrain_engine.render.export import export_frames, export_sequences, first_pictures
    from gsrain_engine.report.numbers import write_provenance
    from gsrain_engine.scene.camera import Camera
    from gsrain_engine.scene.objects import scene_objects
    from gsrain_engine.scene.open import load_sorted_scene

    rain_options = rain or RainOptions()
    export = export_settings(recording, with_depth=depth or labels is not None)
    if pixels_per_meter is not None and not is_plan(camera):
        raise ValueError(f"--pixels-per-meter {pixels_per_meter:g}: only --camera top and ortho have a scale")
    check_within("--duration", duration, 0, 36_000, "s", is_open=True)
    if frame is not None and frame < 0:
        raise ValueError(f"--frame {frame}: must be 0 or more")
    given = _option_values(recording) | _option_values(rain_options) | {
        "--camera": camera, "--camera-path": camera_path, "--depth": depth or None, "--duration": duration,
        "--frame": frame, "--labels": labels, "--mode": None if mode == "splats" else mode,
        "--preset": rain_options.preset, "--rain-keyframes": rain_keyframes, "--view": view,
    }  # fmt: skip
    _check_used({name: value for name, value in given.items() if value is not None}, export, sheet)
    intensities = None if sheet is None else _sheet_intensities(sheet, export)
    check_writable(json)
    opened, chosen = at_view((orientation or Orientation()).of(load_sorted_scene(scene)), view)
    if chosen is not None and chosen.time_s is not None and "first_s" not in recording.changes():
        export = structs.replace(export, first_s=chosen.time_s)
        export.check()
    if labels is not None and not scene_objects(opened):
        raise ValueError(f"--labels {labels}: scene {opened.name!r} has no actors that labels could be about")
    is_to_scale = is_plan(camera) or (chosen is not None and chosen.orthographic)
    settings = rain_options.for_scene(opened, "plan" if is_to_scale else "scene")
    weather = rendered_weather(rain_options, opened, rain_keyframes)
    if wet is False and weather is not None:
        weather = weather.without("wetness")
    heaviest = max(intensities or [(weather or NO_KEYFRAMES).heaviest_mm_h(settings)])
    load_calibration(settings.calibration)  # before colors are computed for a rain that can't be made
    opened, settings = rainy_light(opened, settings, wet, heaviest)
    simulation = RainSimulation.start(settings, weather=weather)
    is_own_path = camera is None and camera_path is None and view is None and opened.path is not None
    if camera is not None and camera_path is None and view is None and is_plan(camera):
        viewpoint = plan_camera(opened, camera, export, pixels_per_meter)
    else:
        viewpoint = viewpoint_of(opened, camera, camera_path, export, chosen)
    if frame is not None and export.is_still and isinstance(viewpoint, Camera) and not export.cameras:
        place = "--camera" if camera is not None else "--view" if view is not None else ""
        place = place or f"scene {opened.name!r}, which has no path or drive,"
        raise ValueError(f"--frame {frame}: a still from {place} has no other frame; --time sets its moment")
    timing = _timing(opened, viewpoint, camera_path, export, speed)
    viewpoint = viewpoint if timing is None else timing.path
    sequences = export_sequences(export, opened, simulation, viewpoint, in_scene_time=is_own_path)
    if intensities is not None:
        with open_renderer(backend) as renderer:
            numbers = _write_sheet(renderer, sequences, settings, intensities, export.path, wet)
        write_numbers(json, numbers)
        return 0
    numbers = _frame_numbers(export, sequences, duration, frame)
    shots = {name: sequence.shot(numbers[0]) for name, sequence in sequences.items()}
    bent = next((name for name, shot in shots.items() if shot.camera.lens is not None), None)
    if labels is not None and bent is not None:
        raise ValueError(f"--labels {labels}: labels are those of pinholes, and camera {bent or camera} has a lens")
    outputs = export_outputs(export, list(sequences))
    _check_outputs(outputs, export, list(sequences), labels, json)
    lock_outputs(*outputs)
    first_s = next(iter(sequences.values())).time_s(numbers[0])
    with open_renderer(backend) as renderer:
        frames = export_frames(renderer, export, sequences, numbers, mode=mode)
        report = _record(frames, renderer, simulation.state_at(first_s), len(numbers))
        if json is not None:
            report |= _glass(sequences, numbers[max(report["frames"], 1) - 1])
        pictures = first_pictures(renderer, sequences, numbers[0], mode)
        report |= _extinction(simulation.frozen_at(first_s), next(iter(pictures.values())))
        labeled: list[Path] = []
        if labels is not None and (done := numbers[: report["frames"]]):
            from gsrain_engine.render.label_export import write_object_labels  # loads OpenCV, which images don't need

            labeled = run_with_progress(write_object_labels(renderer, labels, export, sequences, done))
    if timing is not None and timing.line is not None:
        print(f"{camera_path or opened.name}: {timing.line}")
    sizes = ", ".join(dict.fromkeys(f"{each.width}x{each.height}" for each in sequences.values()))
    count = f"{report['frames']} of {len(numbers)} frames"
    scales = [each.camera.pixels_per_m for each in shots.values() if each.camera.is_orthographic]
    drawn = _describe(simulation, first_s) if not scales else f"{scales[0]:.4g} px/m; {PLAN_SHOWS}"
    print(f"{_listed(outputs)}: {count}, {sizes}, {drawn}")
    lamps = simulation.lamps.of(opened)
    if settings.lamps == FOUND_LAMPS:
        print(f"{counted(len(lamps), 'lamp')} found")
    distances = _visible_distances(simulation.frozen_at(first_s), sequences, numbers[0])
    for line in dict.fromkeys(map(_visible, distances)):
        print(line)
    if labeled:
        print(f"{_listed(labeled)}: labels, the same with rain and without")
    speeds = {"speed_m_s": timing.speed_m_s, "speed_is_assumed": timing.is_assumed} if timing is not None else {}
    report |= {"pixels_per_m": max(scales)} if scales else {}
    report |= {"visible_distance": distances, "lamps": len(lamps), "backend": renderer.name} | speeds
    write_numbers(json, report | write_provenance(Path(export.output), pictures))
    return 0 if report["frames"] == len(numbers) else 130


def rainy_light(
    scene: "Scene", rain: RainSettings, wet: bool | None, heaviest_mm_h: float
) -> "tuple[Scene, RainSettings]":
    """Return scene and rain with the choice of --wet; computes wet colors if they are asked for and missing.

    Prints how to get them if it rains on a scene without any.
    """
    from gsrain_engine.rain.wetness import missing_wet_colors, with_wet_choice

    if wet and not scene.has_rainy_light:
        from gsrain_engine.recolor.cached_colors import cached_wet_scene  # kernels take a second to load

        scene = run_with_progress(cached_wet_scene(scene))
    rain = with_wet_choice(rain, wet, heaviest_mm_h)
    if (line := missing_wet_colors(scene, rain, heaviest_mm_h)) is not None:
        print(line, file=sys.stderr)
    return scene, rain


_KEYED_OPTIONS: "dict[Keyed, tuple[str, ...]]" = {
    "intensity_mm_h": ("intensity_mm_h",), "exposure_s": ("exposure_s",),
    "wind_m_s": ("wind_speed_m_s", "wind_from_deg", "wind_m_s"), "wetness": ("wetness",), "lamp_gain": ("lamp_gain",),
}  # fmt: skip


def rendered_weather(options: RainOptions, scene: "Scene", file: Path | None = None) -> "RainKeyframes | None":
    """Return the rain keyframes of a file, else those saved with a scene, without those that options replace.

    Raises `ValueError` if they are invalid, and `OSError` if the file can't be read.
    """
    from gsrain_engine.rain.keyframes import RainKeyframes, read_keyframes

    if file is not None:
        weather = read_keyframes(file)
    elif scene.weather is None or options.preset is not None:
        return None
    else:
        weather = convert_checked(scene.weather, RainKeyframes)
    changed = options.changes()
    for field, options_of_it in _KEYED_OPTIONS.items():
        weather = weather if changed.keys().isdisjoint(options_of_it) else weather.without(field)
    return weather


def export_settings(options: StructOptions, *, with_depth: bool) -> ExportSettings:
    """Check all options of the export. Raises `ValueError` for values out of bounds or in conflict."""
    passes = options.changes().get("passes", ["color"])
    settings = options.settings(passes=list(dict.fromkeys([*passes, "depth"])) if with_depth else passes)
    settings.check()
    return settings


def _record(frames: "Iterator[Progress]", renderer: "Renderer", state: "RainProperties", count: int) -> dict[str, Any]:
    """Record frames and return the numbers of the report; Ctrl-C stops early and keeps the frames so far."""
    started, done = time.perf_counter(), 0
    with progress_bar("Rendering", count) as advance:
        try:
            for progress in frames:
                advance(round(progress.fraction * count) - done)
                done = round(progress.fraction * count)
        except KeyboardInterrupt:
            print(f"stopped after {done} frames")
    return {
        "frames": done,
        "seconds": time.perf_counter() - started,
        "splats": renderer.statistics.splats_drawn,
        "drops": state.drops,
        "drops_drawn": renderer.statistics.drops_drawn,
        "haze_gaussians": state.haze_gaussians,
        "haze_drawn": renderer.statistics.haze_drawn,
        "intensity_mm_h": state.intensity_mm_h,
        "rain_class": state.rain_class,
        "implied_mm_h": state.implied_mm_h,
        "table_implied_mm_h": state.table_implied_mm_h,
    }


def _option_values(options: StructOptions) -> dict[str, Any]:
    """Values of the options that were set, by the option's name."""
    names = option_names(options.kind)
    return {names.get(field, f"--set {field}"): value for field, value in options.changes().items()}


def _check_used(given: Mapping[str, Any], export: ExportSettings, sheet: str | None) -> None:
    """Raise `ValueError` for a given option that has no effect on this output; `given` are values by option."""
    without: dict[str, str] = {}
    if "--cameras" in given:
        without |= dict.fromkeys(("--camera", "--camera-path", "--view"), "the views are those of --cameras")
    if "--mode" in given:  # which --rain 0 agrees with
        rain = [name for name in _RAIN if given.get(name) != 0]
        without |= dict.fromkeys(rain, f"--mode {given['--mode']} shows the scene without rain")
    if export.format in ("png", "exr", "npy"):
        without["--quality"] = "PNG, EXR and NPY are written without loss; JPEG and videos have a quality"
    if export.is_still and "--frame" not in given:
        without |= dict.fromkeys(("--duration", "--fps", "--to"), "a still is one moment, which --time sets")
    if sheet is not None:
        without |= dict.fromkeys(_NOT_OF_SHEETS, "a sheet is one image of one moment in the intensities of --sheet")
    for name, reason in without.items():
        if name in given:
            raise ValueError(f"{name} has no effect: {reason}")


_RAIN = "--rain", "--preset", "--rain-keyframes"
_NOT_OF_SHEETS = (
    "--clear-pair", "--depth", "--frame", "--labels", "--mode", "--passes", "--quality", "--rain", "--transparent",
)  # fmt: skip


def _sheet_intensities(sheet: str, export: ExportSettings) -> list[float]:
    """Parse `--sheet`, and check that the output is one image."""
    intensities = parse_intensities(sheet, "--sheet")
    check_image("--output", Path(export.output))
    return intensities


def _write_sheet(
    renderer: "Renderer",
    sequences: "Mapping[str, FrameSequence]",
    rain: RainSettings,
    intensities: Sequence[float],
    output: Path,
    wet: bool | None,
) -> dict[str, Any]:
    """Render and write a sheet of intensities; returns its numbers."""
    from gsrain_engine.render.intensity_sheet import write_sheet  # loads OpenCV, which images don't need
    from gsrain_engine.report.numbers import write_provenance

    lock_outputs(output)
    cells = run_with_progress(write_sheet(renderer, sequences, intensities, output, wet=wet))
    pictures = {
        f"{cell.view} {cell.intensity_mm_h:g} mm/h".lstrip(): cell.provenance for cell in cells if cell.provenance
    }
    for cell in cells:
        print(f"{f'{cell.view}, ' if cell.view else ''}{cell.intensity_mm_h:g} mm/h: {cell.caption}")
    print(", ".join(filter(None, [f"{output}: {len(cells)} images", rain.exaggeration])))
    facts = write_provenance(output, pictures)
    return {"cells": [cell.numbers for cell in cells], "backend": renderer.name} | facts


def _listed(paths: list[Path]) -> str:
    return " and ".join(map(str, paths)) if len(paths) <= 6 else f"{paths[0]} and {len(paths) - 1} more"


def _describe(simulation: "RainSimulation", first_s: float) -> str:
    """Describe the rain, for animated rain at the first frame."""
    state, keys = simulation.state_at(first_s), simulation.weather.keys
    when = f"first of a weather with {len(keys):,} keys: " if keys else ""
    fog = (
        "" if simulation.frozen_at(first_s).rain.visibility_m is None else f"fog, visibility {state.visibility_m:.0f} m"
    )
    if state.intensity_mm_h == 0:
        return f"{when}{fog or 'clear'}"
    classed = f" ({state.rain_class})" if state.rain_class else ""
    asked = f"{when}{state.intensity_mm_h:g} mm/h asked{classed}"
    rain = f"{asked}, {state.implied_mm_h:.3g} mm/h drawn, {state.drops:,} drops, extinction {state.extinction_text}"
    beyond = "beyond calibration" if state.beyond_calibration else ""
    return ", ".join(filter(None, [rain, fog, beyond, simulation.rain.exaggeration]))


def _extinction(simulation: "RainSimulation", picture: "PictureProvenance") -> dict[str, float | list[float] | None]:
    """Extinction of the rain at a time, and the light that replaces what is lost; None for what does not exist."""
    import numpy as np

    from gsrain_engine.scene.geometry import srgb_to_linear

    beta, rain = simulation.state.extinction_per_m, simulation.rain
    airlight: list[float] | None = None
    if beta > 0 and (rain.haze == "medium" or rain.visibility_m is not None):
        airlight = srgb_to_linear(np.array(picture.light.airlight)).tolist()
    fog = {} if rain.visibility_m is None else {"fog_extinction_per_m": simulation.state.fog_extinction_per_m}
    return fog | {
        "extinction_per_m": beta,
        "marshall_palmer_extinction_per_m": simulation.state.marshall_palmer_extinction_per_m,
        "meteorological_range_m": simulation.state.visibility_m if beta > 0 else None,
        "airlight_linear": airlight,
    }


def _glass(sequences: "Mapping[str, FrameSequence]", number: int) -> dict[str, float]:
    """Figures of the water on glass at a frame, summed over the cameras."""
    states = [each.glass_state(number) for each in sequences.values()]
    return {
        "glass_impacts": sum(each.impacts for each in states),
        "glass_expected_impacts": sum(each.expected_impacts for each in states),
        "glass_seconds": max(each.seconds for each in states),
        "glass_area_m2": sum(each.area_m2 for each in states),
    }


def _visible_distances(
    simulation: "RainSimulation", sequences: "Mapping[str, FrameSequence]", number: int
) -> list[dict[str, Any]]:
    """Compute the maximum visible distance of streaks (eq. 6, 7) in a frame of each camera; none without rain."""
    import numpy as np

    from gsrain_engine.rain.streaks import visible_distance_m

    sequences = {name: each for name, each in sequences.items() if not each.shot(number).camera.is_orthographic}
    if simulation.state.intensity_mm_h == 0:
        return []
    sizes, haze_coefficient = simulation.state.sizes, simulation.rain.critical_haze_coefficient
    diameters_mm = np.array([sizes.large_diameter_mm, sizes.median_volume_diameter_mm])
    found: list[dict[str, Any]] = []
    for name, sequence in sequences.items():
        camera = sequence.shot(number).camera
        focal_px = float(np.sqrt(camera.fx * camera.fy))
        large_m, middle_m = visible_distance_m(diameters_mm, focal_px).tolist()
        found.append({
            "camera": name, "focal_px": focal_px,
            "large_drop_mm": float(diameters_mm[0]), "large_drop_m": large_m,
            "large_drop_haze_m": haze_coefficient * large_m,
            "median_volume_drop_mm": float(diameters_mm[1]), "median_volume_drop_m": middle_m,
        })  # fmt: skip
    return found


def _visible(distance: Mapping[str, Any]) -> str:
    """Describe a visible distance in one line."""
    return (
        "a drop covers a pixel (focal length {focal_px:.0f} px) up to {large_drop_m:.2f} m away if it has "
        "{large_drop_mm:.2f} mm (97.5 % are smaller), up to {median_volume_drop_m:.2f} m if it has "
        "{median_volume_drop_mm:.2f} mm (median volume); haze from {large_drop_haze_m:.2f} m on"
    ).format(**distance)


def _check_outputs(
    written: list[Path], export: ExportSettings, cameras: Sequence[str], labels: LabelFormat | None, json: Path | None
) -> None:
    """Raise ValueError for outputs that could not be written after rendering."""
    if labels is not None:
        from gsrain_engine.render.label_export import label_outputs  # loads OpenCV, which images don't need

        written = written + label_outputs(labels, export, cameras)
    folders = [path for path in written if path.suffix.lower() not in _FILE_ENDINGS]
    check_writable(json, *(path for path in written if path not in folders), folders=dict.fromkeys(folders))


def at_view(scene: "Scene", name: str | None) -> "tuple[Scene, NamedView | None]":
    """Return the view of `--view`, and the scene with its rain; raises `ValueError` if the scene has no such view."""
    from gsrain_engine.editor.views import scene_at_view
    from gsrain_engine.scene.named_view import view_named

    if name is None:
        return scene, None
    try:
        view = view_named(scene.views, name, scene.name)
        return scene_at_view(scene, view), view
    except ValueError as error:
        raise ValueError(f"--{error}") from None


def check_one_camera(view: object, camera: str | None, camera_path: Path | None) -> None:
    """Raise `ValueError` if more than one option sets the camera."""
    options = {"--view": view, "--camera": camera, "--camera-path": camera_path}
    if len(given := [name for name, value in options.items() if value is not None]) > 1:
        raise ValueError(f"{given[0]} and {given[1]} exclude each other")


def viewpoint_of(
    scene: "Scene",
    camera: str | None,
    camera_path: Path | None,
    export: ExportSettings,
    view: "NamedView | None" = None,
) -> "Camera | CameraPath":
    """Return the camera or path of the options, in the world; else the scene's path, the ego's drive, or an orbit.

    A single still shows a scene without path and drive from the front.
    """
    import numpy as np

    from gsrain_engine.editor.jobs.record import own_path
    from gsrain_engine.editor.viewport.camera import FOV_DEG, front_camera, home_camera
    from gsrain_engine.editor.views import camera_of_view
    from gsrain_engine.scene.camera import Camera, look_at, read_camera
    from gsrain_engine.scene.camera_path_io import read_camera_path
    from gsrain_engine.scene.formats.gltf import GLTF

    check_one_camera(view, camera, camera_path)
    width, height = export.size_px or DEFAULT_SIZE_PX
    if view is not None:
        return camera_of_view(scene, view, width, height)
    if camera is not None and (places := _eye_and_target(camera)) is not None:
        eye, target, up = *places, np.array([0.0, 0.0, 1.0])
        return Camera.from_fov(width, height, FOV_DEG, look_at(eye, target, up))
    if camera is not None and Path(camera).suffix.lower() in GLTF:
        path = read_camera_path(Path(camera), scene).moved(scene.scene_to_world)
        return path.camera(path.start_s, width, height)
    if camera is not None:
        read = read_camera(camera)
        return (read.resized(width, height) if export.size_px else read).moved(scene.scene_to_world)
    if camera_path is not None:
        return read_camera_path(camera_path, scene).moved(scene.scene_to_world)
    if scene.path is not None or not export.is_still or front_camera(scene) is not None:
        return own_path(scene, width, height)
    return home_camera(scene, width, height)


def _eye_and_target(text: str) -> "Float64[np.ndarray, '2 3'] | None":
    """Turn "-8,0,1.5,0,0,1" into the places of a camera and of what it looks at; None for the name of a file."""
    import numpy as np

    if "," not in text or Path(text).exists():
        return None
    try:
        places = np.array(text.split(","), np.float64).reshape(2, 3)
    except ValueError:
        places = np.zeros((2, 3))
    if not np.abs(places).max() < _FARTHEST_M or not np.ptp(places, axis=0).any():
        raise ValueError(
            f"--camera {text}: expected a file, or six numbers with commas: X,Y,Z of the camera and of another point, "
            "which it looks at, such as -8,0,1.5,0,0,1"
        )
    return places


_FARTHEST_M = 1e6  # distance from the origin of a camera that is given by numbers


def _timing(
    scene: "Scene",
    viewpoint: "Camera | CameraPath",
    camera_path: Path | None,
    export: ExportSettings,
    speed: float | None,
) -> "TimedPath | None":
    """Return the timing of a camera path; None for drives, which have their own speed, and for fixed cameras."""
    from gsrain_engine.scene.camera_path import CameraPath

    from .scene import timed_path

    is_path = camera_path is not None or scene.path is not None
    if isinstance(viewpoint, CameraPath) and is_path and not export.cameras:
        return timed_path(viewpoint, speed, is_still=export.is_still)
    if speed is not None:
        raise ValueError(f"--speed {speed:g}: only a camera path has one (--camera-path, or a scene with its own)")
    return None


def _frame_numbers(
    export: ExportSettings, sequences: "Mapping[str, FrameSequence]", duration: float | None, frame: int | None
) -> Sequence[int]:
    """Return the numbers of the chosen frames; raises ValueError for a frame after the end of the path or drive."""
    from gsrain_engine.render.export import frame_numbers
    from gsrain_engine.scene.camera_path import CameraPath

    if frame is None:
        if duration is None or export.is_still:
            return frame_numbers(export, sequences)
        if export.last_s is not None:
            raise ValueError("--duration and --to exclude each other")
        return range(max(1, round(duration * export.fps)))
    lengths = [each.length_s for each in sequences.values()]
    if all(each is not None for each in lengths):
        ends = [export.last_s - export.first_s if export.last_s is not None else None, duration, *lengths]
        count = max(1, round(max(each for each in ends if each is not None) * export.fps))
        loops = any(isinstance(each.camera, CameraPath) and each.camera.loop for each in sequences.values())
        if frame > count and not loops:
            raise ValueError(f"--frame {frame}: there are frames 0 to {count} at {export.fps:g} frames a second")
    return [frame]
