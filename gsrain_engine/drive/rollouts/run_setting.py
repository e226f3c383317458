"""What a roll-out says about the test that it is of: scenario, weather, vehicle."""

from dataclasses import dataclass

from ..vehicle.vehicle import Vehicle
from .driven_vehicle import driven_vehicle
from .rollout import Rollout, RolloutStep


@dataclass(frozen=True, slots=True)
class RunSetting:
    """The parts of a scenario that metrics and tables need."""

    scenario: str
    """Its name."""
    description: str
    intensity_mm_h: float
    vehicle: Vehicle


def run_setting(rollout: Rollout) -> RunSetting:
    """Read them from a roll-out; what it does not state has its default, no rain and the default vehicle.

    Raises ValueError for a vehicle that can't be read.
    """
    plain, vehicle = rollout.scenario, driven_vehicle(rollout)
    intensity = float(plain.get("rain", {}).get("intensity_mm_h", 0.0))
    name, description = str(plain.get("name", "")), str(plain.get("description", ""))
    return RunSetting(name, description, intensity, vehicle)


def planned_frames(rollout: Rollout) -> tuple[RolloutStep, ...]:
    """Return the moments in which a plan was made: the paper's F frames."""
    return tuple(each for each in rollout.steps if each.plan)
