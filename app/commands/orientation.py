"""How a scene lies in the world, as a person says it: which way is up, how long a metre is."""

from dataclasses import dataclass
from typing import Annotated

from cyclopts import Parameter

from gsrain_engine.scene.scene import Scene
from gsrain_engine.session.edits.level import UNIT_M, Axis, oriented


@Parameter(name="*")  # its fields are options of the command, without a prefix
@dataclass(frozen=True, kw_only=True)
class Orientation:
    """Options about axes and units; files of Gaussians say neither."""

    up: Annotated[
        Axis | None,
        Parameter(
            help="Which way is up in the scene's axes; files of Gaussians alone are taken as -y.",
            allow_leading_hyphen=True,
        ),
    ] = None
    metres_per_unit: Annotated[float | None, Parameter(help="Length of one scene unit in metres.")] = None

    def __post_init__(self) -> None:
        if self.metres_per_unit is not None and not UNIT_M[0] <= self.metres_per_unit <= UNIT_M[1]:
            raise ValueError(f"--metres-per-unit {self.metres_per_unit:g}: must be within 0.000001..1000000")

    def of(self, scene: Scene) -> Scene:
        """Return the scene as it is said to lie; turned, it no longer knows the height of its ground."""
        return oriented(scene, self.up, self.metres_per_unit)
