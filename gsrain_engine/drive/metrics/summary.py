"""All metrics of one run in one value: what `gsrain drive --json` writes and what a sweep keeps of each run."""

from typing import Annotated, Any

import msgspec
import numpy as np
from msgspec import Meta

from ..rollouts.rollout import Rollout
from ..rollouts.run_setting import planned_frames, run_setting
from .collision import first_collision
from .comfort_executed import comfort_executed
from .comfort_limits import NUPLAN
from .comfort_planned import comfort_planned
from .hd_score import DrivableArea, HdScore, hd_score
from .planned_collisions import Touchable, planned_collisions
from .time_to_collision import gaps_m, times_to_collision_s

Share = Annotated[float, Meta(ge=0, le=1)]


class DriveMetrics(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Metrics of a run; None where nothing can be measured. Names with `hugsim` leave out each plan's last point."""

    scenario: str
    scene: str
    agent: str
    intensity_mm_h: float
    seed: int
    steps: int
    """Driven: one less than there are moments."""
    frames: int
    """F: moments with a plan."""
    planned_points: int
    """N: points of a plan."""
    duration_s: float
    end: str
    """Why it ended: "collision", "completed", "off route", "time", "agent", "stopped"."""
    collision: bool
    collided_with: str | None
    """Id of the road user, or "background"."""
    collision_time_s: float | None
    collision_speed_m_s: float | None
    """Of the ego vehicle."""
    collision_closing_speed_m_s: float | None
    min_ttc_s: Annotated[float, Meta(ge=0, le=10)]
    """Least time to collision, from the bumper gap."""
    min_ttc_time_s: float
    """When it was."""
    min_ttc_center_s: Annotated[float, Meta(ge=0, le=10)]
    """The same, from middle to middle."""
    min_gap_m: float | None
    """Least bumper gap to anybody ahead in the lane; None where nobody ever was."""
    planned_point_collision_rate: Share | None
    """The paper's C, of all planned points."""
    planned_point_collision_rate_hugsim: Share | None
    planned_frame_collision_rate: Share | None
    """Share of frames with any planned point that collides."""
    planned_frame_collision_rate_hugsim: Share | None
    comfort_executed: Share | None
    """The paper's S, of the motion as driven."""
    comfort_executed_nuplan: Share | None
    """With nuPlan's limits of the jerk."""
    comfort_planned: Share | None
    """The paper's S, of the plans: HUGSIM's comfort."""
    comfort_planned_nuplan: Share | None
    route_completion: Share
    """Share of the route ahead of the start that was driven."""
    distance_m: float
    mean_speed_m_s: float
    """Distance over duration; 0 where nothing was driven."""
    hardest_braking_m_s2: float
    """Largest deceleration of a step, 0 or more."""
    with_background: bool
    """Whether planned points were tested against the background too."""
    nc: Share | None
    """This and the next six: see `HdScore`."""
    dac: Share | None
    ttc: Share | None
    c: Share | None
    pdms: Share | None
    rc: Share | None
    hdscore: Share | None

    @property
    def collided(self) -> bool:
        """Whether the ego vehicle hit a road user or the background."""
        return self.collision


def measured(rollout: Rollout, occupied: Touchable | None = None, drivable: DrivableArea | None = None) -> DriveMetrics:
    """Measure a run. `occupied` and `drivable` are of the world that it was driven in; without them they don't count.

    Raises ValueError for a roll-out whose vehicle can't be read.
    """
    setting, hit = run_setting(rollout), first_collision(rollout)
    times, gaps = times_to_collision_s(rollout), gaps_m(rollout)
    every, five = planned_collisions(rollout, occupied), planned_collisions(rollout, occupied, "hugsim")
    score = hd_score(rollout, occupied, drivable)
    distance, duration = _driven_m(rollout), rollout.steps[-1].time_s - rollout.steps[0].time_s
    return DriveMetrics(
        scenario=setting.scenario,
        scene=rollout.scene,
        agent=rollout.agent,
        intensity_mm_h=setting.intensity_mm_h,
        seed=rollout.seed,
        steps=len(rollout.steps) - 1,
        frames=len(planned_frames(rollout)),
        planned_points=every.points_per_frame,
        duration_s=duration,
        end=rollout.end,
        collision=hit is not None,
        collided_with=None if hit is None else hit.who,
        collision_time_s=None if hit is None else hit.time_s,
        collision_speed_m_s=None if hit is None else hit.speed_m_s,
        collision_closing_speed_m_s=None if hit is None else hit.closing_speed_m_s,
        min_ttc_s=float(times.min()),
        min_ttc_time_s=rollout.steps[int(times.argmin())].time_s,
        min_ttc_center_s=float(times_to_collision_s(rollout, "center").min()),
        min_gap_m=float(gaps.min()) if np.isfinite(gaps).any() else None,
        planned_point_collision_rate=every.point_rate,
        planned_point_collision_rate_hugsim=five.point_rate,
        planned_frame_collision_rate=every.frame_rate,
        planned_frame_collision_rate_hugsim=five.frame_rate,
        comfort_executed=comfort_executed(rollout),
        comfort_executed_nuplan=comfort_executed(rollout, NUPLAN),
        comfort_planned=comfort_planned(rollout),
        comfort_planned_nuplan=comfort_planned(rollout, NUPLAN),
        route_completion=max(each.route_completion for each in rollout.steps),
        distance_m=distance,
        mean_speed_m_s=distance / duration if duration > 0 else 0.0,
        hardest_braking_m_s2=max(0.0, *(-each.ego.acceleration_m_s2 for each in rollout.steps)),
        with_background=occupied is not None,
        **_parts(score),
    )


def _driven_m(rollout: Rollout) -> float:
    places = np.array([(each.ego.x_m, each.ego.y_m) for each in rollout.steps])
    return float(np.linalg.norm(np.diff(places, axis=0), axis=1).sum())


def _parts(score: HdScore | None) -> dict[str, Any]:
    names = ("nc", "dac", "ttc", "c", "pdms", "rc", "hdscore")
    return {name: None if score is None else getattr(score, name) for name in names}
