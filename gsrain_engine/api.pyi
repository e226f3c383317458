# The names of `gsrain_engine.api`: type checkers read this list, and so does the module when it runs.
from .appearance.base import ClearView as ClearView
from .appearance.base import RainyView as RainyView
from .appearance.base import Transfer as Transfer
from .appearance.base import TransferSettings as TransferSettings
from .appearance.registry import TransferMethod as TransferMethod
from .appearance.scene_views import ViewChoice as ViewChoice
from .appearance.scene_views import chosen_cameras as chosen_cameras
from .appearance.scene_views import scene_views as scene_views
from .appearance.wet_look.environment import ReflectionEnvironment as ReflectionEnvironment
from .backends import open_renderer as open_renderer
from .datasets.capture import Capture as Capture
from .datasets.capture import CaptureError as CaptureError
from .datasets.capture import CaptureFrame as CaptureFrame
from .datasets.open_capture import CaptureFormat as CaptureFormat
from .datasets.open_capture import open_capture as open_capture
from .disdrometer.fit import calibrate as calibrate
from .disdrometer.fit_plot import write_plot as write_plot
from .disdrometer.netcdf import write_spectra as write_spectra
from .disdrometer.open import LogFormat as LogFormat
from .disdrometer.spectra import DisdrometerFileError as DisdrometerFileError
from .disdrometer.spectra import DisdrometerReading as DisdrometerReading
from .disdrometer.spectra import DropSpectra as DropSpectra
from .disdrometer.virtual import VirtualDisdrometer as VirtualDisdrometer
from .editor.editor import Editor as Editor
from .editor.viewport.camera import home_camera as home_camera
from .evaluation.detection.decoders import BoxCandidates as BoxCandidates
from .evaluation.detection.decoders import Decoder as Decoder
from .evaluation.detection.decoders import DecoderInput as DecoderInput
from .evaluation.image_metrics import psnr as psnr
from .rain.calibration import Calibration as Calibration
from .rain.calibration import CalibrationRow as CalibrationRow
from .rain.calibration import load_calibration as load_calibration
from .rain.calibration import save_calibration as save_calibration
from .rain.settings import RainSettings as RainSettings
from .rain.settings import load_preset as load_preset
from .rain.simulation import RainSimulation as RainSimulation
from .recolor.problem import RecolorSettings as RecolorSettings
from .recolor.recolor import rainy_scene as rainy_scene
from .recolor.recolor import recolor_scene as recolor_scene
from .recolor.recolor import wet_scene as wet_scene
from .recolor.result import with_colors as with_colors
from .recolor.views import TargetView as TargetView
from .render.export import render_video as render_video
from .render.export_settings import ExportSettings as ExportSettings
from .render.images import write_png as write_png
from .render.renderer import Frame as Frame
from .render.sequence import render_image as render_image
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
from .scene.progress import Progress as Progress
from .scene.progress import run_to_end as run_to_end
from .scene.scene import Layer as Layer
from .scene.scene import Scene as Scene
from .simulation.agents.base import SPACING_S as SPACING_S
from .simulation.agents.base import Agent as Agent
from .simulation.agents.base import Observation as Observation
from .simulation.agents.base import Rig as Rig
from .simulation.agents.base import SensorRequirements as SensorRequirements
from .simulation.agents.base import Trajectory as Trajectory
from .simulation.agents.registry import AgentOptions as AgentOptions
from .simulation.agents.registry import open_agent as open_agent
from .simulation.metrics.summary import ScoredRun as ScoredRun
from .simulation.metrics.summary import compare_drives as compare_drives
from .simulation.metrics.summary import results_table as results_table
from .simulation.rollout_io import read_rollout as read_rollout
from .simulation.rollout_io import write_rollout as write_rollout
from .simulation.scenario import Scenario as Scenario
from .simulation.scenario_io import load_scenario as load_scenario
from .simulation.simulation import Simulation as Simulation
from .simulation.simulation import run_drive as run_drive
from .sweep.run import run_sweep_and_report as run_sweep_and_report
from .sweep.settings import DriveSweep as DriveSweep
from .sweep.settings import Jitter as Jitter
from .sweep.settings import RenderSweep as RenderSweep

# Names of version 0.1
Candidates = BoxCandidates
Layout = DecoderInput
Method = TransferMethod
Needs = SensorRequirements
Plan = Trajectory
Rain = RainSettings
Rainfall = RainSimulation
Reading = DisdrometerReading
Recording = ExportSettings
Run = ScoredRun
Session = Editor
Surroundings = ReflectionEnvironment
View = CaptureFrame
compare = compare_drives
drive_through = run_drive
film = render_video
finish_sweep = run_sweep_and_report
finished = run_to_end
open_scene = load_scene
render_still = render_image
write_picture = write_png
