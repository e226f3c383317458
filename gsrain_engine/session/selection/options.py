"""How a person selects now: what the tools and the panel share."""

from dataclasses import dataclass, field

from ..edits.cropping import CropBox
from .combine import Mode
from .histogram import AttributeHistogram
from .in_picture import Depths, Reach
from .volumes import Ball


@dataclass(slots=True)
class SelectionOptions:
    """Settings of the selection tools; not part of the document."""

    mode: Mode = "set"
    """What a tool does without a key held."""
    depths: Depths = "all through"
    depth_m: float = 20.0
    touching: bool = False
    brush_radius_px: float = 24.0
    tolerance: float = 0.1
    """Of flood and colour pick, 0..1."""
    flood_reach: float = 2.0
    """In spacings of the Gaussians."""
    distance_m: float = 0.1
    """By which to grow and shrink."""
    attribute: str = "opacity"
    range: tuple[float, float] | None = None
    """Of the attribute, in its unit; None until a person has chosen one."""
    set_name: str = ""
    """What the next selection set is to be called; empty: by a number."""
    renamed_set: str = ""
    """Which set is being called otherwise; empty: none."""
    new_name: str = ""
    """What it is to be called."""
    ball: Ball | None = None
    """What the sphere tool has placed and not yet applied."""
    box: CropBox | None = None
    """What the box tool has placed and not yet applied."""
    histogram: AttributeHistogram = field(default_factory=AttributeHistogram)

    @property
    def reach(self) -> Reach:
        """How far shapes of the picture reach."""
        return Reach(self.depths, self.depth_m, self.touching)
