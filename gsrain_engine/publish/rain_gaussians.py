"""Rain as Gaussians in a file, for programs that show Gaussians and know nothing of rain."""

from pathlib import Path

import numpy as np
from jaxtyping import UInt8

from ..backends import open_renderer
from ..rain.settings import RainSettings
from ..rain.simulation import RainSimulation
from ..render.export import export_sequences
from ..render.export_settings import ExportSettings
from ..render.sequence import render_image
from ..render.view import rain_camera
from ..report.result import RunResult
from ..report.table import Table, columns
from ..scene.camera import Camera
from ..scene.camera_path import CameraPath
from ..scene.formats.registry import write_gaussians
from ..scene.gaussians import Gaussians
from ..scene.scene import Scene
from ..scene.transforms import flatten_scene, transform_gaussians, with_wetness_baked, world_to_file


def export_rain_gaussians(
    scene: Scene, rain: RainSettings, viewpoint: Camera | CameraPath, output: Path, still: ExportSettings, *,
    with_scene: bool = False,
) -> RunResult[Path]:  # fmt: skip
    """Write the Gaussians of the rain at one moment, in meters with -y upwards, as scenes are converted.

    They are made for one camera: what it does not see is left out, and haze is of the paper's Gaussians.

    Args:
        scene: Where it rains; its colors are wet as the rain says.
        rain: The rain, without fog, which needs distances.
        viewpoint: Camera, or the path that has one at the time, in the world.
        output: File of a format that can be written, such as .ply.
        still: Time and size of the picture that the streaks are made for.
        with_scene: Write the scene's Gaussians, too, in the same file.

    Raises `ValueError` for a rain with fog, `OSError` when the file can't be written.
    """
    if rain.visibility_m is not None:  # of a preset, or saved with the scene
        raise ValueError(f"fog, visibility {rain.visibility_m:g} m: needs distances; gsrain render draws it")
    simulation = RainSimulation.start(rain.without_medium)  # a file has Gaussians only
    (sequence,) = export_sequences(still, scene, simulation, viewpoint, in_scene_time=scene.path is not None).values()
    shot = sequence.shot(0)
    with open_renderer("cpu") as renderer:
        sky = sequence.sky(renderer)
    wetness, overcast = simulation.soaked_share_at(shot.time_s), simulation.overcast_at(shot.time_s)
    frame = simulation.frame(shot.time_s, rain_camera(scene, simulation, shot), sky.at(overcast))
    found = transform_gaussians(frame.gaussians, world_to_file())
    if with_scene:
        found = Gaussians.concatenate([flatten_scene(with_wetness_baked(scene, wetness, overcast), shot.time_s), found])
    write_gaussians(found, output)
    intensity_mm_h = simulation.state_at(shot.time_s).intensity_mm_h
    numbers = {
        "gaussians": len(found), "streaks": len(frame.streaks), "haze": len(frame.haze), "time_s": shot.time_s,
        "intensity_mm_h": intensity_mm_h,
    }  # fmt: skip
    kinds = f"{len(frame.streaks):,} streak Gaussians and {len(frame.haze):,} haze Gaussians"
    line = f"{output}: {kinds} at {shot.time_s:g} s, {intensity_mm_h:g} mm/h"

    def draw() -> UInt8[np.ndarray, "h w 3"]:
        with open_renderer("cpu") as renderer:
            return render_image(renderer, scene, rain.without_medium, shot.camera, shot.time_s).to_uint8()

    rows = list(numbers.items())
    table = Table(f"Rain in {scene.name}", columns({"number of": "", "value": ",g"}), rows)
    return RunResult(made=output, table=table, numbers=numbers, lines=(line,), draw=draw)
