"""Agents by name: shipped, of other packages, and where nobody is named."""

import sys

import pytest

from gsrain_engine.evaluation.detection.detector import PLACE, find_detector
from gsrain_engine.simulation.agents import registry
from gsrain_engine.simulation.agents.base import Agent
from gsrain_engine.simulation.agents.registry import AgentOptions, agent_names, default_agent, open_agent

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
_ENTRIES = """[gsrain.agents]
slow = slow_driver:Slow
broken = slow_driver:broken
other = slow_driver:other
absent = no_such_module_of_slow:Agent
oracle-idm = slow_driver:Slow
"""


@pytest.fixture
def package(tmp_path, monkeypatch):
    """An installed package with agents."""
    (tmp_path / "slow_driver.py").write_text(_MODULE, encoding="utf-8")
    info = tmp_path / "slow_driver-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: slow-driver\nVersion: 1.0\n", encoding="utf-8")
    (info / "entry_points.txt").write_text(_ENTRIES, encoding="utf-8")
    monkeypatch.syspath_prepend(str(tmp_path))
    yield
    sys.modules.pop("slow_driver", None)


@pytest.fixture
def nowhere(tmp_path, monkeypatch):
    """A person without a detector."""
    monkeypatch.delenv(PLACE, raising=False)
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path))
    return tmp_path / "gsrain" / "detectors"


def test_agents_of_installed_packages_come_after_ours(package):
    names = agent_names()
    assert names[:3] == ["constant-velocity", "oracle-idm", "camera-idm"]
    assert names[-4:] == ["absent", "broken", "other", "slow"]
    assert names.count("oracle-idm") == 1
    agent = open_agent("slow", AgentOptions(url="http://localhost:9000"))
    assert isinstance(agent, Agent)
    assert (agent.name, agent.url) == ("slow", "http://localhost:9000")
    assert open_agent("oracle-idm").name == "oracle-idm"  # nobody can pass for a shipped one


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("absent", r"agent absent \(no_such_module_of_slow:Agent of slow-driver\): No module named"),
        ("broken", r"agent broken \(slow_driver:broken of slow-driver\): line 10 of slow_driver.py: no weights"),
        ("other", "makes a int, which has not"),
        ("nobody", "agent nobody: there is none of that name, only constant-velocity, .*slow"),
    ],
)
def test_what_fails_is_named_with_its_package(package, name, says):
    with pytest.raises(ValueError, match=says):
        open_agent(name)


def test_without_a_detector_the_oracle_drives_and_it_is_said_why(nowhere):
    name, reason = default_agent(AgentOptions())
    assert name == "oracle-idm"
    assert str(nowhere) in reason and "yolox_nano.onnx" in reason and PLACE in reason
    pytest.importorskip("onnxruntime")
    with pytest.raises(ValueError, match="agent camera-idm: no detector"):
        open_agent("camera-idm")


def test_a_detector_is_found_in_the_persons_folder_and_by_the_variable(nowhere, tmp_path, monkeypatch):
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
    monkeypatch.setenv(PLACE, str(nowhere))
    assert find_detector() == nowhere / "a.onnx"


def test_where_a_camera_can_see_it_drives(nowhere, monkeypatch):
    monkeypatch.setattr(registry.importlib.util, "find_spec", lambda name: object())
    assert default_agent(AgentOptions(detector=nowhere / "x.onnx")) == ("camera-idm", None)
    nowhere.mkdir(parents=True)
    (nowhere / "a.onnx").touch()
    assert default_agent(AgentOptions()) == ("camera-idm", None)
    monkeypatch.setattr(registry.importlib.util, "find_spec", lambda name: None)
    name, reason = default_agent(AgentOptions())
    assert name == "oracle-idm" and "gsrain[drive]" in reason


def test_a_file_that_is_no_detector_is_named(tmp_path):
    pytest.importorskip("onnxruntime")
    bad = tmp_path / "bad.onnx"
    bad.write_bytes(b"not a network")
    with pytest.raises(ValueError, match=r"bad\.onnx"):
        open_agent("camera-idm", AgentOptions(detector=bad))
