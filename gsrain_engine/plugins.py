"""Extensions: entry points of installed packages, one group for each kind."""

import ast
import logging
import sys
from dataclasses import dataclass
from functools import cached_property, lru_cache
from importlib.machinery import ModuleSpec, PathFinder
from importlib.metadata import entry_points
from importlib.util import find_spec
from pathlib import Path
from traceback import walk_tb
from typing import Any, NamedTuple, TypeVar

logger = logging.getLogger("gsrain")
_Kind = TypeVar("_Kind")


class EntryPointGroup(NamedTuple):
    """Group of entry points of one kind."""

    name: str
    """Group name in a package's metadata: gsrain.panels."""
    noun: str
    """Singular noun for messages."""


AGENTS = EntryPointGroup("gsrain.agents", "agent")
CAPTURE_FORMATS = EntryPointGroup("gsrain.capture_formats", "capture format")
COMMANDS = EntryPointGroup("gsrain.commands", "command")
DECODERS = EntryPointGroup("gsrain.decoders", "decoder")
DISDROMETERS = EntryPointGroup("gsrain.disdrometers", "disdrometer format")
DRIVE_EXPORTS = EntryPointGroup("gsrain.drive_exports", "drive export")
EVALUATIONS = EntryPointGroup("gsrain.evaluations", "evaluation")
MODELS = EntryPointGroup("gsrain.models", "library of models")
PANELS = EntryPointGroup("gsrain.panels", "panel")
PROTOCOLS = EntryPointGroup("gsrain.protocols", "protocol")
SCENARIO_FORMATS = EntryPointGroup("gsrain.scenario_formats", "scenario format")
SCENE_EDITS = EntryPointGroup("gsrain.scene_edits", "scene edit")
SCENE_FORMATS = EntryPointGroup("gsrain.scene_formats", "scene format")
SCENES = EntryPointGroup("gsrain.scenes", "scene")
SETTINGS = EntryPointGroup("gsrain.settings", "kind of settings")
TRANSFERS = EntryPointGroup("gsrain.transfers", "transfer")
GROUPS = (
    AGENTS, CAPTURE_FORMATS, COMMANDS, DECODERS, DISDROMETERS, DRIVE_EXPORTS, EVALUATIONS, MODELS, PANELS, PROTOCOLS,
    SCENARIO_FORMATS, SCENE_EDITS, SCENE_FORMATS, SCENES, SETTINGS, TRANSFERS,
)  # fmt: skip
"""All groups; docs/extending.md has an example of each."""


class ExtensionError(ValueError):
    """Error of an unusable extension; the message names it, its package and the reason."""


@dataclass(frozen=True, eq=False)
class Extension:
    """One entry point of another package. Its name is known at once; its code runs when it is loaded."""

    group: EntryPointGroup
    name: str
    place: str
    """Module and object: my_package.panels:CLOUDBURST."""
    package: str
    """Name of the package for pip; empty if unknown."""
    version: str
    _entry: Any
    """An EntryPoint of importlib.metadata, or of its backport if a library has replaced it."""

    @property
    def is_own(self) -> bool:
        """True for those of this program itself: the folders of `gsrain_extras`."""
        return self.package == "gsrain"

    @property
    def title(self) -> str:
        """Name in messages: panel cloudburst (my_package:PANEL of my-package)."""
        return f"{self.group.noun} {self.name} ({self.place} of {self.package or 'an installed package'})"

    @property
    def summary(self) -> str:
        """First paragraph of the function's docstring, read from its source without running it; "" if there is none."""
        module, _, name = self.place.partition(":")
        spec = _spec_of(module)
        if spec is None or spec.origin is None or not spec.origin.endswith(".py"):
            return ""
        tree = ast.parse(Path(spec.origin).read_bytes())
        functions = (each for each in tree.body if isinstance(each, ast.FunctionDef) and each.name == name)
        described = next((ast.get_docstring(each) or "" for each in functions), "")
        return " ".join(described.partition("\n\n")[0].split())

    def load(self, kind: type[_Kind]) -> _Kind:
        """Return the named object. Raises `ExtensionError` if it can't be imported or is of another kind."""
        return self.expect(self._loaded(), kind, "is")

    def load_callable(self) -> Any:
        """Return the named object. Raises `ExtensionError` if it can't be imported or called."""
        found = self._loaded()
        if not callable(found):
            raise self.unfit(f"is a {type(found).__name__}, which can't be called")
        return found

    def expect(self, found: object, kind: type[_Kind], how: str) -> _Kind:
        """Return `found` if it is of a kind; the error uses `how` as its verb (is, reads, gives).

        Raises `ExtensionError`.
        """
        if not isinstance(found, kind):
            raise self.unfit(f"{how} a {type(found).__name__}, not a {kind.__name__}")
        return found

    def unfit(self, reason: object) -> ExtensionError:
        """Return the error for a reason; an exception of the extension's code is quoted with its location."""
        if isinstance(reason, Exception):
            reason = self._where(reason) + (" ".join(str(reason).split()) or type(reason).__name__)
        return ExtensionError(f"{self.title}: {reason}")

    def _where(self, error: Exception) -> str:
        """Location of the extension's last line in an error's traceback; empty if it has none there."""
        package = self.place.partition(":")[0].partition(".")[0]
        passed = [
            f"line {line} of {Path(frame.f_code.co_filename).name}: "
            for frame, line in walk_tb(error.__traceback__)
            if str(frame.f_globals.get("__name__")).partition(".")[0] == package
        ]
        return passed[-1] if passed else ""

    def _loaded(self) -> Any:
        found, error = self._outcome
        if error is not None:
            raise self.unfit(error) from error
        return found

    @cached_property
    def _outcome(self) -> tuple[Any, Exception | None]:
        """Result of loading: the code runs once, however often the window asks."""
        try:
            return self._entry.load(), None
        except Exception as error:  # third-party code may raise anything: its message is the reason
            return None, error


def _spec_of(module: str) -> ModuleSpec | None:
    """Find a module without importing the packages that it is in."""
    first, *rest = module.split(".")
    spec = find_spec(first)
    for name in rest:
        if spec is None or spec.submodule_search_locations is None:
            return None
        spec = PathFinder.find_spec(f"{spec.name}.{name}", spec.submodule_search_locations)
    return spec


def find_extensions(group: EntryPointGroup) -> tuple[Extension, ...]:
    """Extensions of one kind in installed packages, by name; of several with one name, the first found."""
    return _found(group, tuple(sys.path))


def find_extension(group: EntryPointGroup, name: str) -> Extension | None:
    return next((each for each in find_extensions(group) if each.name == name), None)


def load_extensions(group: EntryPointGroup, kind: type[_Kind]) -> list[tuple[Extension, _Kind]]:
    """Load all extensions of one kind; unusable ones are logged once and left out."""
    fit: list[tuple[Extension, _Kind]] = []
    for each in find_extensions(group):
        try:
            fit.append((each, each.load(kind)))
        except ExtensionError as error:
            warn_once(str(error))
    return fit


@lru_cache(maxsize=64)
def warn_once(sentence: str) -> None:
    logger.warning("%s; it is left out", sentence)


@lru_cache(maxsize=64)
def _found(group: EntryPointGroup, path: tuple[str, ...]) -> tuple[Extension, ...]:
    """Search the metadata of all packages on `path` (`sys.path`); cached because it is too slow for every frame."""
    named: dict[str, Extension] = {}
    for entry in entry_points(group=group.name):
        dist = entry.dist
        package, version = ("", "") if dist is None else (dist.name, dist.version)
        named.setdefault(entry.name, Extension(group, entry.name, entry.value, package, version, entry))
    return tuple(named[name] for name in sorted(named))
