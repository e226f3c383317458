"""Settings of an evaluation of detectors, for the command line and Python."""

from typing import Annotated

from msgspec import Meta

from ...appearance.view_choice import ViewChoice
from ...rain.settings import HEAVIEST_MM_H
from ...settings import Settings

_COMMANDS = "evaluate detection"
_MomentS = Annotated[float, Meta(ge=-1e9, le=1e9)]


class DetectionSettings(Settings, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Conditions and views of an evaluation."""

    intensities_mm_h: Annotated[
        tuple[Annotated[float, Meta(ge=0, le=HEAVIEST_MM_H)], ...],
        Meta(min_length=1, title="Intensities", description="Rainfall intensities; 0 is always included.",
             extra={"unit": "mm/h", "option": "rain intensity", "commands": _COMMANDS}),
    ] = (0.0, 1.2, 8.5, 12.0)  # fmt: skip
    diameter_scales: Annotated[
        tuple[Annotated[float, Meta(ge=0.25, le=4)], ...],
        Meta(title="Drop sizes", description="Factors of all drop diameters, which are compared at equal mm/h.",
             extra={"option": "diameter-scale", "commands": _COMMANDS}),
    ] = ()  # fmt: skip
    seeds: Annotated[
        int,
        Meta(ge=1, le=1000, title="Seeds", description="Number of rains of each intensity: seeds 0 to N-1.",
             extra={"commands": _COMMANDS}),
    ] = 5  # fmt: skip
    attribute: Annotated[
        tuple[str, ...],
        Meta(title="Factors", description="Share of each part of the rain in its effect: all that it has, or those of "
             "a list, of which it then consists, such as streaks,wet (docs/guide/attribution.md).",
             extra={"commands": _COMMANDS}),
    ] = ()  # fmt: skip
    frames: Annotated[
        int,
        Meta(ge=1, le=10_000, title="Frames", description="Number of moments of the drive; of a capture, images of "
             "each camera.", extra={"topic": "Views", "commands": _COMMANDS}),
    ] = 4  # fmt: skip
    first_s: Annotated[
        _MomentS | None,
        Meta(title="From", description="First moment, in scene time.",
             extra={"unit": "s", "option": "from", "topic": "Views", "commands": _COMMANDS}),
    ] = None  # fmt: skip
    last_s: Annotated[
        _MomentS | None,
        Meta(title="To", description="Last moment, in scene time.",
             extra={"unit": "s", "option": "to", "topic": "Views", "commands": _COMMANDS}),
    ] = None  # fmt: skip
    cameras: ViewChoice = ViewChoice(width_px=960)
    """Names and width of the cameras; its number and source of views have no effect."""

    def __post_init__(self) -> None:
        from ..attribution.factors import is_attributed  # renderers, which the help of commands does without

        super().__post_init__()
        is_attributed(self.attribute)
        if self.first_s is not None and self.last_s is not None and not self.first_s < self.last_s:
            raise ValueError(f"first_s {self.first_s:g} last_s {self.last_s:g}: the second must be later")
        if self.cameras.width_px is not None and self.cameras.width_px < 64:
            raise ValueError(f"width_px {self.cameras.width_px}: must be 64 or more")
