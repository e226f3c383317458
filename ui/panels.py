"""The one table of panels: title, where it docks, and the function of the session that draws it."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

from gsrain_engine.session.session import Session

from .calibration_panel import calibration_panel
from .disdrometer_panel import disdrometer_panel
from .jobs_panel import jobs_panel
from .log_panel import log_panel
from .rain_panel import rain_panel
from .rain_readout_panel import rain_readout_panel
from .scene_panel import scene_panel
from .statistics_panel import statistics_panel

DockSide = Literal["right", "right bottom"]


@dataclass(frozen=True)
class Panel:
    """A panel beside the viewport."""

    title: str
    side: DockSide
    draw: Callable[[Session], None]


PANELS = (
    Panel("Rain", "right", rain_panel),
    Panel("Scene", "right", scene_panel),
    Panel("Calibration", "right", calibration_panel),
    Panel("Read-out", "right bottom", rain_readout_panel),
    Panel("Disdrometer", "right bottom", disdrometer_panel),
    Panel("Jobs", "right bottom", jobs_panel),
    Panel("Statistics", "right bottom", statistics_panel),
    Panel("Log", "right bottom", log_panel),
)
