"""`gsrain dataset SOURCE -o DIR`: a labeled data set in several rains."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import msgspec

from gsrain_engine.choices import Backend
from gsrain_engine.evaluation.lidar.settings import SENSOR_NAMES
from gsrain_engine.rain.settings import RainSettings, load_preset
from gsrain_engine.safe_io.errors import convert_checked

from .console import print, run_with_progress
from .options import (
    BACKEND,
    JsonFile,
    Preset,
    StructOptions,
    Wet,
    check_within,
    named_options,
    option,
    options_of,
    parse_intensities,
    setting,
    split_words,
    takes_set,
)
from .outputs import claim_outputs, write_numbers

if TYPE_CHECKING:
    from gsrain_engine.dataset_export.source import DatasetChoice
    from gsrain_engine.datasets.capture import Capture
    from gsrain_engine.rain.available import Source
    from gsrain_engine.scene.scene import Scene
    from gsrain_engine.simulation.scenario import Scenario

RainOptions = options_of(RainSettings, "drive", "", topic="Rain", fixed={"intensity_mm_h": "--rain"})


@takes_set
def dataset(
    source: Annotated[str, option('Scene, "street", a recording, or a scenario (a shipped one, or a file).')],
    /,
    *,
    output: Annotated[Path, option("Folder to write, or to go on with.", "--output", "-o", topic="Output")],
    rain: Annotated[
        str, setting(RainSettings, "intensity_mm_h", "Several with commas. Default: 0,2.5,8.5,25.", "Rain")
    ] = "0,2.5,8.5,25",
    layout: Annotated[
        Literal["nuscenes", "kitti", "coco"],
        option("nuscenes: samples and tables; kitti: image_2, velodyne, calib, label_2; coco: images, one JSON file."),
    ] = "nuscenes",
    cameras: Annotated[
        str, option("Cameras with commas, of a scene also its rigs. Default: the first rig, of a recording all.")
    ] = "",
    rate: Annotated[float | None, option("Moments per second. Default: 2, of a recording all.")] = None,
    moments: Annotated[int | None, option("At most so many moments, from the first.")] = None,
    width: Annotated[int | None, option("Width of the pictures in pixels. Default: the cameras' own.")] = None,
    lidar_sensor: Annotated[
        str | None,
        option(
            f"Lidar on the roof, or of the recording: {', '.join(SENSOR_NAMES)} (beams, or nm), a YAML file, or none. "
            "Default: 64."
        ),
    ] = None,
    weather: RainOptions | None = None,
    preset: Preset = None,
    wet: Wet = None,
    backend: Annotated[Backend, BACKEND] = "auto",
    json: JsonFile = None,
) -> None:
    """Write a labeled data set in several rains. Run again, it resumes: pictures that are there stay.

    DIR/rain_8.5 has the pictures and lidar turns of all moments and cameras, and all that readers of the layout
    expect; DIR/labels what rain doesn't change, once: 3D and 2D boxes, instance masks, depth, ego poses. More
    intensities can be added later. A scenario is driven once, by oracle-idm in its own rain: all rains show one drive.
    """
    from gsrain_engine.backends import open_renderer
    from gsrain_engine.dataset_export.open import dataset_source, input_hashes, open_dataset_input
    from gsrain_engine.dataset_export.registry import LAYOUTS
    from gsrain_engine.dataset_export.session import export_dataset
    from gsrain_engine.datasets.capture import Capture
    from gsrain_engine.scene.open import load_sorted_scene
    from gsrain_engine.scene.scene import Scene
    from gsrain_engine.simulation.scenario import Scenario

    form, intensities = LAYOUTS[layout], parse_intensities(rain)
    choice = _choice(cameras, rate, moments, width, lidar_sensor if form.has_lidar else "none")
    if lidar_sensor not in (None, "none") and not form.has_lidar:
        raise ValueError(f"--lidar-sensor {lidar_sensor}: the layout {layout} has no lidar")
    claim_outputs(json, folders=[output])
    opened = open_dataset_input(source)
    scene = load_sorted_scene(opened.scene) if isinstance(opened, Scenario) else opened
    is_capture = isinstance(scene, Capture)
    if is_capture and wet:
        raise ValueError("--wet: photographs have no surfaces for it; gsrain reconstruct makes a scene of them")
    if is_capture and backend not in ("auto", "cpu"):
        raise ValueError(f"--backend {backend}: rain over photographs is drawn by the processor")
    rains = _rains(opened, intensities, preset, weather or RainOptions(), "photographs" if is_capture else "scene")
    if isinstance(scene, Scene):
        from gsrain_engine.rain.wetness import with_wet_choice

        from .render import rainy_light

        heaviest = rains[-1].intensity_mm_h
        scene, _ = rainy_light(scene, rains[-1], wet, heaviest)
        rains = [with_wet_choice(each, wet, heaviest) for each in rains]
        opened = scene if isinstance(opened, Scene) else opened
    with named_options(RainSettings, "output", "cameras"), open_renderer("cpu" if is_capture else backend) as renderer:
        place = scene if isinstance(scene, Scene) else None
        facts = {"inputs": input_hashes(source, opened), "wet": wet}
        made_of = dataset_source(opened, choice, place, facts)
        if lidar_sensor not in (None, "none") and not made_of.has_lidar:
            raise ValueError(
                f"--lidar-sensor {lidar_sensor}: {made_of.kind} {made_of.name} has no lidar, or no vehicle"
            )
        try:
            done = run_with_progress(export_dataset(renderer, made_of, output, rains, form))
        except KeyboardInterrupt:
            print("stopped; the same command goes on from there", file=sys.stderr)
            raise
    for line in done.lines:
        print(line)
    write_numbers(json, done.numbers)


def _choice(
    cameras: str, rate: float | None, moments: int | None, width: int | None, sensor: str | None
) -> "DatasetChoice":
    from gsrain_engine.dataset_export.source import DatasetChoice
    from gsrain_engine.evaluation.lidar.session import open_sensor

    check_within("--rate", rate, 0, 1000, "Hz", is_open=True)
    check_within("--moments", moments, 1, 1_000_000)
    check_within("--width", width, 16, 16384, "px")
    try:
        lidar = None if sensor == "none" else open_sensor(sensor or "64")
    except ValueError as error:
        raise ValueError(f"--lidar-sensor: {error}") from None
    names = tuple(split_words(cameras))
    return DatasetChoice(cameras=names, rate_hz=rate, moments=moments, width_px=width, sensor=lidar)


def _rains(
    opened: "Scene | Capture | Scenario",
    intensities: list[float],
    preset: str | None,
    options: StructOptions,
    kind: "Source",
) -> list[RainSettings]:
    """Return the rains in order of intensity: the preset's, else the scenario's or the scene's own."""
    from gsrain_engine.rain.available import check_available
    from gsrain_engine.rain.calibration import load_calibration
    from gsrain_engine.rain.keyframes import saved_rain
    from gsrain_engine.scene.scene import Scene
    from gsrain_engine.simulation.scenario import Scenario

    saved = saved_rain(opened) if isinstance(opened, Scene) else None
    own = RainSettings() if saved is None else convert_checked(saved, RainSettings)
    own = opened.rain if isinstance(opened, Scenario) else own
    base = own if preset is None else msgspec.structs.replace(load_preset(preset), seed=own.seed)
    rains: list[RainSettings] = [options.settings(base, intensity_mm_h=each) for each in intensities]
    check_available(options.changes(), rains[0], kind)
    load_calibration(rains[0].calibration)  # before anything is drawn
    return rains
