"""The documentation of scenarios names every field that a scenario file may have; its examples can be read."""

import typing

import msgspec
import pytest

from gsrain_engine.simulation.scenario import Scenario, ScenarioUser
from gsrain_engine.simulation.traffic.settings import BehaviorSettings, TrackPoint
from gsrain_engine.simulation.vehicle_settings import ControllerSettings, Vehicle
from repository import REPOSITORY

PAGES = {
    "formats.md": (Scenario, ScenarioUser, Vehicle, ControllerSettings),
    "driving.md": (*typing.get_args(BehaviorSettings), TrackPoint),
}


def section(page: str) -> str:
    text = (REPOSITORY / "docs" / page).read_text(encoding="utf-8")
    return text.split("\n## Scenarios\n")[1].split("\n## ")[0]


@pytest.mark.parametrize(("page", "kind"), [(page, kind) for page, kinds in PAGES.items() for kind in kinds])
def test_every_field_is_documented(page, kind):
    names = [*kind.__struct_fields__, *filter(None, [kind.__struct_config__.tag])]
    assert [name for name in names if f"`{name}`" not in section(page)] == []


def test_examples_of_the_page_are_scenarios():
    text = (REPOSITORY / "docs" / "driving.md").read_text(encoding="utf-8")
    example = text.split("```yaml\n")[1].split("```")[0]
    assert msgspec.yaml.decode(example, type=Scenario).road_users[0].ahead_m == 40
    behavior = text.split(": `behaviour: ")[1].split("`.")[0]
    assert msgspec.yaml.decode(behavior, type=BehaviorSettings).gap_m == 15
