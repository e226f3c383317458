"""Draws a share of a scene's Gaussians for all of them: those that matter most, grown to cover as much."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

from gsrain_engine.scene.drawing_order import growth_of
from gsrain_engine.scene.gaussians import Gaussians
from gsrain_engine.scene.members import Part

_Shape = tuple[int, int]
"""Identity of what growth depends on: scales and opacities."""


@dataclass(slots=True)
class Thinning:
    """Takes parts whose Gaussians are in their drawing order; remembers what it worked out for each set of them.

    Masks are not looked at: where they leave out much of what matters, the rest is drawn a little too large.
    """

    share: float
    _growths: dict[_Shape, tuple[Gaussians, float]] = field(
        default_factory=dict[_Shape, "tuple[Gaussians, float]"]  # held on to, so that the identity stays taken
    )

    def __call__(self, part: Part) -> Part:
        """Leave out all but the share that matters most."""
        return part._replace(limit=math.ceil(self.share * len(part.gaussians)), growth=self.growth(part.gaussians))

    def growth(self, gaussians: Gaussians) -> float:
        """How much larger those that are left are drawn; worked out once for all colours of the same Gaussians."""
        key = _shape(gaussians)
        if key not in self._growths:
            self._growths[key] = gaussians, growth_of(gaussians, self.share)
        return self._growths[key][1]

    def forget_all_but(self, kept: Iterable[Gaussians]) -> None:
        """Let go of every other set."""
        keys = {_shape(each) for each in kept}
        self._growths = {key: known for key, known in self._growths.items() if key in keys}


def thinned(parts: Sequence[Part], thinning: Thinning | None) -> Sequence[Part]:
    """Thin out every part, or none."""
    return parts if thinning is None else [thinning(part) for part in parts]


def _shape(gaussians: Gaussians) -> _Shape:
    return id(gaussians.scales), id(gaussians.opacities)
