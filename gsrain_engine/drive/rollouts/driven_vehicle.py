"""The ego vehicle of a finished drive."""

import msgspec

from ..vehicle.vehicle import Vehicle
from .rollout import Rollout


def driven_vehicle(rollout: Rollout) -> Vehicle:
    """Return the vehicle that a roll-out states, the default one where it states none.

    Raises ValueError for one that can't be read.
    """
    try:
        return msgspec.convert(rollout.scenario.get("vehicle", {}), Vehicle)
    except msgspec.ValidationError as error:
        raise ValueError(f"the roll-out's scenario.vehicle: {error}") from None
