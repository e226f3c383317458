"""The documentation of scenarios names every field that a scenario file may have, and no other behaviour."""

import typing
from pathlib import Path

import msgspec
import pytest

from gsrain_engine.simulation.controller_base import ControllerSettings
from gsrain_engine.simulation.scenario import Scenario, ScenarioUser
from gsrain_engine.simulation.traffic.models import BehaviorSettings
from gsrain_engine.simulation.traffic.tracks import TrackPoint
from gsrain_engine.simulation.vehicle import Vehicle

_DOCS = Path(__file__).parents[1] / "docs"
_BEHAVIOURS = typing.get_args(BehaviorSettings)


def _text(page: str) -> str:
    return (_DOCS / page).read_text(encoding="utf-8")


@pytest.mark.parametrize("kind", [Scenario, ScenarioUser, Vehicle, ControllerSettings])
def test_every_field_of_a_scenario_stands_in_formats(kind):
    section = _text("formats.md").split("\n## Scenarios\n")[1].split("\n## ")[0]
    assert [name for name in kind.__struct_fields__ if f"`{name}`" not in section] == []


@pytest.mark.parametrize("kind", [*_BEHAVIOURS, TrackPoint])
def test_every_field_of_a_behaviour_stands_in_driving(kind):
    section = _text("driving.md").split("\n## Scenarios\n")[1].split("\n## ")[0]
    tag = kind.__struct_config__.tag
    assert tag is None or f"`{tag}`" in section
    assert [name for name in kind.__struct_fields__ if f"`{name}`" not in section] == []


def test_the_pages_examples_can_be_read():
    example = _text("driving.md").split("```yaml\n")[1].split("```")[0]
    assert msgspec.yaml.decode(example, type=Scenario).road_users[0].ahead_m == 40
    said = _text("driving.md").split(": `behaviour: ")[1].split("`.")[0]
    assert msgspec.yaml.decode(said, type=BehaviorSettings).gap_m == 15
