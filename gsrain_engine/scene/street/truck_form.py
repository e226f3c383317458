"""The outline of a delivery lorry, and the colours that its parts share."""

from dataclasses import dataclass

from .parking import TRUCK_LENGTH_M, TRUCK_WIDTH_M, Color

STEEL: Color = (0.10, 0.105, 0.11)
DARK: Color = (0.016, 0.016, 0.018)
TRIM: Color = (0.022, 0.022, 0.024)
PLATE: Color = (0.78, 0.78, 0.74)
AMBER: Color = (0.60, 0.19, 0.01)
RED_TAPE: Color = (0.45, 0.012, 0.014)


@dataclass(frozen=True, slots=True)
class TruckForm:
    """The outline of a box lorry of 7.5 t, in metres; x counts from the middle."""

    length: float = TRUCK_LENGTH_M
    width: float = TRUCK_WIDTH_M
    height: float = 3.2
    floor: float = 0.98
    """Lower edge of the box body."""
    cab_width: float = 2.04
    cab_height: float = 2.32
    cab_back: float = 1.92
    body_front: float = 1.72
    wheels: tuple[float, float] = (-1.95, 2.55)
    """Rear and front axle, x."""
    wheel_radius: float = 0.41

    @property
    def body_back(self) -> float:
        """Where the doors of the box are, x."""
        return -0.5 * self.length + 0.06


TRUCK_FORM = TruckForm()
"""The lorries that stand in the street."""
