"""Viewport options: overlays, split view, matching modes, and the adaptive quality."""

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Literal, NamedTuple

from ...choices import Mark, RenderMode
from ...render.opengl.buffers import Harmonics
from ...render.renderer import Color
from ..guide import FIRST_PAGE

Mode = Literal["picture", "difference", "pixels"]

# View options; not part of the document

Split = Literal["off", "clear | rainy", "before | after", "now | preview"]
"""before: document before the last undo step; preview: one view transferred."""


@dataclass(slots=True)
class ViewOptions:
    """Options chosen by the user."""

    show_streak_region: bool = False
    show_haze_region: bool = False
    background: Color = (0.0, 0.0, 0.0)
    gain_ev: float = 0.0
    """Exposure of the display only."""
    shrink: int = 1
    """Draw every n-th pixel in each direction; the rain keeps the drops of the full image."""
    beyond_calibration: bool = False
    """Extend the intensity slider to 149 mm/h."""
    follow_path: bool = False
    """Ride along the camera path instead of flying."""
    orthographic: bool = False
    """Parallel rays: a view to scale, without drops and haze; not along the path."""
    marks: frozenset[Mark] = frozenset({"scale"})
    """Marks over an orthographic view."""
    look: RenderMode = "splats"
    split: Split = "off"
    """The two images shown side by side."""
    divider: float = 0.5
    """Boundary between them, as a share of the width."""
    harmonics: Harmonics = "half"
    """Precision of the spherical harmonics on the GPU."""
    show_selection: bool = True
    dialog: str = ""
    """Open page of the window: commands, keys or about."""
    guide: str = ""
    """Open page of the guide, by its path in the folder, perhaps with # and an anchor; empty if it is closed."""
    guide_of_focus: str = FIRST_PAGE
    """Page about the panel that had the focus last."""
    member: str = ""
    """Key of the active layer or actor, the one chosen last; none if empty or gone."""
    members: tuple[str, ...] = ()
    """Keys of the layers and actors that are chosen, in that order, if the active one is among them; else it alone."""
    show_lamps: bool = False
    lamp: int = -1
    """Number of the lamp to edit; none if negative."""
    tool: str = ""
    """Name of the active viewport tool; empty for navigation."""


class Texture(NamedTuple):
    """A texture on the GPU for panels, first row on top."""

    name: int
    """OpenGL name."""
    width: int
    height: int


# Adaptive quality: limited by a frame-time target while the picture changes, full at rest


class QualityLevel(NamedTuple):
    """Quality as shares of a full render."""

    gaussians: float
    """Share of each part's Gaussians, the most important ones."""
    scale: float
    """Ratio of the rendered to the displayed side length."""
    has_backdrop: bool = False
    """True if what stands still is drawn once, for many pictures."""
    error_px: float = 0.0
    """Largest details that are merged, in pixels of the rendered image; 0 merges none."""

    @property
    def is_exact(self) -> bool:
        return self == FULL_QUALITY

    @property
    def patience(self) -> float:
        """Factor on the target frame time: longer where no answer to the mouse waits, or less would hide the scene."""
        if self.has_backdrop:
            return 1.5
        return _CUT_PATIENCE if self.error_px > 0 and self.scale <= 1 / 2 else 1.0

    @property
    def focal_share(self) -> float:
        """Ratio of the focal length by which drops are told from the medium to that of the displayed picture.

        Drops narrower than a pixel are part of the medium; in a coarse picture of a camera that moves, a pixel is
        between that of the display and the picture's own.
        """
        return self.scale**_OF_COARSER_DROPS if self.error_px > 0 else 1.0

    def __str__(self) -> str:
        """Describe the level; empty for full quality."""
        subset = f"1/{round(1 / self.gaussians)} of the Gaussians" if self.gaussians < 1 else ""
        resolution = f"{self.scale:.0%} resolution" if self.scale < 1 else ""
        backdrop = "rain over a still scene" if self.has_backdrop else ""
        merged = f"details under {self.error_px:g} px merged" if self.error_px > 0 else ""
        return ", ".join(filter(None, [subset, merged, backdrop, resolution]))


_CUT_PATIENCE = 1.4  # 12 pictures in a second, with a margin of 1.5
_OF_COARSER_DROPS = 0.25

FULL_QUALITY = QualityLevel(1.0, 1.0)
LEVELS = (
    FULL_QUALITY, QualityLevel(1 / 2, 1.0), QualityLevel(1 / 4, 1.0), QualityLevel(1 / 8, 1.0),
    QualityLevel(1 / 8, 2 / 3), QualityLevel(1 / 8, 1 / 2), QualityLevel(1 / 8, 1 / 3),
)  # fmt: skip
"""First fewer Gaussians, then fewer pixels."""
BACKDROP_LEVELS = tuple(
    QualityLevel(1.0, scale, has_backdrop=True) for scale in (1.0, 5 / 6, 2 / 3, 1 / 2, 2 / 5, 1 / 3)
)
"""Fewer pixels; the first picture of a size is as slow as an exact one. Most of the others' time is the rain's own."""
CUT_LEVELS = (
    FULL_QUALITY,
    *(QualityLevel(1.0, scale, error_px=1.0) for scale in (1.0, 5 / 6, 2 / 3)),
    *(QualityLevel(1.0, scale, error_px=error) for scale, error in ((1 / 2, 1.25), (2 / 5, 1.5), (1 / 3, 1.5))),
    *(QualityLevel(1.0, scale, error_px=error) for scale, error in ((1 / 3, 2.0), (1 / 4, 2.0), (1 / 4, 2.5))),
    QualityLevel(1.0, 2 / 9, error_px=2.5),
)
"""Details merged, and fewer pixels."""
REFINED = CUT_LEVELS[3]
"""Quality of a picture between one in motion and a full one that takes long."""

SETTLED_S = 0.15  # time without changes after which full quality returns
_TOLERANCE = 1.15
_PROMISING = 1.1  # share of the target frame time that a finer level may be expected to take when it is tried
_FORGET_AFTER = 45  # frames after which a level that was too slow may be tried once more
_FIRST_BACKDROP = 2  # level of backdrops to begin with
_WARPED_PATIENCE = 6.0  # of a warped picture: longer, what it shows bends; shorter, it is too coarse
_LONG_MS = 150.0  # drawing time of a full picture from which on a fast one shows a change first
_VERY_LONG_MS = 1000.0  # from which on a refined one comes first when all is at rest
_COARSEST = 5  # number of pictures of the coarsest level, of which the fastest is what the machine keeps
_MIN_COARSEST = 3
_CUTS_A_HALVING = 3  # levels of cuts from one to another of half its time


@dataclass(slots=True)
class _Ladder:
    """Levels of falling quality, and the present one."""

    levels: tuple[QualityLevel, ...]
    present: int = 0
    halving: int = 1
    """Number of levels that halve the drawing time at best."""
    too_slow: dict[int, int] = field(default_factory=dict[int, int])
    """Levels that missed the target, with the number of frames until they may be tried once more."""
    coarsest_ms: deque[float] = field(default_factory=lambda: deque[float](maxlen=_COARSEST))
    """Drawing times of the last pictures of the coarsest level, or of finer ones that took less."""

    def measured(self, detail: QualityLevel, frame_ms: float, limit_ms: Callable[[QualityLevel], float]) -> None:
        """Record the drawing time of a frame; `limit_ms` is what one may take."""
        level = self.levels.index(detail)
        if level == len(self.levels) - 1 or (self.coarsest_ms and frame_ms < min(self.coarsest_ms)):
            self.coarsest_ms.append(frame_ms)
        self.too_slow = {each: left - 1 for each, left in self.too_slow.items() if left > 1}
        if frame_ms > _TOLERANCE * limit_ms(detail):
            self.too_slow[level] = _FORGET_AFTER
            # Never choose the same level twice in a row.
            if level == self.present:
                steps = max(1, round(self.halving * math.log2(frame_ms / limit_ms(detail))))
                self.present = min(level + steps, len(self.levels) - 1)
        elif level == self.present > 0 and level - 1 not in self.too_slow:
            expected_ms = frame_ms * 2 ** (1 / self.halving)
            self.present -= expected_ms < _PROMISING * limit_ms(self.levels[level - 1])


@dataclass(slots=True)
class AdaptiveQuality:
    """Chooses the quality of each picture from the times of earlier ones. Uses no clock of its own."""

    target_ms: float = 33.0
    enabled: bool = True
    has_cuts: bool = False
    """True if details can be merged, so that less is drawn without leaving anything out."""
    is_warped: bool = False
    """True if pictures are warped to the present, so that they may take longer, unless the camera stands."""
    _of_all: _Ladder = field(default_factory=lambda: _Ladder(LEVELS))
    _of_cuts: _Ladder = field(default_factory=lambda: _Ladder(CUT_LEVELS, halving=_CUTS_A_HALVING))
    _of_backdrops: _Ladder = field(default_factory=lambda: _Ladder(BACKDROP_LEVELS, _FIRST_BACKDROP))
    _rested_s: float = math.inf
    _stood_s: float = math.inf
    _full_ms: float = 0.0
    _is_coarse: bool = False
    """True if something has moved since a refined or full picture."""

    @property
    def detail(self) -> QualityLevel:
        ladder = self._of_cuts if self.has_cuts else self._of_all
        detail = ladder.levels[ladder.present]
        if not self.enabled:
            return FULL_QUALITY
        if self._rested_s >= SETTLED_S:
            refines = self._is_coarse and self.has_cuts and self._full_ms > _VERY_LONG_MS and not detail.is_exact
            return REFINED if refines else FULL_QUALITY
        stands = self._stood_s >= SETTLED_S and not detail.is_exact
        return self._of_backdrops.levels[self._of_backdrops.present] if stands else detail

    @property
    def min_target_ms(self) -> float:
        """Shortest target that the coarsest pictures keep, by those that were drawn; 0 while there were too few."""
        ladders = self._of_cuts if self.has_cuts else self._of_all, self._of_backdrops
        known = [each for each in ladders if len(each.coarsest_ms) >= _MIN_COARSEST]
        shares = (min(each.coarsest_ms) / self._limit_ms(each.levels[-1]) for each in known)
        return self.target_ms * max(shares, default=0.0)

    @property
    def is_settling(self) -> bool:
        """True if the full-quality image is still due although nothing moves."""
        return 0 < self._rested_s < SETTLED_S and not self.detail.is_exact

    def observe(self, *, moving: bool, real_s: float, stands: bool = False, edited: bool = False) -> QualityLevel:
        """Record whether the picture changes since the last one, `real_s` ago; return the quality to draw.

        `stands` is true if only rain and road users change it, and they can be drawn over a backdrop. `edited` is true
        if what it shows was changed: where a full picture takes long, a fast one shows the change first.
        """
        moving |= edited and self._full_ms > _LONG_MS
        self._rested_s = 0.0 if moving else self._rested_s + real_s
        self._is_coarse |= moving
        self._stood_s = self._stood_s + real_s if stands else 0.0
        return self.detail

    def measured(self, detail: QualityLevel, frame_ms: float) -> None:
        """Record the drawing time of a frame."""
        self._full_ms = frame_ms if detail.is_exact else self._full_ms
        if (detail.is_exact or detail == REFINED) and self._rested_s > 0:
            self._is_coarse = False
        if detail == REFINED and self._rested_s >= SETTLED_S:
            return  # with all cores
        for ladder in (self._of_all, self._of_cuts, self._of_backdrops):
            if detail in ladder.levels:
                ladder.measured(detail, frame_ms, self._limit_ms)

    def _limit_ms(self, detail: QualityLevel) -> float:
        """Time that a picture may take."""
        is_warped = self.is_warped and not detail.has_backdrop
        return self.target_ms * (_WARPED_PATIENCE if is_warped else detail.patience)
