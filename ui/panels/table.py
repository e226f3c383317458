"""The one table of panels, and those of installed packages after them."""

from .calibration_panel import calibration_panel
from .camera_mosaic_panel import camera_mosaic_panel
from .capture_panel import capture_panel
from .disdrometer_panel import disdrometer_panel
from .display_panel import display_panel
from .drive_panel import drive_panel
from .drive_plots import drive_plots
from .edit_panel import edit_panel
from .history_panel import history_panel
from .installed_panels import installed_panels
from .jobs_panel import jobs_panel
from .layers_panel import layers_panel
from .log_panel import log_panel
from .make_rainy_panel import make_rainy_panel
from .panel import Panel
from .rain_panel import rain_panel
from .rain_readout_panel import rain_readout_panel
from .record_panel import record_panel
from .select_panel import select_panel
from .shower_panel import shower_panel
from .statistics_panel import statistics_panel
from .timeline_panel import timeline_panel

PANELS = (
    Panel("Layers", "left", layers_panel),
    Panel("History", "left", history_panel),
    Panel("Statistics", "left", statistics_panel),
    Panel("Edit", "left bottom", edit_panel),
    Panel("Select", "left bottom", select_panel),
    Panel("Rain", "right", rain_panel),
    Panel("Make it rainy", "right", make_rainy_panel),
    Panel("Drive", "right", drive_panel),
    Panel("Capture", "right", capture_panel),
    Panel("Record", "right", record_panel),
    Panel("Display", "right", display_panel),
    Panel("Read-out", "right bottom", rain_readout_panel),
    Panel("Disdrometer", "right bottom", disdrometer_panel),
    Panel("Calibration", "right bottom", calibration_panel),
    Panel("Rig cameras", "right bottom", camera_mosaic_panel),
    Panel("Timeline", "bottom", timeline_panel),
    Panel("Shower", "bottom", shower_panel),
    Panel("Drive plots", "bottom", drive_plots),
    Panel("Jobs", "bottom", jobs_panel),
    Panel("Log", "bottom", log_panel),
)


def all_panels() -> tuple[Panel, ...]:
    """Our panels, then those of installed packages."""
    return (*PANELS, *installed_panels({each.title for each in PANELS}))
