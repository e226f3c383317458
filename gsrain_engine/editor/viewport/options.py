"""What is shown of a match: the other view as seen from here, the difference, or what became of each pixel."""

import math
from dataclasses import dataclass, field
from typing import Literal, NamedTuple, get_args

from ...rain.simulation import RainSimulation
from ...render.opengl.buffers import Harmonics
from ...render.renderer import Color, RenderMode
from ...scene.scene import Scene

Mode = Literal["picture", "difference", "pixels"]

MODES: tuple[Mode, ...] = get_args(Mode)

# § How the viewport shows things; not part of the document.

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
    look: RenderMode = "splats"
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


# § One side of the viewport: the only one, or one of two that are compared.


class SplitPane(NamedTuple):
    """What one side of the viewport shows."""

    label: str
    scene: Scene
    rainfall: RainSimulation


# § A picture that the window has on the GPU, for panels to show.


class Texture(NamedTuple):
    """First row on top."""

    name: int
    """What OpenGL calls it."""
    width: int
    height: int


# § How much is drawn while the camera moves: as much as a frame-time target allows, and everything once it rests.


class QualityLevel(NamedTuple):
    """How much of the exact picture is drawn."""

    gaussians: float
    """Share of each part's Gaussians, those that matter most."""
    scale: float
    """Side of the drawn picture over that of the shown one."""

    @property
    def is_exact(self) -> bool:
        return self == FULL_QUALITY

    def __str__(self) -> str:
        """Say it in words, empty where it is exact."""
        words: list[str] = []
        if self.gaussians < 1:
            words.append(f"1/{round(1 / self.gaussians)} of the Gaussians")
        if self.scale < 1:
            words.append(f"{self.scale:.0%} resolution")
        return ", ".join(words)


FULL_QUALITY = QualityLevel(1.0, 1.0)

LEVELS = (
    FULL_QUALITY, QualityLevel(1 / 2, 1.0), QualityLevel(1 / 4, 1.0), QualityLevel(1 / 8, 1.0),
    QualityLevel(1 / 8, 2 / 3), QualityLevel(1 / 8, 1 / 2), QualityLevel(1 / 8, 1 / 3),
)  # fmt: skip
"""First fewer Gaussians, then fewer pixels."""

SETTLED_S = 0.15
"""After so long without a movement the exact picture comes back."""

_TOLERANCE = 1.15

_PROMISING = 0.55
"""A finer level is tried where a frame takes less than this share of the target."""

_FORGET_AFTER = 45
"""Frames after which a level that was too slow may be tried again."""


@dataclass(slots=True)
class AdaptiveQuality:
    """Chooses the detail of each frame from the times that earlier ones took. Knows no clock of its own."""

    target_ms: float = 33.0
    enabled: bool = True
    _level: int = 0
    _rested_s: float = math.inf
    _too_slow: dict[int, int] = field(default_factory=dict[int, int])
    """Levels that missed the target, and for how many more frames that is remembered."""

    @property
    def detail(self) -> QualityLevel:
        return LEVELS[self._level] if self.enabled and self._rested_s < SETTLED_S else FULL_QUALITY

    @property
    def is_settling(self) -> bool:
        """Whether the exact picture is still to come although nothing moves."""
        return 0 < self._rested_s < SETTLED_S and not self.detail.is_exact

    def observe(self, *, moving: bool, real_s: float) -> QualityLevel:
        """Take in whether the camera has moved since the last frame, so many seconds ago; returns what to draw."""
        self._rested_s = 0.0 if moving else self._rested_s + real_s
        return self.detail

    def measured(self, detail: QualityLevel, frame_ms: float) -> None:
        """Learn how long a frame of some detail took to draw."""
        level = LEVELS.index(detail)
        self._too_slow = {each: left - 1 for each, left in self._too_slow.items() if left > 1}
        excess = frame_ms / self.target_ms
        if excess > _TOLERANCE:
            self._too_slow[level] = _FORGET_AFTER
            # A level down halves the work at best; never the same level twice in a row.
            self._level = min(max(self._level, level + max(1, round(math.log2(excess)))), len(LEVELS) - 1)
        elif excess < _PROMISING and level == self._level > 0 and level - 1 not in self._too_slow:
            self._level = level - 1
