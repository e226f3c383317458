"""What happened in a drive, moment by moment, as plain values."""

from typing import Any

import msgspec

BACKGROUND = "background"
"""What was hit where it is no road user."""


class EgoRecord(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The ego vehicle at a moment: the middle of its rear axle, on the ground. World frame."""

    x_m: float
    y_m: float
    z_m: float
    yaw_rad: float
    speed_m_s: float
    steer_rad: float
    acceleration_m_s2: float
    """Over the step before."""
    steer_rate_rad_s: float
    """Over the step before."""
    yaw_rate_rad_s: float
    """From speed, steering and wheelbase."""


class UserRecord(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A road user at a moment: its bottom centre. World frame."""

    id: str
    x_m: float
    y_m: float
    z_m: float
    yaw_rad: float
    speed_m_s: float


class RolloutStep(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A moment, with what was planned in it."""

    step: int
    time_s: float
    """Since the scenario began."""
    ego: EgoRecord
    road_users: tuple[UserRecord, ...]
    plan: tuple[tuple[float, float], ...] = ()
    """Points of the plan made now, in the vehicle's present frame (x forward, y left, metres), `spacing_s` apart; empty
    at the end of a drive."""
    route_left_m: float
    """Distance of the rear axle from the route, left positive."""
    route_completion: float
    """Share of the route ahead of the start that is behind the vehicle now, 0..1."""
    collision: str | None = None
    """Id of the road user that is touched, "background" for anything else in the scene."""
    notes: dict[str, Any] = {}
    """What the agent wants on record."""


class UserModel(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What does not change about a road user."""

    class_name: str
    size_lwh_m: tuple[float, float, float]


class Rollout(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A finished drive. Deterministic: nothing of it depends on the machine's speed or the date."""

    version: int = 1
    scenario: dict[str, Any]
    """As it was run, plain values (`Scenario`)."""
    scene: str
    """Name of the scene."""
    scene_hash: str = ""
    """Of what there is in it to be seen and driven into."""
    agent: str
    seed: int
    step_s: float
    spacing_s: float
    """Time between the points of a plan."""
    users: dict[str, UserModel]
    """By id: everybody who was ever there."""
    end: str
    """Why it ended: "collision", "completed", "off route", "time", "agent", "stopped"."""
    steps: tuple[RolloutStep, ...]
    """The start first; the last has no plan."""
    software: dict[str, str] = {}
    """Versions of what ran."""
