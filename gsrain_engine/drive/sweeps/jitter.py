"""How far a seed varies where and how fast a drive begins: what makes its runs differ without any rain."""

import zlib
from typing import Annotated

import numpy as np
from msgspec import Meta, Struct, structs

from ..scenario.scenario import Scenario

_MOST_SIGMAS = 2.0
_FASTEST_M_S = 60.0


class Jitter(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Standard deviations of normal laws that are cut at twice of them."""

    ego_speed_m_s: Annotated[float, Meta(ge=0, le=10, title="Ego's speed", extra={"unit": "m/s"})] = 0.0
    ahead_m: Annotated[
        float, Meta(ge=0, le=20, title="Ahead", description="Of each road user.", extra={"unit": "m"})
    ] = 0.0
    left_m: Annotated[float, Meta(ge=0, le=5, title="Left", description="Of each road user.", extra={"unit": "m"})] = (
        0.0
    )
    speed_m_s: Annotated[
        float, Meta(ge=0, le=10, title="Speed", description="Of each road user that moves.", extra={"unit": "m/s"})
    ] = 0.0


def jittered(scenario: Scenario, jitter: Jitter, seed: int) -> Scenario:
    """Return a scenario as a seed begins it. Seed 0 is the scenario as it was written.

    Neither the rain nor the agent takes part: drives of one seed begin alike at every intensity, for every agent.
    """
    if seed == 0:
        return scenario
    draw = _Draw(np.random.default_rng([seed, zlib.crc32(scenario.name.encode())]))
    speed = _speed(scenario.speed_m_s + draw(jitter.ego_speed_m_s))
    users = tuple(
        structs.replace(
            user,
            ahead_m=user.ahead_m + draw(jitter.ahead_m),
            left_m=user.left_m + draw(jitter.left_m),
            speed_m_s=_speed(user.speed_m_s + draw(jitter.speed_m_s)) if user.speed_m_s > 0 else draw(0.0),
        )
        for user in scenario.road_users
    )
    return structs.replace(scenario, speed_m_s=speed, road_users=users)


class _Draw:
    """Every call takes one number, used or not: to change one deviation leaves what the others give."""

    def __init__(self, random: np.random.Generator) -> None:
        self._random = random

    def __call__(self, sigma: float) -> float:
        return sigma * float(np.clip(self._random.standard_normal(), -_MOST_SIGMAS, _MOST_SIGMAS))


def _speed(value: float) -> float:
    return float(np.clip(value, 0.0, _FASTEST_M_S))
