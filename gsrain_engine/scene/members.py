"""What a scene is made of: layers that stand still and actors that move, and how each of them is shown."""

from dataclasses import dataclass, field
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float32, Float64, Int64

from .gaussians import Gaussians
from .grading import UNCHANGED, Grading
from .marks import UNMARKED, Marks
from .mask import Mask
from .track import Track


class Part(NamedTuple):
    """What a renderer draws: Gaussians, and the similarity that takes them to the world (metres, z up)."""

    gaussians: Gaussians
    to_world: Float64[np.ndarray, "4 4"]
    limit: int | None = None
    """Draw only the first so many of them; none draws all."""
    growth: float = 1.0
    """Draw them so many times larger, to fill in for those that are left out."""
    left_out: Mask | None = None
    """Gaussians that are not drawn."""
    selected: Mask | None = None
    """Gaussians that are drawn tinted."""
    opacity: float = 1.0
    """Multiplies each Gaussian's own."""
    colors: Float64[np.ndarray, "3 4"] | None = None
    """Affine change of display colours, before what is below 0 is cut off."""
    wet_sh: Float32[np.ndarray, "n k 3"] | None = None
    """Harmonics of the Gaussians when they are soaked; none where they have no wet colours."""
    wetness: float = 0.0
    """0..1: colours are (1 - wetness) of the clear ones and wetness of the wet ones."""

    @property
    def is_wet(self) -> bool:
        """Whether there is anything of wet colours to be seen."""
        return self.wet_sh is not None and self.wetness > 0

    @property
    def drawn_count(self) -> int:
        """How many are drawn, and left out, before the limit."""
        return len(self.gaussians) if self.limit is None else min(self.limit, len(self.gaussians))

    @property
    def remaining(self) -> Gaussians:
        """The Gaussians without those that are left out; the very same value where none is."""
        return self.gaussians if not self.left_out else self.gaussians.take((~self.left_out).indices)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Member:
    """What layers and actors have in common."""

    visible: bool = True
    locked: bool = False
    """Whether selection and edits pass it by."""
    opacity: float = 1.0
    """Multiplies that of each Gaussian; 0..1."""
    grading: Grading = UNCHANGED
    marks: Marks = UNMARKED
    """Which of its Gaussians are selected, hidden or deleted."""
    wet_sh: Float32[np.ndarray, "n k 3"] | None = None
    """Harmonics of its Gaussians when they are soaked, as many as they have when clear; none where nobody knows them.

    Treat the array as a value, and as one with `gaussians`: what reorders or turns the one does so with the other.
    """


@dataclass(frozen=True, slots=True, eq=False)
class Layer(Member):
    """Gaussians that stand still."""

    name: str
    gaussians: Gaussians
    kind: Literal["background", "sky"] = "background"
    to_scene: Float64[np.ndarray, "4 4"] = field(default_factory=lambda: np.eye(4))
    """Similarity from the Gaussians' own units and axes to the scene's."""

    def __post_init__(self) -> None:
        _check_wet_colors(self.key, self.gaussians, self.wet_sh)

    @property
    def key(self) -> str:
        """Name among all members of a scene."""
        return f"layers/{self.name}"

    def way(self, time_s: float) -> Float64[np.ndarray, "4 4"]:
        """Similarity to the scene, at any time."""
        return self.to_scene


@dataclass(frozen=True, slots=True, eq=False)
class Actor(Member):
    """A thing that moves: Gaussians in its own frame (x forward, y left, z up, origin at the bottom centre)."""

    id: str
    class_name: str
    size_lwh: tuple[float, float, float]
    gaussians: Gaussians
    track: Track

    def __post_init__(self) -> None:
        _check_wet_colors(self.key, self.gaussians, self.wet_sh)

    @property
    def key(self) -> str:
        return f"actors/{self.id}"

    @property
    def name(self) -> str:
        return self.id

    def way(self, time_s: float) -> Float64[np.ndarray, "4 4"] | None:
        """Pose in the scene at a time; None while it is not there."""
        return self.track.pose(time_s)


def rows_of(
    member: Layer | Actor, indices: Int64[np.ndarray, " m"]
) -> tuple[Gaussians, Float32[np.ndarray, "m k 3"] | None]:
    """Pick Gaussians of a member by index, with their wet colours."""
    return member.gaussians.take(indices), None if member.wet_sh is None else member.wet_sh[indices]


def _check_wet_colors(key: str, gaussians: Gaussians, wet_sh: Float32[np.ndarray, "_ _ 3"] | None) -> None:
    if wet_sh is not None and wet_sh.shape != gaussians.sh.shape:
        raise ValueError(
            f"{key}: wet colours have shape {wet_sh.shape}, expected {gaussians.sh.shape} as the clear ones"
        )
