"""The drive that a person prepares: a scenario that can be changed, who drives it, in which rain."""

from functools import cached_property
from pathlib import Path

import msgspec

from gsrain_engine.drive.agents.registry import agent_names
from gsrain_engine.drive.scenario.saved_scenario import save_scenario
from gsrain_engine.drive.scenario.scenario import Scenario, ScenarioUser
from gsrain_engine.drive.scenario.scenario_files import load_scenario, scenario_names

from ..log import told
from .drive_wishes import DriveWishes

_FIRST = "stationary-lead"
_DRIVERS = ("oracle-idm", "constant-velocity")
"""Who is taken first, of those that there are."""


class WantedDrive:
    """What the next drive will be."""

    def __init__(self) -> None:
        self.problem: str | None = None
        """What went wrong with a scenario's file last."""
        self.source = _FIRST
        """Name of the shipped scenario, or path of the file, that it was read from."""
        self.is_changed = False
        """Whether the scenario differs from what was read."""

    @cached_property
    def scenario_names(self) -> list[str]:
        return scenario_names()

    @cached_property
    def agent_names(self) -> list[str]:
        """Everybody who can drive; looking for installed ones takes too long for each frame."""
        return agent_names()

    @property
    def scenario(self) -> Scenario:
        return self._scenario

    @property
    def wishes(self) -> DriveWishes:
        return self._wishes

    @wishes.setter
    def wishes(self, wishes: DriveWishes) -> None:
        self._wishes = wishes

    @cached_property
    def _scenario(self) -> Scenario:
        return load_scenario(_FIRST)

    @cached_property
    def _wishes(self) -> DriveWishes:
        there = self.agent_names
        return DriveWishes(agent=next((name for name in _DRIVERS if name in there), there[0]))

    @property
    def why_not(self) -> str | None:
        """What stands in the way of it; None when nothing does."""
        if self.wishes.agent not in self.agent_names:
            return f"There is no agent {self.wishes.agent}."
        if self.wishes.detector is not None and not self.wishes.detector.is_file():
            return f"{self.wishes.detector}: there is no such detector."
        return None

    def load(self, source: str | Path) -> None:
        """Take a shipped scenario by its name, or one from a file; what is wrong with it is told in `problem`."""
        try:
            scenario = load_scenario(source)
        except (ValueError, OSError) as error:
            self.problem = told(f"{source} can't be opened", error)
            return
        self._scenario, self.source, self.is_changed, self.problem = scenario, str(source), False, None

    def save(self, path: Path) -> None:
        """Write the scenario as it is now; it is this file's from then on."""
        path = path if path.suffix else path.with_suffix(".yaml")
        try:
            save_scenario(self.scenario, path)
        except OSError as error:
            self.problem = told(f"{path} can't be written", error)
            return
        self.source, self.is_changed, self.problem = str(path), False, None

    def change(self, scenario: Scenario) -> None:
        """Go on with a changed scenario; one that contradicts itself is not taken, and said in `problem`."""
        if scenario == self.scenario:
            return
        try:
            self._scenario = msgspec.convert(msgspec.to_builtins(scenario), Scenario)
        except ValueError as error:
            self.problem = str(error)
            return
        self.is_changed, self.problem = True, None

    def change_user(self, number: int, user: ScenarioUser) -> None:
        """Change one of the scenario's road users."""
        users = (*self.scenario.road_users[:number], user, *self.scenario.road_users[number + 1 :])
        self.change(msgspec.structs.replace(self.scenario, road_users=users))
