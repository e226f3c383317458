"""Roll-outs that are small enough to be worked out by hand."""

import msgspec
import numpy as np

from gsrain_engine.simulation.rollout import EgoRecord, Rollout, RolloutStep, UserModel, UserRecord
from gsrain_engine.simulation.vehicle import Vehicle

CAR = Vehicle(length_m=4.0, width_m=2.0, rear_overhang_m=1.0)
"""Its box reaches from 1 m behind its rear axle to 3 m ahead of it, and 1 m to each side."""
SIZE = (4.0, 2.0, 1.5)


def ego(x=0.0, y=0.0, yaw=0.0, speed=10.0, acceleration=0.0, yaw_rate=0.0):
    return EgoRecord(
        x_m=float(x), y_m=float(y), z_m=0.0, yaw_rad=float(yaw), speed_m_s=float(speed), steer_rad=0.0,
        acceleration_m_s2=float(acceleration), steer_rate_rad_s=0.0, yaw_rate_rad_s=float(yaw_rate),
    )  # fmt: skip


def user(x, y=0.0, speed=0.0, yaw=0.0, id="lead"):
    return UserRecord(id=id, x_m=float(x), y_m=float(y), z_m=0.0, yaw_rad=float(yaw), speed_m_s=float(speed))


def straight(speed, points=6, spacing_s=0.5, acceleration=0.0):
    """A plan straight ahead that begins with a speed."""
    t = spacing_s * np.arange(1, points + 1)
    return tuple((float(speed * each + acceleration * each**2 / 2), 0.0) for each in t)


def step(index, ego, users=(), plan=(), collision=None, step_s=0.25, completion=0.0):
    return RolloutStep(
        step=index, time_s=index * step_s, ego=ego, road_users=tuple(users), plan=tuple(plan), route_left_m=0.0,
        route_completion=completion, collision=collision,
    )  # fmt: skip


def rollout(steps, end="time", intensity_mm_h=0.0, seed=0, agent="hand", name="made-up", step_s=0.25):
    ids = dict.fromkeys(each.id for moment in steps for each in moment.road_users)
    return Rollout(
        scenario={"name": name, "vehicle": msgspec.to_builtins(CAR), "rain": {"intensity_mm_h": intensity_mm_h}},
        scene="made-up", agent=agent, seed=seed, step_s=step_s, spacing_s=0.5,
        users={id: UserModel(class_name="car", size_lwh_m=SIZE) for id in ids}, end=end, steps=tuple(steps),
    )  # fmt: skip


def approach(speed=10.0, lead_x=40.0, moments=13, intensity_mm_h=0.0, seed=0, collide=True):
    """At constant speed towards a standing car; ends at the touch where it comes so far."""
    steps = []
    for i in range(moments):
        x = speed * 0.25 * i
        hit = "lead" if collide and x + 3 >= lead_x - 2 else None
        last = hit is not None or i == moments - 1
        plan = () if last else straight(speed)
        steps.append(step(i, ego(x, speed=speed), [user(lead_x)], plan, hit, completion=i / 100))
        if hit:
            break
    return rollout(steps, "collision" if steps[-1].collision else "time", intensity_mm_h, seed)
