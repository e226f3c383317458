"""What turns a plan into controls."""

from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float64

from .state import Control, VehicleState
from .vehicle import Vehicle


@runtime_checkable
class Controller(Protocol):
    """Follows a plan. The same states and plans give the same controls, on any machine: nothing goes by the clock."""

    def reset(self) -> None:
        """Forget what it knows of the drive before."""
        ...

    def control(
        self, vehicle: Vehicle, state: VehicleState, plan: Float64[np.ndarray, "n 2"], spacing_s: float
    ) -> Control:
        """Return what to do now to be at `plan[k]` (k + 1) spacings from now.

        `plan` is in the vehicle's present frame (x forward, y left, metres), n >= 1.
        """
        ...
