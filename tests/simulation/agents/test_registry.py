"""Agents by name: shipped, of other packages, in Python files, and where nobody is named."""

import sys

import numpy as np
import pytest

from extension_package import installed
from gsrain_engine.evaluation.detection.detector import PLACE, find_detector
from gsrain_engine.simulation.agents import registry
from gsrain_engine.simulation.agents.base import Agent
from gsrain_engine.simulation.agents.registry import AgentOptions, agent_file, agent_names, default_agent, open_agent

_MODULE = """
from gsrain_engine.simulation.agents.base import ConstantVelocityAgent

class Slow(ConstantVelocityAgent):
    name = "slow"
    def __init__(self, options):
        self.url = options.url

def broken(options):
    raise RuntimeError("no weights")

def other(options):
    return 3
"""
_ENTRIES = {"slow": "Slow", "broken": "broken", "other": "other", "oracle-idm": "Slow"}


@pytest.fixture
def package(tmp_path):
    entries = {name: f"slow_driver:{maker}" for name, maker in _ENTRIES.items()}
    entries["absent"] = "no_such_module_of_slow:Agent"
    with installed(tmp_path, "slow-driver", {"slow_driver.py": _MODULE}, {"gsrain.agents": entries}):
        yield


@pytest.fixture
def nowhere(tmp_path, monkeypatch):
    """A person without a detector."""
    monkeypatch.delenv(PLACE, raising=False)
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path))
    return tmp_path / "gsrain" / "detectors"


def test_agents_of_installed_packages_come_after_ours(package):
    names = agent_names()
    assert names[:3] == ["constant-velocity", "oracle-idm", "camera-idm"] and names.count("oracle-idm") == 1
    assert names[-4:] == ["absent", "broken", "other", "slow"]
    agent = open_agent("slow", AgentOptions(url="http://localhost:9000"))
    assert isinstance(agent, Agent) and (agent.name, agent.url) == ("slow", "http://localhost:9000")
    assert open_agent("oracle-idm").name == "oracle-idm"  # nobody can pass for a shipped one


@pytest.mark.parametrize(
    ("name", "place"),
    [
        ("absent", r"absent \(no_such_module_of_slow:Agent of slow-driver\)"),
        ("broken", r"broken \(slow_driver:broken of slow-driver\): line 10 of slow_driver.py: no weights"),
        ("other", "other .*slow-driver.*int"),
        ("nobody", "nobody: .*constant-velocity, .*slow"),
        ("http", "http: .*--url"),
    ],
)
def test_agents_that_fail_are_named_with_their_package(package, name, place):
    with pytest.raises(ValueError, match=f"agent {place}"):
        open_agent(name)


def test_without_a_detector_the_oracle_drives(nowhere, tmp_path):
    name, reason = default_agent(AgentOptions())
    assert name == "oracle-idm"
    assert str(nowhere) in reason and "yolox_nano.onnx" in reason and PLACE in reason
    pytest.importorskip("onnxruntime")
    with pytest.raises(ValueError, match="camera-idm"):
        open_agent("camera-idm")
    (tmp_path / "bad.onnx").write_bytes(b"not a network")
    with pytest.raises(ValueError, match=r"bad\.onnx"):
        open_agent("camera-idm", AgentOptions(detector=tmp_path / "bad.onnx"))


def test_a_detector_in_the_persons_folder_or_by_the_variable_lets_a_camera_drive(nowhere, tmp_path, monkeypatch):
    nowhere.mkdir(parents=True)
    for name in ("b.onnx", "a.onnx", "a.yaml"):
        (nowhere / name).touch()
    assert find_detector() == nowhere / "a.onnx"
    own = tmp_path / "own.onnx"
    monkeypatch.setenv(PLACE, str(own))
    with pytest.raises(FileNotFoundError, match=r"own\.onnx"):
        find_detector()
    own.touch()
    assert find_detector() == own
    monkeypatch.setattr(registry.importlib.util, "find_spec", lambda name: object())
    for options in (AgentOptions(), AgentOptions(detector=nowhere / "x.onnx")):
        assert default_agent(options) == ("camera-idm", None)
    monkeypatch.setattr(registry.importlib.util, "find_spec", lambda name: None)
    name, reason = default_agent(AgentOptions())
    assert name == "oracle-idm" and "gsrain[drive]" in reason


# Python files

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
    """Write a driver, and next to it what it imports."""
    (tmp_path / "beside_it.py").write_text("SPEED = 4.0\n", encoding="utf-8")
    monkeypatch.setattr(sys, "path", list(sys.path))

    def write(text):
        path = tmp_path / "my_driver.py"
        path.write_text(text, encoding="utf-8")
        return str(path)

    yield write
    for name in ("beside_it", "gsrain_agent_my_driver"):
        sys.modules.pop(name, None)


def test_an_agent_in_a_file_alone_or_one_of_several_by_name_with_options(written):
    assert agent_file("oracle-idm") is None
    assert str(agent_file("a/b.py")) == str(agent_file("a/b.py:Slow")) == "a/b.py"
    agent = open_agent(written(_AGENT))
    assert agent.name == "slow"
    np.testing.assert_array_equal(agent.plan(None).points, [[2.0, 0.0]])
    path = written(_AGENT + _SECOND)
    for name in ("Named", "made"):
        assert open_agent(f"{path}:{name}", AgentOptions(url="http://here")).url == "http://here"


@pytest.mark.parametrize(
    ("text", "name", "words"),
    [
        (_AGENT + _SECOND, "", "Slow, Named"),
        (_AGENT + _SECOND, ":absent", "absent"),
        (_AGENT + _SECOND, ":nothing", "int.* name, needs, reset, plan, close"),
        ("class A:\n    pass\n", "", "reset, plan, close"),
        ("x = 1\nraise RuntimeError('no weights')\n", "", "line 2: no weights"),
        ("x = 1\nclass\n", "", "line 2: "),
        (_AGENT.replace("def reset(self", "def __init__(self): raise RuntimeError('cold')\n    def reset(self"), "",
         "cold"),
        ("", "x.py", "no such file"),
    ],
)  # fmt: skip
def test_a_file_without_an_agent_is_refused_with_its_line(written, text, name, words):
    with pytest.raises(ValueError, match=rf"my_driver\.py.*{words}"):
        open_agent(written(text) + name)
