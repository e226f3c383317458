"""Old import path of the Python API, kept for one release: programs import `gsrain` instead.

Names load on first access, so that importing this module is cheap.
"""

# pyright: reportUnusedImport=false
# ruff: noqa: F401
from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .appearance.base import ClearView as ClearView
    from .appearance.base import RainyView as RainyView
    from .appearance.base import Transfer as Transfer
    from .appearance.base import TransferSettings as TransferSettings
    from .appearance.registry import TransferMethod as Method
    from .appearance.registry import TransferMethod as TransferMethod
    from .appearance.scene_views import ViewChoice as ViewChoice
    from .appearance.scene_views import chosen_cameras as chosen_cameras
    from .appearance.scene_views import scene_views as scene_views
    from .appearance.wet_look.environment import ReflectionEnvironment as ReflectionEnvironment
    from .appearance.wet_look.environment import ReflectionEnvironment as Surroundings
    from .backends import open_renderer as open_renderer
    from .datasets.capture import Capture as Capture
    from .datasets.capture import CaptureError as CaptureError
    from .datasets.capture import CaptureFrame as CaptureFrame
    from .datasets.capture import CaptureFrame as View
    from .datasets.open_capture import CaptureFormat as CaptureFormat
    from .datasets.open_capture import open_capture as open_capture
    from .disdrometer.fit import calibrate as calibrate
    from .disdrometer.fit_plot import write_plot as write_plot
    from .disdrometer.netcdf import write_spectra as write_spectra
    from .disdrometer.open import LogFormat as LogFormat
    from .disdrometer.spectra import DisdrometerFileError as DisdrometerFileError
    from .disdrometer.spectra import DisdrometerReading as DisdrometerReading
    from .disdrometer.spectra import DisdrometerReading as Reading
    from .disdrometer.spectra import DropSpectra as DropSpectra
    from .disdrometer.virtual import VirtualDisdrometer as VirtualDisdrometer
    from .editor.editor import Editor as Editor
    from .editor.editor import Editor as Session
    from .editor.viewport.camera import home_camera as home_camera
    from .evaluation.detection.decoders import BoxCandidates as BoxCandidates
    from .evaluation.detection.decoders import BoxCandidates as Candidates
    from .evaluation.detection.decoders import Decoder as Decoder
    from .evaluation.detection.decoders import DecoderInput as DecoderInput
    from .evaluation.detection.decoders import DecoderInput as Layout
    from .evaluation.image_metrics import psnr as psnr
    from .rain.calibration import Calibration as Calibration
    from .rain.calibration import CalibrationRow as CalibrationRow
    from .rain.calibration import load_calibration as load_calibration
    from .rain.calibration import save_calibration as save_calibration
    from .rain.settings import RainSettings as Rain
    from .rain.settings import RainSettings as RainSettings
    from .rain.settings import load_preset as load_preset
    from .rain.simulation import RainSimulation as RainSimulation
    from .rain.simulation import RainSimulation as Rainfall
    from .recolor.problem import RecolorSettings as RecolorSettings
    from .recolor.recolor import rainy_scene as rainy_scene
    from .recolor.recolor import recolor_scene as recolor_scene
    from .recolor.recolor import wet_scene as wet_scene
    from .recolor.result import with_colors as with_colors
    from .recolor.views import TargetView as TargetView
    from .render.export import render_video as film
    from .render.export import render_video as render_video
    from .render.export_settings import ExportSettings as ExportSettings
    from .render.export_settings import ExportSettings as Recording
    from .render.images import write_png as write_picture
    from .render.images import write_png as write_png
    from .render.renderer import Frame as Frame
    from .render.sequence import render_image as render_image
    from .render.sequence import render_image as render_still
    from .scene.camera import Camera as Camera
    from .scene.camera import look_at as look_at
    from .scene.camera_path import CameraPath as CameraPath
    from .scene.camera_path_io import read_camera_path as read_camera_path
    from .scene.camera_path_io import write_camera_path as write_camera_path
    from .scene.files import SceneFormatError as SceneFormatError
    from .scene.formats._common import Format as Format
    from .scene.formats.registry import FORMATS as FORMATS
    from .scene.formats.scene_files import write_scene as write_scene
    from .scene.gaussians import SH_C0 as SH_C0
    from .scene.gaussians import Gaussians as Gaussians
    from .scene.gaussians import sh_from_color as sh_from_color
    from .scene.open import load_scene as load_scene
    from .scene.open import load_scene as open_scene
    from .scene.progress import Progress as Progress
    from .scene.progress import run_to_end as finished
    from .scene.progress import run_to_end as run_to_end
    from .scene.scene import Layer as Layer
    from .scene.scene import Scene as Scene
    from .simulation.agents.base import SPACING_S as SPACING_S
    from .simulation.agents.base import Agent as Agent
    from .simulation.agents.base import Observation as Observation
    from .simulation.agents.base import Rig as Rig
    from .simulation.agents.base import SensorRequirements as Needs
    from .simulation.agents.base import SensorRequirements as SensorRequirements
    from .simulation.agents.base import Trajectory as Plan
    from .simulation.agents.base import Trajectory as Trajectory
    from .simulation.agents.registry import AgentOptions as AgentOptions
    from .simulation.agents.registry import open_agent as open_agent
    from .simulation.metrics.summary import ScoredRun as Run
    from .simulation.metrics.summary import ScoredRun as ScoredRun
    from .simulation.metrics.summary import compare_drives as compare
    from .simulation.metrics.summary import compare_drives as compare_drives
    from .simulation.metrics.summary import results_table as results_table
    from .simulation.rollout_io import read_rollout as read_rollout
    from .simulation.rollout_io import write_rollout as write_rollout
    from .simulation.scenario import Scenario as Scenario
    from .simulation.scenario_io import load_scenario as load_scenario
    from .simulation.simulation import Simulation as Simulation
    from .simulation.simulation import run_drive as drive_through
    from .simulation.simulation import run_drive as run_drive
    from .sweep.run import run_sweep_and_report as finish_sweep
    from .sweep.run import run_sweep_and_report as run_sweep_and_report
    from .sweep.settings import DriveSweep as DriveSweep
    from .sweep.settings import Jitter as Jitter
    from .sweep.settings import RenderSweep as RenderSweep

TOPICS: dict[str, dict[str, str]] = {
    "Scenes and cameras": {
        "load_scene": "scene.open",
        "write_scene": "scene.formats.scene_files",
        "Scene": "scene.scene",
        "Layer": "scene.scene",
        "Gaussians": "scene.gaussians",
        "sh_from_color": "scene.gaussians",
        "SH_C0": "scene.gaussians",
        "Camera": "scene.camera",
        "look_at": "scene.camera",
        "home_camera": "editor.viewport.camera",
        "CameraPath": "scene.camera_path",
        "read_camera_path": "scene.camera_path_io",
        "write_camera_path": "scene.camera_path_io",
    },
    "RainSettings": {
        "RainSettings": "rain.settings",
        "load_preset": "rain.settings",
        "RainSimulation": "rain.simulation",
        "VirtualDisdrometer": "disdrometer.virtual",
        "write_spectra": "disdrometer.netcdf",
        "calibrate": "disdrometer.fit",
        "Calibration": "rain.calibration",
        "CalibrationRow": "rain.calibration",
        "load_calibration": "rain.calibration",
        "save_calibration": "rain.calibration",
        "write_plot": "disdrometer.fit_plot",
    },
    "Pictures and films": {
        "open_renderer": "backends",
        "render_image": "render.sequence",
        "Frame": "render.renderer",
        "write_png": "render.images",
        "ExportSettings": "render.export_settings",
        "render_video": "render.export",
        "psnr": "evaluation.image_metrics",
    },
    "Wet colours": {
        "wet_scene": "recolor.recolor",
        "rainy_scene": "recolor.recolor",
        "ViewChoice": "appearance.scene_views",
        "chosen_cameras": "appearance.scene_views",
        "scene_views": "appearance.scene_views",
        "TargetView": "recolor.views",
        "RecolorSettings": "recolor.problem",
        "recolor_scene": "recolor.recolor",
        "with_colors": "recolor.result",
    },
    "Driving": {
        "Scenario": "simulation.scenario",
        "load_scenario": "simulation.scenario_io",
        "Simulation": "simulation.simulation",
        "open_agent": "simulation.agents.registry",
        "run_drive": "simulation.simulation",
        "write_rollout": "simulation.rollout_io",
        "read_rollout": "simulation.rollout_io",
        "ScoredRun": "simulation.metrics.summary",
        "compare_drives": "simulation.metrics.summary",
        "results_table": "simulation.metrics.summary",
        "DriveSweep": "sweep.settings",
        "RenderSweep": "sweep.settings",
        "Jitter": "sweep.settings",
        "run_sweep_and_report": "sweep.run",
    },
    "Captures": {
        "open_capture": "datasets.open_capture",
        "Capture": "datasets.capture",
        "CaptureFrame": "datasets.capture",
    },
    "Long work": {
        "Progress": "scene.progress",
        "run_to_end": "scene.progress",
    },
    "For extensions": {
        "Agent": "simulation.agents.base",
        "AgentOptions": "simulation.agents.registry",
        "SensorRequirements": "simulation.agents.base",
        "Trajectory": "simulation.agents.base",
        "SPACING_S": "simulation.agents.base",
        "Observation": "simulation.agents.base",
        "Rig": "simulation.agents.base",
        "Format": "scene.formats._common",
        "FORMATS": "scene.formats.registry",
        "SceneFormatError": "scene.files",
        "TransferMethod": "appearance.registry",
        "Transfer": "appearance.base",
        "TransferSettings": "appearance.base",
        "ReflectionEnvironment": "appearance.wet_look.environment",
        "ClearView": "appearance.base",
        "RainyView": "appearance.base",
        "Decoder": "evaluation.detection.decoders",
        "DecoderInput": "evaluation.detection.decoders",
        "BoxCandidates": "evaluation.detection.decoders",
        "LogFormat": "disdrometer.open",
        "DisdrometerReading": "disdrometer.spectra",
        "DropSpectra": "disdrometer.spectra",
        "DisdrometerFileError": "disdrometer.spectra",
        "CaptureFormat": "datasets.open_capture",
        "CaptureError": "datasets.capture",
        "Editor": "editor.editor",
    },
}
"""Module of each name. Type checkers read the imports above; a test compares the two lists."""

_PLACES = {name: place for topic in TOPICS.values() for name, place in topic.items()}


_RENAMED = {  # names of version 0.1
    "Candidates": "BoxCandidates",
    "Layout": "DecoderInput",
    "Method": "TransferMethod",
    "Needs": "SensorRequirements",
    "Plan": "Trajectory",
    "Rain": "RainSettings",
    "Rainfall": "RainSimulation",
    "Reading": "DisdrometerReading",
    "Recording": "ExportSettings",
    "Run": "ScoredRun",
    "Session": "Editor",
    "Surroundings": "ReflectionEnvironment",
    "View": "CaptureFrame",
    "compare": "compare_drives",
    "drive_through": "run_drive",
    "film": "render_video",
    "finish_sweep": "run_sweep_and_report",
    "finished": "run_to_end",
    "open_scene": "load_scene",
    "render_still": "render_image",
    "write_picture": "write_png",
}


def __getattr__(name: str) -> Any:
    present = _RENAMED.get(name, name)
    if present not in _PLACES:
        raise AttributeError(f"gsrain_engine.api has no {name!r}")
    found = globals()[name] = getattr(import_module(f"gsrain_engine.{_PLACES[present]}"), present)
    return found


def __dir__() -> list[str]:
    return sorted(_PLACES)
