"""Names for programs and extensions, kept for one release: programs import `gsrain` instead.

Importing this imports nothing else: a name is loaded when it is first asked for.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:  # the doubled names say to type checkers that they are for others
    from .appearance.clear_view import ClearView as ClearView
    from .appearance.methods import Method as Method
    from .appearance.transfer import RainyView as RainyView
    from .appearance.transfer import Transfer as Transfer
    from .appearance.transfer_settings import TransferSettings as TransferSettings
    from .appearance.views.choice import ViewChoice as ViewChoice
    from .appearance.views.choice import chosen_cameras as chosen_cameras
    from .appearance.views.scene_views import scene_views as scene_views
    from .appearance.wet.surroundings import Surroundings as Surroundings
    from .backends import open_renderer as open_renderer
    from .datasets.capture import Capture as Capture
    from .datasets.capture import CaptureError as CaptureError
    from .datasets.capture import View as View
    from .datasets.open_capture import CaptureFormat as CaptureFormat
    from .datasets.open_capture import open_capture as open_capture
    from .drive.agents.agent import SPACING_S as SPACING_S
    from .drive.agents.agent import Agent as Agent
    from .drive.agents.agent import Needs as Needs
    from .drive.agents.agent import Plan as Plan
    from .drive.agents.observation import Observation as Observation
    from .drive.agents.observation import Rig as Rig
    from .drive.agents.registry import AgentOptions as AgentOptions
    from .drive.agents.registry import open_agent as open_agent
    from .drive.metrics.comparison import Run as Run
    from .drive.metrics.comparison import compare as compare
    from .drive.metrics.table import results_table as results_table
    from .drive.rollouts.json_lines import read_rollout as read_rollout
    from .drive.rollouts.json_lines import write_rollout as write_rollout
    from .drive.scenario.scenario import Scenario as Scenario
    from .drive.scenario.scenario_files import load_scenario as load_scenario
    from .drive.simulation.drive import drive_through as drive_through
    from .drive.simulation.simulation import Simulation as Simulation
    from .drive.sweeps.jitter import Jitter as Jitter
    from .drive.sweeps.sweep import DriveSweep as DriveSweep
    from .drive.sweeps.sweep import RenderSweep as RenderSweep
    from .drive.sweeps.whole_sweep import finish_sweep as finish_sweep
    from .evaluate.detection.decoders import Candidates as Candidates
    from .evaluate.detection.decoders import Decoder as Decoder
    from .evaluate.detection.decoders import Layout as Layout
    from .evaluate.image_metrics import psnr as psnr
    from .rain.calibration import Calibration as Calibration
    from .rain.calibration import CalibrationRow as CalibrationRow
    from .rain.calibration import load_calibration as load_calibration
    from .rain.calibration import save_calibration as save_calibration
    from .rain.disdrometer.installed_logs import LogFormat as LogFormat
    from .rain.disdrometer.netcdf_spectra import write_spectra as write_spectra
    from .rain.disdrometer.reading import DisdrometerFileError as DisdrometerFileError
    from .rain.disdrometer.reading import Reading as Reading
    from .rain.disdrometer.spectra import DropSpectra as DropSpectra
    from .rain.fitting.calibrate_files import calibrate as calibrate
    from .rain.fitting.plot import write_plot as write_plot
    from .rain.presets import load_preset as load_preset
    from .rain.rain import Rain as Rain
    from .rain.rainfall import Rainfall as Rainfall
    from .rain.virtual_disdrometer import VirtualDisdrometer as VirtualDisdrometer
    from .reconstruct.rainy_scene import rainy_scene as rainy_scene
    from .reconstruct.recoloring.recolor_scene import recolor_scene as recolor_scene
    from .reconstruct.recoloring.recolored_scene import with_colors as with_colors
    from .reconstruct.recoloring.settings import RecolorSettings as RecolorSettings
    from .reconstruct.recoloring.views import TargetView as TargetView
    from .reconstruct.wet_scene import wet_scene as wet_scene
    from .render.film import film as film
    from .render.frame import Frame as Frame
    from .render.pictures import write_picture as write_picture
    from .render.recording import Recording as Recording
    from .render.still import render_still as render_still
    from .scene.camera import Camera as Camera
    from .scene.camera import look_at as look_at
    from .scene.errors import SceneFormatError as SceneFormatError
    from .scene.formats.format import Format as Format
    from .scene.formats.gaussian_files import FORMATS as FORMATS
    from .scene.formats.scene_files import write_scene as write_scene
    from .scene.gaussians import SH_C0 as SH_C0
    from .scene.gaussians import Gaussians as Gaussians
    from .scene.gaussians import sh_from_color as sh_from_color
    from .scene.members import Layer as Layer
    from .scene.open_scene import open_scene as open_scene
    from .scene.paths.camera_path import CameraPath as CameraPath
    from .scene.paths.files import read_camera_path as read_camera_path
    from .scene.paths.files import write_camera_path as write_camera_path
    from .scene.progress import Progress as Progress
    from .scene.progress import finished as finished
    from .scene.scene import Scene as Scene
    from .session.session import Session as Session
    from .session.view.home_camera import home_camera as home_camera

TOPICS: dict[str, dict[str, str]] = {
    "Scenes and cameras": {
        "open_scene": "scene.open_scene",
        "write_scene": "scene.formats.scene_files",
        "Scene": "scene.scene",
        "Layer": "scene.members",
        "Gaussians": "scene.gaussians",
        "sh_from_color": "scene.gaussians",
        "SH_C0": "scene.gaussians",
        "Camera": "scene.camera",
        "look_at": "scene.camera",
        "home_camera": "session.view.home_camera",
        "CameraPath": "scene.paths.camera_path",
        "read_camera_path": "scene.paths.files",
        "write_camera_path": "scene.paths.files",
    },
    "Rain": {
        "Rain": "rain.rain",
        "load_preset": "rain.presets",
        "Rainfall": "rain.rainfall",
        "VirtualDisdrometer": "rain.virtual_disdrometer",
        "write_spectra": "rain.disdrometer.netcdf_spectra",
        "calibrate": "rain.fitting.calibrate_files",
        "Calibration": "rain.calibration",
        "CalibrationRow": "rain.calibration",
        "load_calibration": "rain.calibration",
        "save_calibration": "rain.calibration",
        "write_plot": "rain.fitting.plot",
    },
    "Pictures and films": {
        "open_renderer": "backends",
        "render_still": "render.still",
        "Frame": "render.frame",
        "write_picture": "render.pictures",
        "Recording": "render.recording",
        "film": "render.film",
        "psnr": "evaluate.image_metrics",
    },
    "Wet colours": {
        "wet_scene": "reconstruct.wet_scene",
        "rainy_scene": "reconstruct.rainy_scene",
        "ViewChoice": "appearance.views.choice",
        "chosen_cameras": "appearance.views.choice",
        "scene_views": "appearance.views.scene_views",
        "TargetView": "reconstruct.recoloring.views",
        "RecolorSettings": "reconstruct.recoloring.settings",
        "recolor_scene": "reconstruct.recoloring.recolor_scene",
        "with_colors": "reconstruct.recoloring.recolored_scene",
    },
    "Driving": {
        "Scenario": "drive.scenario.scenario",
        "load_scenario": "drive.scenario.scenario_files",
        "Simulation": "drive.simulation.simulation",
        "open_agent": "drive.agents.registry",
        "drive_through": "drive.simulation.drive",
        "write_rollout": "drive.rollouts.json_lines",
        "read_rollout": "drive.rollouts.json_lines",
        "Run": "drive.metrics.comparison",
        "compare": "drive.metrics.comparison",
        "results_table": "drive.metrics.table",
        "DriveSweep": "drive.sweeps.sweep",
        "RenderSweep": "drive.sweeps.sweep",
        "Jitter": "drive.sweeps.jitter",
        "finish_sweep": "drive.sweeps.whole_sweep",
    },
    "Captures": {
        "open_capture": "datasets.open_capture",
        "Capture": "datasets.capture",
        "View": "datasets.capture",
    },
    "Long work": {
        "Progress": "scene.progress",
        "finished": "scene.progress",
    },
    "For extensions": {
        "Agent": "drive.agents.agent",
        "AgentOptions": "drive.agents.registry",
        "Needs": "drive.agents.agent",
        "Plan": "drive.agents.agent",
        "SPACING_S": "drive.agents.agent",
        "Observation": "drive.agents.observation",
        "Rig": "drive.agents.observation",
        "Format": "scene.formats.format",
        "FORMATS": "scene.formats.gaussian_files",
        "SceneFormatError": "scene.errors",
        "Method": "appearance.methods",
        "Transfer": "appearance.transfer",
        "TransferSettings": "appearance.transfer_settings",
        "Surroundings": "appearance.wet.surroundings",
        "ClearView": "appearance.clear_view",
        "RainyView": "appearance.transfer",
        "Decoder": "evaluate.detection.decoders",
        "Layout": "evaluate.detection.decoders",
        "Candidates": "evaluate.detection.decoders",
        "LogFormat": "rain.disdrometer.installed_logs",
        "Reading": "rain.disdrometer.reading",
        "DropSpectra": "rain.disdrometer.spectra",
        "DisdrometerFileError": "rain.disdrometer.reading",
        "CaptureFormat": "datasets.open_capture",
        "CaptureError": "datasets.capture",
        "Session": "session.session",
    },
}
"""Where each name is at present. Type checkers read the imports above; a test holds the two equal."""

_PLACES = {name: place for topic in TOPICS.values() for name, place in topic.items()}


def __getattr__(name: str) -> Any:
    if name not in _PLACES:
        raise AttributeError(f"gsrain_engine.api has no {name!r}")
    found = globals()[name] = getattr(import_module(f"gsrain_engine.{_PLACES[name]}"), name)
    return found


def __dir__() -> list[str]:
    return sorted(_PLACES)
