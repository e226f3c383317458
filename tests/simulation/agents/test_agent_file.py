"""Agents in a Python file of one's own: which one is meant, and what is wrong with it in a sentence."""

import sys

import numpy as np
import pytest

from gsrain_engine.simulation.agents.registry import AgentOptions, agent_file, open_agent

_AGENT = """
import numpy as np
from gsrain_engine.simulation.agents.base import SensorRequirements, Trajectory
from beside_it import SPEED

class Slow:
    name = "slow"
    needs = SensorRequirements()
    def reset(self, seed, rig): pass
    def plan(self, observation): return Trajectory(np.array([[SPEED * 0.5, 0.0]]))
    def close(self): pass

class Helper:
    def help(self): pass
"""
_SECOND = """
class Named(Slow):
    def __init__(self, options):
        self.url = options.url

def made(options):
    return Named(options)

def nothing():
    return 3
"""


@pytest.fixture
def written(tmp_path, monkeypatch):
    """Write a driver, and beside it what it imports."""
    (tmp_path / "beside_it.py").write_text("SPEED = 4.0\n", encoding="utf-8")
    monkeypatch.setattr(sys, "path", list(sys.path))

    def write(text):
        path = tmp_path / "my_driver.py"
        path.write_text(text, encoding="utf-8")
        return str(path)

    yield write
    for name in ("beside_it", "gsrain_agent_my_driver"):
        sys.modules.pop(name, None)


def test_only_python_files_are_meant(tmp_path):
    assert agent_file("oracle-idm") is None and agent_file("http") is None
    assert str(agent_file("a/b.py")) == str(agent_file("a/b.py:Slow")) == "a/b.py"


def test_the_only_agent_of_a_file(written):
    agent = open_agent(written(_AGENT))
    assert agent.name == "slow"
    np.testing.assert_array_equal(agent.plan(None).points, [[2.0, 0.0]])


def test_one_of_several_by_name_with_options(written):
    path = written(_AGENT + _SECOND)
    for name in ("Named", "made"):
        assert open_agent(f"{path}:{name}", AgentOptions(url="http://here")).url == "http://here"


@pytest.mark.parametrize(
    ("text", "name", "words"),
    [
        (_AGENT + _SECOND, "", "several agents: say which as .*my_driver.py:NAME, one of Slow, Named"),
        (_AGENT + _SECOND, ":absent", "has no class or function absent"),
        (_AGENT + _SECOND, ":nothing", "is a int, which has no name, needs, reset, plan, close"),
        ("class A:\n    pass\n", "", "has no class with the methods reset, plan, close"),
        ("x = 1\nraise RuntimeError('no weights')\n", "", "my_driver.py: line 2: no weights"),
        ("x = 1\nclass\n", "", "my_driver.py: line 2: "),
    ],
)
def test_what_is_wrong_is_said(written, text, name, words):
    with pytest.raises(ValueError, match=words):
        open_agent(written(text) + name)


def test_an_absent_file_is_named(tmp_path):
    with pytest.raises(ValueError, match=r"none\.py: no such file"):
        open_agent(str(tmp_path / "none.py"))
