"""Everybody else on the road during a drive: put in place, and moved on step by step."""

from gsrain_engine.scene.members import Actor
from gsrain_engine.scene.scene import Scene

from ..road.ground import Ground
from ..road.route import Route
from ..traffic.behaviour import Behaviour, Surroundings
from ..traffic.models import UserLook, user_look
from ..traffic.recorded_track import RecordedTrack
from ..traffic.road_user import RoadUser
from .scenario import Scenario, ScenarioUser
from .start import start_place


class Traffic:
    """The scenario's road users, and those of the scene's own actors that it keeps."""

    def __init__(self, scenario: Scenario, scene: Scene, route: Route, ground: Ground) -> None:
        self._scenario, self._scene, self._route, self._ground = scenario, scene, route, ground
        self.looks: dict[str, UserLook] = {user.id: user_look(user.model, scene) for user in scenario.road_users}
        """Of the scenario's own road users, by id."""
        self._kept = _kept(scenario, scene)
        self._rules: dict[str, Behaviour] = {}
        self._present: dict[str, RoadUser | None] = {}
        self.everybody: tuple[RoadUser, ...] = ()
        """Each road user that was ever there, as it came."""
        self.reset()

    def reset(self) -> None:
        self.everybody = ()
        self._rules, self._present = {}, {}
        for user in self._scenario.road_users:
            rule = self._rules[user.id] = user.behaviour.begin(self._scene, self._scenario.start_s)
            begins = rule.start(self._placed(user))
            self._present[user.id] = begins if begins is None else self._grounded(begins, user.id)
        for actor in self._kept:
            track = RecordedTrack(self._scene, actor, self._scenario.start_s)
            self._rules[actor.id], self._present[actor.id] = track, track.at(0.0)
        self._meet()

    @property
    def users(self) -> tuple[RoadUser, ...]:
        """Who is there now."""
        return tuple(user for user in self._present.values() if user is not None)

    def advance(self, time_s: float, ego: RoadUser, dt_s: float) -> None:
        """Move everybody on, each as all others were before."""
        before = self._present
        self._present = {}
        for id, rule in self._rules.items():
            others = tuple(user for key, user in before.items() if user is not None and key != id)
            moved = rule.next(before[id], Surroundings(time_s, ego, others, self._route), dt_s)
            self._present[id] = moved if moved is None else self._grounded(moved, id)
        self._meet()

    def _placed(self, user: ScenarioUser) -> RoadUser:
        """Put a road user where the scenario says, measured from the ego vehicle's middle at the start."""
        x, y, yaw = start_place(user, self._scenario, self._scene, self._route)
        size = user.size_lwh_m or self.looks[user.id].size_lwh_m
        return RoadUser(user.id, user.class_name, size, x, y, yaw, user.speed_m_s)

    def _grounded(self, user: RoadUser, id: str) -> RoadUser:
        """Stand a road user on the ground; a recorded one stays at its own height."""
        return user if id not in self.looks else user.moved(z_m=self._ground.height_m(user.x_m, user.y_m))

    def _meet(self) -> None:
        known = {user.id for user in self.everybody}
        self.everybody = (*self.everybody, *(user for user in self.users if user.id not in known))


def _kept(scenario: Scenario, scene: Scene) -> tuple[Actor, ...]:
    actors = {actor.id: actor for actor in scene.actors}
    names = tuple(id for id, actor in actors.items() if actor.visible) if scenario.keep == "all" else scenario.keep
    for name in names:
        if name not in actors:
            known = ", ".join(actors) or "none"
            raise ValueError(
                f"scenario {scenario.name}: scene {scene.name!r} has no actor {name!r} to keep, only {known}"
            )
    taken = next((user.id for user in scenario.road_users if user.id in names), None)
    if taken is not None:
        raise ValueError(f"scenario {scenario.name}: road user {taken!r} is called like an actor that it keeps")
    return tuple(actors[name] for name in names)
