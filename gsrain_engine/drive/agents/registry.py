"""Which agents there are: the shipped ones and those of installed packages, by name."""

import importlib.util
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from gsrain_engine.evaluate.detection.detector_place import find_detector
from gsrain_engine.extensions import AGENTS, Extension, extension, extensions

from .agent import Agent
from .agent_file import agent_file, agent_in_file
from .constant_velocity import ConstantVelocityAgent
from .http_agent import HttpAgent
from .neuroncap_baseline import NeuroNCAPBaselineAgent
from .oracle_idm import OracleIDMAgent


@dataclass(frozen=True, slots=True)
class AgentOptions:
    """What a person may give an agent."""

    detector: Path | None = None
    """ONNX file of a detector."""
    description: str | None = None
    """How the detector is used: a shipped name or a YAML file."""
    url: str | None = None
    """Where an agent listens that runs elsewhere."""


def _camera_idm(options: AgentOptions) -> Agent:
    # onnxruntime is heavy, and an extra: only where somebody sees.
    from gsrain_engine.evaluate.detection.detector import open_detector

    from .camera_idm import CameraIDMAgent

    try:
        return CameraIDMAgent(open_detector(options.detector or find_detector(), options.description))
    except (FileNotFoundError, ModuleNotFoundError) as error:
        raise ValueError(f"agent camera-idm: {error}") from None


def _http(options: AgentOptions) -> Agent:
    if options.url is None:
        raise ValueError("agent http: say where it listens (--url http://HOST:PORT)")
    return HttpAgent(options.url)


_SHIPPED: dict[str, Callable[[AgentOptions], Agent]] = {
    "constant-velocity": lambda options: ConstantVelocityAgent(),
    "oracle-idm": lambda options: OracleIDMAgent(),
    "camera-idm": _camera_idm,
    "neuroncap-baseline": lambda options: NeuroNCAPBaselineAgent(),
    "http": _http,
}


def agent_names() -> list[str]:
    """Names of all agents, the shipped ones first."""
    return [*_SHIPPED, *(each.name for each in extensions(AGENTS) if each.name not in _SHIPPED)]


def open_agent(name: str, options: AgentOptions | None = None, *, trusted_only: bool = False) -> Agent:
    """Make an agent ready: one of `agent_names`, or the one in a file of one's own (`my_driver.py`).

    With `trusted_only`, for names that come out of files, a Python file runs only if a person has allowed its content.

    Raises ValueError for an unknown name, where what it needs is missing, and where an installed one fails.
    """
    options = options or AgentOptions()
    if agent_file(name) is not None:
        return agent_in_file(name, options, trusted_only=trusted_only)
    if name in _SHIPPED:
        return _SHIPPED[name](options)
    if (installed := extension(AGENTS, name)) is not None:
        return _installed(installed, options)
    raise ValueError(f"agent {name}: there is none of that name, only {', '.join(agent_names())}")


def default_agent(options: AgentOptions) -> tuple[str, str | None]:
    """Return who drives where nobody is named: camera-idm; or oracle-idm, with a sentence that says why no camera can.

    A detector that is there but can't be opened is no reason: opening the agent says what is wrong with it.
    """
    if options.detector is not None:
        return "camera-idm", None
    if importlib.util.find_spec("onnxruntime") is None:
        return "oracle-idm", f"{_INSTEAD}: onnxruntime is not installed (pip install 'gsrain[drive]')"
    try:
        find_detector()
    except FileNotFoundError as error:
        return "oracle-idm", f"{_INSTEAD}: {error}"
    return "camera-idm", None


_INSTEAD = "oracle-idm drives instead of camera-idm"


def _installed(extension: Extension, options: AgentOptions) -> Agent:
    """Make an agent of another package; whatever fails in there, the sentence names the package."""
    maker = extension.load_callable()
    try:
        agent = maker(options)
    except Exception as error:  # it is code of others: its words are the reason
        raise extension.unfit(error) from error
    if not isinstance(agent, Agent):
        raise extension.unfit(
            f"makes a {type(agent).__name__}, which has not the properties and methods of an agent: name, needs, "
            "reset, plan, close"
        )
    return agent
