"""What a person wants to drive: who, in which rain, from which seed. The scenario stands beside it."""

from pathlib import Path
from typing import Annotated, Literal

import msgspec
from msgspec import Meta

from gsrain_engine.drive.agents.registry import AgentOptions
from gsrain_engine.rain.rain import Rain

RainSource = Literal["as the scene", "one intensity", "paper's four"]
PAPER_MM_H = (0.0, 1.2, 8.5, 12.0)
"""Intensities of the paper's closed-loop tables."""


class DriveWishes(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """All but the scenario. A scenario's own rain is not used: the window drives in the rain that it shows."""

    agent: Annotated[str, Meta(title="Agent", description="Who drives.")]
    detector: Annotated[
        Path | None,
        Meta(title="Detector", description="ONNX file of an object detector, for agents that look at pictures."),
    ] = None
    description: Annotated[
        str | None,
        Meta(title="Its description", description="How the detector is used: a shipped name such as yolox, or a YAML."),
    ] = None
    url: Annotated[
        str | None, Meta(title="Address", description="Where an agent listens that runs elsewhere, such as http.")
    ] = None
    rain: Annotated[
        RainSource,
        Meta(
            title="Rain",
            description="The scene's rain as it is now; the same with another intensity; or one drive at each of the "
            "paper's 0, 1.2, 8.5 and 12 mm/h.",
        ),
    ] = "as the scene"
    intensity_mm_h: Annotated[
        float, Meta(ge=0, le=100, title="Intensity", description="R of this drive.", extra={"unit": "mm/h"})
    ] = 8.5
    seed: Annotated[
        int, Meta(ge=0, le=2**31 - 1, title="Seed", description="Same seed: same drops and the same drive.")
    ] = 0

    @property
    def options(self) -> AgentOptions:
        return AgentOptions(detector=self.detector, description=self.description, url=self.url)

    def rains(self, present: Rain) -> tuple[Rain, ...]:
        """Return the rain of each drive; `present` is the scene's."""
        if self.rain == "as the scene":
            return (present,)
        chosen = PAPER_MM_H if self.rain == "paper's four" else (self.intensity_mm_h,)
        return tuple(msgspec.structs.replace(present, intensity_mm_h=each) for each in chosen)
