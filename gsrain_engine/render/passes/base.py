"""A pass of a picture, and the parts that passes add to it."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol, runtime_checkable

import numpy as np
from jaxtyping import UInt8

from ...rain.frame import RainFrame
from ...rain.settings import RainSettings
from ...scene.scene import DrawItem
from ...water.mirror import LensMirror, Mirror
from ...water.rings import RingWaves
from ..frame_input import FrameInput
from ..renderer import DrawnPicture, Frame, PictureFilter, Renderer
from ..still_scene import StillScene


@dataclass(slots=True, eq=False)
class FrameParts:
    """Parts that the passes of a picture have added: the renderer draws it as one depth-ordered compositing."""

    renderer: Renderer
    draw: Callable[[FrameInput], DrawnPicture]
    """Draws another picture by the same renderer, such as what a mirror shows."""
    items: list[DrawItem] = field(default_factory=list[DrawItem])
    whole: list[DrawItem] = field(default_factory=list[DrawItem])
    """The scene's items with all their Gaussians, for mirrors."""
    behind: list[DrawItem] = field(default_factory=list[DrawItem])
    """Items of the whole scene that stand still, where they are drawn once."""
    moving: list[DrawItem] = field(default_factory=list[DrawItem])
    """The other items of the whole scene."""
    still: StillScene | None = None
    rain: RainFrame | None = None
    waves: RingWaves | None = None
    mirror: Mirror | LensMirror | None = None
    filters: list[PictureFilter] = field(default_factory=list[PictureFilter])
    """Effects on the drawn picture, in this order."""
    compose: Callable[[Frame], UInt8[np.ndarray, "h w 3"]] | None = None
    """Puts what was drawn before a photograph."""


@dataclass(frozen=True)
class Factor:
    """One part of what rain does to a picture or a drive, which an attribution switches."""

    name: str
    title: str
    off: Mapping[str, Any] = field(default_factory=dict[str, Any])
    """Settings of the rain that switch it off; a pass without any is left out by its name."""
    on: Mapping[str, Any] = field(default_factory=dict[str, Any])
    """Settings that switch it on in a rain that lacks it."""
    needs_wet_ground: bool = False

    def __post_init__(self) -> None:
        if unknown := {*self.off, *self.on} - set(RainSettings.__struct_fields__):
            raise ValueError(f"factor {self.name}: rain has no setting {', '.join(sorted(unknown))}")


@runtime_checkable
class Pass(Protocol):
    """An effect of a picture. Its time is a row of *Statistics*."""

    @property
    def name(self) -> str: ...

    @property
    def factor(self) -> Factor | None:
        """Factor of an attribution; None for what is no effect of rain, or part of another one."""
        ...

    def active(self, frame: FrameInput) -> bool:
        """Return whether the picture has this effect."""
        ...

    def add(self, frame: FrameInput, parts: FrameParts) -> None:
        """Add draw items, a medium, light, or a filter of the picture."""
        ...
