"""What a learner is paid for: getting on, smoothly, without hitting anything."""

from typing import Annotated

import msgspec
from msgspec import Meta

from ..agents.observation import Observation
from ..vehicle.bicycle import yaw_rate
from ..vehicle.vehicle import Vehicle


class Reward(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Weights of the reward of a step.

    reward = progress * (metres got on along the route) - discomfort * (a^2 + (v * yaw rate)^2) * step, with the
    longitudinal acceleration a over the step and the lateral one v * yaw rate at its end, in m/s2; and once, at the
    end, what the end is worth. A drive that runs out of time is worth what it has got until then.
    """

    progress: Annotated[float, Meta(ge=0, title="Progress", extra={"unit": "1/m"})] = 1.0
    discomfort: Annotated[float, Meta(ge=0, title="Discomfort", extra={"unit": "s3/m2"})] = 0.05
    collision: Annotated[float, Meta(le=0, title="Collision")] = -100.0
    off_route: Annotated[float, Meta(le=0, title="Off the route")] = -50.0
    completed: Annotated[float, Meta(ge=0, title="Route completed")] = 100.0

    def of_step(self, before: Observation, after: Observation, vehicle: Vehicle, end: str | None) -> float:
        """Return the reward of a step between two moments; `end` is why the drive is over, none while it goes on."""
        got_on = _along(after) - _along(before)
        state = after.state
        lateral = state.speed_m_s * yaw_rate(vehicle, state)
        harsh = after.acceleration_m_s2**2 + lateral**2
        at_end = {"collision": self.collision, "off route": self.off_route, "completed": self.completed}
        step_s = after.time_s - before.time_s
        return float(self.progress * got_on - self.discomfort * harsh * step_s + at_end.get(end or "", 0.0))


def _along(observation: Observation) -> float:
    return observation.route.nearest(observation.state.x_m, observation.state.y_m).along_m
