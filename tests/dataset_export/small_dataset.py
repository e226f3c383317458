"""Data sets of small sources, which take a second."""

from dataclasses import replace

import msgspec

from boxy_scene import boxy_scene
from gsrain_engine.dataset_export.registry import LAYOUTS
from gsrain_engine.dataset_export.scenes import SceneSource
from gsrain_engine.dataset_export.session import export_dataset
from gsrain_engine.dataset_export.source import DatasetChoice
from gsrain_engine.evaluation.lidar.sensor import SENSORS
from gsrain_engine.rain.settings import RainSettings
from gsrain_engine.render.cpu.renderer import CpuRenderer
from gsrain_engine.scene.progress import run_to_end
from simulation.small_drive import scene_with_box

COARSE = msgspec.structs.replace(SENSORS["32"], azimuth_step_deg=2.0)


def two_cars():
    """Two cars in sight, of which the near one hides half of the far one, on a road."""
    return replace(boxy_scene(), layers=scene_with_box().layers)


def small_source(scene=None, **options):
    choice = {"rate_hz": 1, "moments": 2, "width_px": 160, "sensor": COARSE} | options
    return SceneSource(scene or two_cars(), DatasetChoice(**choice))


def rains(*intensities_mm_h):
    return [RainSettings(intensity_mm_h=each) for each in intensities_mm_h]


def steps_of(folder, layout, *intensities_mm_h, source=None):
    chosen = rains(*(intensities_mm_h or (0, 50)))
    return export_dataset(CpuRenderer(), source or small_source(), folder, chosen, LAYOUTS[layout])


def write_dataset(folder, layout, *intensities_mm_h, source=None):
    return run_to_end(steps_of(folder, layout, *intensities_mm_h, source=source))


def contents(folder):
    return {str(file.relative_to(folder)): file.read_bytes() for file in folder.rglob("*") if file.is_file()}
