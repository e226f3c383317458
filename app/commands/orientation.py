"""How a scene lies in the world, as a person says it: which way is up, how long a metre is."""

from dataclasses import dataclass, replace
from typing import Annotated, Literal

from cyclopts import Parameter

from gsrain_engine.scene.scene import Scene
from gsrain_engine.session.edits.scale import set_length

_UP = {
    "x": (1.0, 0.0, 0.0), "-x": (-1.0, 0.0, 0.0),
    "y": (0.0, 1.0, 0.0), "-y": (0.0, -1.0, 0.0),
    "z": (0.0, 0.0, 1.0), "-z": (0.0, 0.0, -1.0),
}  # fmt: skip
_SMALLEST, _LARGEST = 1e-6, 1e6


@Parameter(name="*")  # its fields are options of the command, without a prefix
@dataclass(frozen=True, kw_only=True)
class Orientation:
    """Options about axes and units; files of Gaussians say neither."""

    up: Annotated[
        Literal["x", "-x", "y", "-y", "z", "-z"] | None,
        Parameter(
            help="Which way is up in the scene's axes; files of Gaussians alone are taken as -y.",
            allow_leading_hyphen=True,
        ),
    ] = None
    metres_per_unit: Annotated[float | None, Parameter(help="Length of one scene unit in metres.")] = None

    def __post_init__(self) -> None:
        if self.metres_per_unit is not None and not _SMALLEST <= self.metres_per_unit <= _LARGEST:
            raise ValueError(f"--metres-per-unit {self.metres_per_unit:g}: must be within 0.000001..1000000")

    def of(self, scene: Scene) -> Scene:
        """Return the scene as it is said to lie; turned, it no longer knows the height of its ground."""
        if self.up is not None and _UP[self.up] != scene.up:
            scene = replace(scene, up=_UP[self.up], ground_m=None)
        if self.metres_per_unit is None:
            return scene
        return set_length(scene, scene.metres_per_unit, self.metres_per_unit)
