"""What other installed packages add to the program: their entry points, one group for each kind of thing."""

import logging
import sys
from dataclasses import dataclass
from functools import cached_property, lru_cache
from importlib.metadata import entry_points
from pathlib import Path
from traceback import walk_tb
from typing import Any, NamedTuple, TypeVar

logger = logging.getLogger("gsrain")

_Kind = TypeVar("_Kind")


class EntryPointGroup(NamedTuple):
    """Entry points of one kind."""

    name: str
    """As in a package's metadata: gsrain.panels."""
    noun: str
    """What one of them is called in sentences."""
    value: str
    """What an entry point has to name."""


AGENTS = EntryPointGroup("gsrain.agents", "agent", "a callable that takes `AgentOptions` and returns an `Agent`")

CAPTURE_FORMATS = EntryPointGroup("gsrain.capture_formats", "capture format", "a `CaptureFormat`")

DECODERS = EntryPointGroup("gsrain.decoders", "decoder", "a `Decoder` for what a detector gives")

DISDROMETERS = EntryPointGroup("gsrain.disdrometers", "disdrometer format", "a `LogFormat`")

EVALUATIONS = EntryPointGroup(
    "gsrain.evaluations", "evaluation", "a function whose parameters are the options of a command"
)

PANELS = EntryPointGroup("gsrain.panels", "panel", "a `Panel`")

SCENE_FORMATS = EntryPointGroup(
    "gsrain.scene_formats", "scene format", "a `Format`; the entry's name is the suffix, no dot"
)

TRANSFERS = EntryPointGroup("gsrain.transfers", "transfer", "a `TransferMethod` of the entry's name")

GROUPS = (AGENTS, CAPTURE_FORMATS, DECODERS, DISDROMETERS, EVALUATIONS, PANELS, SCENE_FORMATS, TRANSFERS)
"""All that can be added without a change of the program; docs/extending.md has an example of each."""


class ExtensionError(ValueError):
    """An extension that can't be used, in one sentence: which, of which package, and why."""


@dataclass(frozen=True, eq=False)
class Extension:
    """One entry point of another package. Its name is known at once; its code runs when it is loaded."""

    group: EntryPointGroup
    name: str
    place: str
    """Module and object: my_package.panels:CLOUDBURST."""
    package: str
    """Name of the package for pip; empty where nobody knows."""
    version: str
    _entry: Any
    """An EntryPoint of importlib.metadata, or of its backport where some library has put that in its place."""

    @property
    def title(self) -> str:
        """What sentences call it: panel cloudburst (my_package:PANEL of my-package)."""
        return f"{self.group.noun} {self.name} ({self.place} of {self.package or 'an installed package'})"

    def load(self, kind: type[_Kind]) -> _Kind:
        """Return what it names. Raises `ExtensionError` where that can't be imported or is of another kind."""
        return self.expect(self._loaded(), kind, "is")

    def load_callable(self) -> Any:
        """Return what it names. Raises `ExtensionError` where that can't be imported or called."""
        found = self._loaded()
        if not callable(found):
            raise self.unfit(f"is a {type(found).__name__}, which can't be called")
        return found

    def expect(self, found: object, kind: type[_Kind], how: str) -> _Kind:
        """Return what was found, if it is of a kind; `how` it came about (is, reads, gives) is said where it is not.

        Raises `ExtensionError`.
        """
        if not isinstance(found, kind):
            raise self.unfit(f"{how} a {type(found).__name__}, not a {kind.__name__}")
        return found

    def unfit(self, reason: object) -> ExtensionError:
        """Error that says why it can't be used; an exception of its code is a reason by its place and its words."""
        if isinstance(reason, Exception):
            reason = self._where(reason) + (" ".join(str(reason).split()) or type(reason).__name__)
        return ExtensionError(f"{self.title}: {reason}")

    def _where(self, error: Exception) -> str:
        """Say the last line of its own code that led to an error; nothing where none did."""
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
        """What loading it has come to: it runs once, however often a window asks."""
        try:
            return self._entry.load(), None
        except Exception as error:  # it is code of others: its words are the reason
            return None, error


def find_extensions(group: EntryPointGroup) -> tuple[Extension, ...]:
    """What installed packages add of one kind, by name; of several with one name the first that is found."""
    return _found(group, tuple(sys.path))


def find_extension(group: EntryPointGroup, name: str) -> Extension | None:
    """Return the one of that name; None where there is none."""
    return next((each for each in find_extensions(group) if each.name == name), None)


def load_extensions(group: EntryPointGroup, kind: type[_Kind]) -> list[tuple[Extension, _Kind]]:
    """Load all of one kind; what can't be used is left out, and said once in the log."""
    fit: list[tuple[Extension, _Kind]] = []
    for each in find_extensions(group):
        try:
            fit.append((each, each.load(kind)))
        except ExtensionError as error:
            warn_once(str(error))
    return fit


@lru_cache(maxsize=64)
def warn_once(sentence: str) -> None:
    """Warn in the log about an extension that is left out, the first time."""
    logger.warning("%s; it is left out", sentence)


@lru_cache(maxsize=64)
def _found(group: EntryPointGroup, path: tuple[str, ...]) -> tuple[Extension, ...]:
    """Search the metadata of all packages on `path`, Python's own; that takes too long for every frame of a window."""
    named: dict[str, Extension] = {}
    for entry in entry_points(group=group.name):
        dist = entry.dist
        package, version = ("", "") if dist is None else (dist.name, dist.version)
        named.setdefault(entry.name, Extension(group, entry.name, entry.value, package, version, entry))
    return tuple(named[name] for name in sorted(named))
