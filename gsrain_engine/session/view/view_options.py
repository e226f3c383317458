"""How the viewport shows things; not part of the document."""

from dataclasses import dataclass
from typing import Literal

from gsrain_engine.render.frame import Color
from gsrain_engine.render.gpu_arrays import Harmonics
from gsrain_engine.render.look import Look

Split = Literal["off", "clear | rainy", "before | after", "now | preview"]
"""before: the document before the last step of its history; preview: one view as a transfer makes it."""


@dataclass(slots=True)
class ViewOptions:
    """What a person has chosen."""

    show_streak_region: bool = False
    show_haze_region: bool = False
    background: Color = (0.0, 0.0, 0.0)
    gain_ev: float = 0.0
    """Brightens or darkens the display only."""
    shrink: int = 1
    """Draw every so many-th pixel in each direction; the rain keeps the drops of the full picture."""
    beyond_calibration: bool = False
    """Let the intensity slider go on to 100 mm/h."""
    follow_path: bool = False
    """Ride along the camera path instead of flying by hand."""
    look: Look = "splats"
    split: Split = "off"
    """Which two pictures stand side by side."""
    divider: float = 0.5
    """Where the left one ends, as a share of the width."""
    harmonics: Harmonics = "half"
    """How colours lie on the GPU."""
    show_selection: bool = True
    """Tint what is selected."""
    dialog: str = ""
    """Which of the window's own pages is open: commands, keys or about."""
    member: str = ""
    """Key of the layer or actor that edits are about; empty or of one that is gone: none."""
    tool: str = ""
    """Name of the viewport's tool; none is plain navigation."""
