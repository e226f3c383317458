import logging
from dataclasses import replace

import pytest

from gsrain_engine.simulation.scenario import Scenario
from gsrain_engine.simulation.simulation import Simulation
from small_scene import small_scene


def test_a_scenario_of_the_street_elsewhere_is_told_of(caplog: pytest.LogCaptureFixture):
    test, scene = Scenario(name="short", duration_s=0.5, speed_m_s=2.0), replace(small_scene(), name="yard")
    with caplog.at_level(logging.WARNING, "gsrain"):
        Simulation(test, scene)
        assert "scenario short is made for the built-in street, and is driven in scene 'yard'" in caplog.text
        caplog.clear()
        Simulation(test, replace(scene, name="street"))
        Simulation(Scenario(name="short", duration_s=0.5, speed_m_s=2.0, scene="out/yard"), scene)
        assert caplog.text == ""
