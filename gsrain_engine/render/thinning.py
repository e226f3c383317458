"""Draws a share of a scene's Gaussians for all of them: those that matter most, grown to cover as much."""

import math
from dataclasses import dataclass, field

from gsrain_engine.scene.drawing_order import growth_of
from gsrain_engine.scene.gaussians import Gaussians
from gsrain_engine.scene.members import Part


@dataclass(slots=True)
class Thinning:
    """Takes parts whose Gaussians are in their drawing order; remembers what it worked out for each set of them."""

    share: float
    _growths: dict[int, tuple[Gaussians, float]] = field(default_factory=dict[int, "tuple[Gaussians, float]"])

    def __call__(self, part: Part) -> Part:
        """Leave out all but the share that matters most."""
        gaussians = part.gaussians
        if id(gaussians) not in self._growths:
            self._growths[id(gaussians)] = gaussians, growth_of(gaussians, self.share)
        growth = self._growths[id(gaussians)][1]
        return part._replace(limit=math.ceil(self.share * len(gaussians)), growth=growth)
