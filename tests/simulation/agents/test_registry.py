"""Agents by name: shipped ones, those of other packages, those in Python files, and the default."""

import sys

import numpy as np
import pytest

from extension_package import installed
from gsrain_engine.evaluation.detection.detector import PLACE
from gsrain_engine.simulation.agents import registry
from gsrain_engine.simulation.agents.base import Agent
from gsrain_engine.simulation.agents.registry import AgentOptions, agent_file, agent_names, default_agent, open_agent

_DRIVER = """
import numpy as np
from gsrain_engine.simulation.agents.base import SensorRequirements, Trajectory
SPEED = 4.0

class Slow:
    name = "slow"
    needs = SensorRequirements()
    def reset(self, seed, rig): pass
    def plan(self, observation): return Trajectory(np.array([[SPEED * 0.5, 0.0]]))
    def close(self): pass

class Helper:
    def help(self): pass
"""
_MAKERS = """
class Named(Slow):
    def __init__(self, options):
        self.url = options.url

def made(options):
    return Named(options)

def broken(options):
    raise RuntimeError("no weights")

def other():
    return 3
"""
URL = "http://localhost:9000"


@pytest.fixture
def package(tmp_path):
    makers = {"slow": "Named", "broken": "broken", "other": "other", "oracle-idm": "Slow"}
    entries = {name: f"slow_driver:{maker}" for name, maker in makers.items()}
    entries["absent"] = "no_such_module_of_slow:Agent"
    with installed(tmp_path, "slow-driver", {"slow_driver.py": _DRIVER + _MAKERS}, {"gsrain.agents": entries}):
        yield


def test_agents_of_installed_packages_come_after_shipped_ones(package):
    names = agent_names()
    assert names[:3] == ["constant-velocity", "oracle-idm", "camera-idm"] and names.count("oracle-idm") == 1
    assert names[-4:] == ["absent", "broken", "other", "slow"]
    agent = open_agent("slow", AgentOptions(url=URL))
    assert isinstance(agent, Agent) and (agent.name, agent.url) == ("slow", URL)
    assert open_agent("oracle-idm").name == "oracle-idm"  # no package replaces a shipped one


@pytest.mark.parametrize(
    ("name", "word"),
    [("absent", "slow-driver"), ("broken", "slow-driver.*no weights"), ("other", "slow-driver"), ("nobody", "slow"),
     ("http", "--url")],
)  # fmt: skip
def test_agents_that_fail_are_named_with_their_package(package, name, word):
    with pytest.raises(ValueError, match=f"agent {name}.*{word}"):
        open_agent(name)


def test_a_camera_drives_where_a_detector_is_found(tmp_path, monkeypatch):
    monkeypatch.delenv(PLACE, raising=False)
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path))
    name, reason = default_agent(AgentOptions())
    assert name == "oracle-idm" and str(tmp_path / "gsrain" / "detectors") in reason and PLACE in reason
    with pytest.raises(ValueError, match="camera-idm"):
        open_agent("camera-idm")
    detector = tmp_path / "own.onnx"
    detector.write_bytes(b"not a network")
    with pytest.raises(ValueError, match=r"own\.onnx"):
        open_agent("camera-idm", AgentOptions(detector=detector))
    assert default_agent(AgentOptions(detector=detector)) == ("camera-idm", None)
    monkeypatch.setenv(PLACE, str(detector))
    monkeypatch.setattr(registry, "has_package", lambda name: True)
    assert default_agent(AgentOptions()) == ("camera-idm", None)
    monkeypatch.setattr(registry, "has_package", lambda name: False)
    assert default_agent(AgentOptions())[0] == "oracle-idm"


@pytest.fixture
def written(tmp_path, monkeypatch):
    """Writes a driver that imports a file next to it."""
    (tmp_path / "next_to_it.py").write_text("SPEED = 4.0\n", encoding="utf-8")
    monkeypatch.setattr(sys, "path", list(sys.path))

    def write(text):
        path = tmp_path / "my_driver.py"
        path.write_text(text.replace("SPEED = 4.0", "from next_to_it import SPEED"), encoding="utf-8")
        return str(path)

    yield write
    for name in ("next_to_it", "gsrain_agent_my_driver"):
        sys.modules.pop(name, None)


def test_an_agent_in_a_file_alone_or_one_of_several_by_name(written):
    assert agent_file("oracle-idm") is None
    assert str(agent_file("a/b.py")) == str(agent_file("a/b.py:Slow")) == "a/b.py"
    np.testing.assert_array_equal(open_agent(written(_DRIVER)).plan(None).points, [[2.0, 0.0]])
    path = written(_DRIVER + _MAKERS)
    assert [open_agent(f"{path}:{name}", AgentOptions(url=URL)).url for name in ("Named", "made")] == [URL, URL]


@pytest.mark.parametrize(
    ("text", "name", "word"),
    [
        (_DRIVER + _MAKERS, "", "Slow, Named"),
        (_DRIVER + _MAKERS, ":absent", "absent"),
        (_DRIVER + _MAKERS, ":other", "int"),
        (_DRIVER + _MAKERS, ":broken", "no weights"),
        ("class A:\n    pass\n", "", "reset, plan, close"),
        ("x = 1\nraise RuntimeError('cold')\n", "", "line 2: cold"),
        ("x = 1\nclass\n", "", "line 2: "),
        ("", "x.py", "no such file"),
    ],
)
def test_a_file_without_an_agent_is_refused_with_its_line(written, text, name, word):
    with pytest.raises(ValueError, match=rf"my_driver\.py.*{word}"):
        open_agent(written(text) + name)
