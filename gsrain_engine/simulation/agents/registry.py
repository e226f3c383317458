"""Registry of agents: shipped ones, those of installed packages, and those in Python files."""

import inspect
import sys
from collections.abc import Callable
from pathlib import Path
from traceback import walk_tb
from types import ModuleType
from typing import Any

from ...evaluation.detection.detector import find_detector
from ...optional_packages import has_package, missing_package
from ...plugins import AGENTS, Extension, find_extension, find_extensions
from ...trusted_code import Code, check_trusted, read_code, run_main
from .base import Agent, ConstantVelocityAgent
from .http import HttpAgent
from .idm import OracleIDMAgent
from .neuroncap import NeuroNCAPBaselineAgent
from .options import SHIPPED_AGENTS, AgentOptions


def _camera_idm(options: AgentOptions) -> Agent:
    # onnxruntime is heavy and optional; import it only for camera agents
    from ...evaluation.detection.detector import open_detector
    from .idm import CameraIDMAgent

    try:
        return CameraIDMAgent(open_detector(options.detector or find_detector(), options.description))
    except (FileNotFoundError, ModuleNotFoundError) as error:
        raise ValueError(f"agent camera-idm: {error}") from None


def _http(options: AgentOptions) -> Agent:
    if options.url is None:
        raise ValueError("agent http: say where it listens (--url http://HOST:PORT)")
    return HttpAgent(options.url)


def _without_options(kind: Callable[[], Agent]) -> Callable[[AgentOptions], Agent]:
    return lambda options: kind()


_OPENERS: dict[str, Callable[[AgentOptions], Agent]] = {
    "constant-velocity": _without_options(ConstantVelocityAgent),
    "oracle-idm": _without_options(OracleIDMAgent),
    "camera-idm": _camera_idm,
    "neuroncap-baseline": _without_options(NeuroNCAPBaselineAgent),
    "http": _http,
}


def agent_names() -> list[str]:
    """Return the names of all agents, shipped ones first."""
    return [*SHIPPED_AGENTS, *(each.name for each in find_extensions(AGENTS) if each.name not in SHIPPED_AGENTS)]


def options_used_by(name: str) -> tuple[str, ...]:
    """Return the fields of `AgentOptions` that an agent uses; all, for one of another package or of a file."""
    return SHIPPED_AGENTS[name].uses if name in SHIPPED_AGENTS else AgentOptions.__struct_fields__


def open_agent(name: str, options: AgentOptions | None = None, *, trusted_only: bool = False) -> Agent:
    """Open an agent: one of `agent_names`, or one in a Python file (`my_driver.py`).

    With `trusted_only`, for names read from files, a Python file runs only if its content is trusted. Raises ValueError
    for an unknown name, missing requirements, or a failing plugin.
    """
    options = options or AgentOptions()
    if (path := agent_file(name)) is not None:
        return _agent_in_file(path, name, options, trusted_only)
    if name in SHIPPED_AGENTS:
        return _OPENERS[name](options)
    if (extension := find_extension(AGENTS, name)) is not None:
        return _of_package(extension, options)
    raise ValueError(f"agent {name}: there is none of that name, only {', '.join(agent_names())}")


def default_agent(options: AgentOptions) -> tuple[str, str | None]:
    """Return the default agent: camera-idm, or oracle-idm with the reason why camera-idm is unavailable.

    A detector that exists but can't be opened is no such reason: opening the agent reports its error.
    """
    if options.detector is not None:
        return "camera-idm", None
    if not has_package("onnxruntime"):
        return "oracle-idm", f"{_INSTEAD}: {missing_package('onnxruntime', 'it', 'drive')}"
    try:
        find_detector()
    except FileNotFoundError as error:
        return "oracle-idm", f"{_INSTEAD}: {error}"
    return "camera-idm", None


def _of_package(extension: Extension, options: AgentOptions) -> Agent:
    """Create an agent of an installed package; errors name the package."""
    maker = extension.load_callable()
    try:
        agent = maker(options)
    except Exception as error:  # third-party code may raise anything
        raise extension.unfit(error) from error
    if isinstance(agent, Agent):
        return agent
    raise extension.unfit(
        f"makes a {type(agent).__name__}, which has not the properties and methods of an agent: {_OF_AGENTS}"
    )


_INSTEAD = "oracle-idm drives instead of camera-idm"


# Agents in Python files: `my_driver.py`, or `my_driver.py:NAME` to select one of several

_SUFFIX = ".py"
_METHODS = ("reset", "plan", "close")
_OF_AGENTS = "name, needs, reset, plan, close"


def agent_file(name: str) -> Path | None:
    """Return the file of an agent name; None for a registered name."""
    place = name.rpartition(":")[0] if ":" in name and not name.endswith(_SUFFIX) else name
    return Path(place) if place.endswith(_SUFFIX) else None


def agent_code(path: Path) -> Code:
    """Read the file of an agent with its local imports. Raises ValueError if it is missing."""
    if not path.is_file():
        raise ValueError(f"agent {path}: no such file")
    return read_code(path)


def _agent_in_file(path: Path, name: str, options: AgentOptions, trusted_only: bool) -> Agent:
    """Run a Python file and create its agent.

    `FILE.py` has one class with the methods of an agent; `FILE.py:NAME` names a class, or a function that returns an
    agent. The options are passed if the class or function takes an argument.
    """
    chosen = "" if name.endswith(_SUFFIX) else name[len(str(path)) + 1 :]
    module = _module(path, name, trusted_only)
    maker = getattr(module, chosen, None) if chosen else _only_class(module, name)
    if not callable(maker):
        raise ValueError(f"agent {name}: has no class or function {chosen}")
    try:
        agent = maker(options) if _takes_one(maker) else maker()
    except Exception as error:  # third-party code may raise anything
        raise ValueError(f"agent {name}: {error or type(error).__name__}") from error
    if not isinstance(agent, Agent):
        absent = ", ".join(each for each in ("name", "needs", *_METHODS) if not hasattr(agent, each))
        kind = type(agent).__name__
        raise ValueError(f"agent {name}: is a {kind}, which has no {absent}: an agent has {_OF_AGENTS}")
    return agent


def _module(path: Path, name: str, trusted_only: bool) -> ModuleType:
    code = agent_code(path)
    folder = str(path.absolute().parent)
    if trusted_only:
        check_trusted(f"agent {name}", [code])
    elif folder not in sys.path:
        sys.path.insert(0, folder)  # allows imports from the same folder, as when Python runs the file
    try:
        return run_main(code, f"gsrain_agent_{path.stem}")
    except Exception as error:
        raise ValueError(f"agent {name}: {_where(error, path)}{error or type(error).__name__}") from error


def _where(error: BaseException, path: Path) -> str:
    """Return the last line of the agent's own file in a traceback, as "line 12: "."""
    own = str(path.absolute())
    lines = [line for frame, line in walk_tb(error.__traceback__) if frame.f_code.co_filename == own]
    if isinstance(error, SyntaxError) and error.lineno and not lines:
        lines = [error.lineno]
    return f"line {lines[-1]}: " if lines else ""


def _only_class(module: ModuleType, name: str) -> Any:
    own = [each for each in vars(module).values() if inspect.isclass(each) and each.__module__ == module.__name__]
    found = [each for each in own if all(callable(getattr(each, method, None)) for method in _METHODS)]
    if len(found) == 1:
        return found[0]
    if not found:
        raise ValueError(f"agent {name}: has no class with the methods {', '.join(_METHODS)}")
    names = ", ".join(each.__name__ for each in found)
    raise ValueError(f"agent {name}: has several agents: say which as {name}:NAME, one of {names}")


def _takes_one(maker: Any) -> bool:
    """Return whether a class or function takes a positional argument."""
    try:
        parameters = inspect.signature(maker).parameters.values()
    except (TypeError, ValueError):
        return False
    return any(each.kind in (each.POSITIONAL_ONLY, each.POSITIONAL_OR_KEYWORD) for each in parameters)
