"""Roll-out of a closed-loop drive, step by step, as plain values."""

from typing import Annotated, Any, NamedTuple

import msgspec
import numpy as np
from jaxtyping import UInt8

from ..safe_io.text_files import printable_line
from ..scene.camera import Camera
from .geometry import PlanarBox
from .vehicle import Vehicle, VehicleState


class EgoRecord(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Ego state at one step: center of the rear axle on the ground. World frame."""

    x_m: float
    y_m: float
    z_m: float
    yaw_rad: float
    speed_m_s: float
    steer_rad: float
    acceleration_m_s2: float
    steer_rate_rad_s: float  # acceleration and steering rate are those over the previous step
    yaw_rate_rad_s: float  # computed from speed, steering and wheelbase

    @property
    def state(self) -> VehicleState:
        return VehicleState(self.x_m, self.y_m, self.yaw_rad, self.speed_m_s, self.steer_rad)


class UserRecord(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Road user state at one step: center of the bottom face. World frame."""

    id: str
    x_m: float
    y_m: float
    z_m: float
    yaw_rad: float
    speed_m_s: float


class RolloutStep(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One time step with the agent's plan. Times count from the start of the scenario."""

    step: int
    time_s: float
    ego: EgoRecord
    road_users: tuple[UserRecord, ...]
    plan: tuple[tuple[float, float], ...] = ()
    """Points of the current plan in the vehicle's current frame (x forward, y left, meters), `spacing_s` apart.

    Empty at the end of a drive.
    """
    route_left_m: float  # distance of the rear axle from the route, left positive
    route_completion: float  # driven share of the route ahead of the start, 0..1
    collision: str | None = None  # id of the road user hit, or "background" for anything else in the scene
    notes: dict[str, Any] = {}


class UserModel(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Constant properties of a road user."""

    class_name: str
    size_lwh_m: tuple[float, float, float]


class Rollout(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A finished drive. Deterministic: independent of the machine's speed and the date."""

    version: int = 1
    scenario: dict[str, Any]
    """The `Scenario` as plain values."""
    scene: str
    scene_hash: str = ""
    """Hash of the scene's visible and solid content."""
    agent: str
    seed: int
    step_s: Annotated[float, msgspec.Meta(gt=0)]
    spacing_s: Annotated[float, msgspec.Meta(gt=0)]
    users: dict[str, UserModel]
    """All road users that ever appeared, by id."""
    end: str
    """Reason of the end: "collision", "completed", "off route", "time", "agent", "stopped"."""
    steps: tuple[RolloutStep, ...]
    """The first is the start; the last has no plan."""
    software: dict[str, str] = {}

    @property
    def scenario_name(self) -> str:
        return str(self.scenario.get("name", ""))

    @property
    def intensity_mm_h(self) -> float:
        """Rain intensity of the scenario, 0 if it has none."""
        rain = self.scenario.get("rain", {})
        found = rain.get("intensity_mm_h", 0.0) if isinstance(rain, dict) else None
        if not isinstance(found, int | float):
            raise ValueError("Expected a number - at `$.scenario.rain.intensity_mm_h`")
        return float(found)

    @property
    def vehicle(self) -> Vehicle:
        """Vehicle of the scenario, or the default one; raises ValueError if it can't be read."""
        try:
            return msgspec.convert(self.scenario.get("vehicle", {}), Vehicle)
        except msgspec.ValidationError as error:
            raise ValueError(f"the roll-out's scenario.vehicle: {printable_line(error)}") from None

    @property
    def planned_frames(self) -> tuple[RolloutStep, ...]:
        """Steps with a plan: the paper's F frames."""
        return tuple(each for each in self.steps if each.plan)

    def __repr__(self) -> str:
        about = f"{self.agent} in {self.intensity_mm_h:g} mm/h, {len(self.steps) - 1} steps, end: {self.end}"
        return f"<gsrain.Rollout of {self.scenario_name}: {about}>"

    def boxes(self, step: RolloutStep) -> tuple[PlanarBox, ...]:
        """Return the ground boxes of the road users at a step, in their order."""
        return tuple(
            PlanarBox(each.x_m, each.y_m, each.yaw_rad, *self.users[each.id].size_lwh_m[:2]) for each in step.road_users
        )


class CameraImage(NamedTuple):
    """Image of a rig camera at one step, for recordings of a roll-out."""

    step: int
    name: str
    """Camera name, used as frame and topic."""
    image: UInt8[np.ndarray, "h w 3"]
    """RGB, display-referred."""
    camera: Camera
    """World frame."""
