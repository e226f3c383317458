"""Contract of file readers, and one trial of it: damaged files give a valid value or one sentence."""

import resource
import signal
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from random import Random
from types import FrameType
from typing import Any, NamedTuple

from .mutations import Damage

LONGEST_S = 5.0
"""Of processor time: no small file keeps a reader busy for longer."""
_LONGEST_WAIT_S = 120.0
"""Of the wall's clock, on however busy a machine: what takes longer waits for something that never comes."""
MOST_MEMORY_BYTES = 256 << 20
"""No small file makes a reader ask for more, beside what it takes before."""
_LONGEST_SENTENCE = 2000


@dataclass(frozen=True)
class Reader:
    """A row of the table: how to write a small sound example, what of it is damaged, and how it is read."""

    name: str
    write: Callable[[Path], Path]
    """Writes a sound example into an empty folder; returns what is to be opened."""
    read: Callable[[Path], Any]
    """Opens it, and looks at all that comes out of it; raises AssertionError for what can't be right."""
    error: type[Exception]
    """The one error that the command line turns into a sentence."""
    damage: tuple[tuple[str, Damage], ...]
    """Files to damage (a pattern of names below the folder), and the kind of damage; the first match counts."""
    tries: int = 40
    """Number of damaged files in a test run; fewer where each takes long."""
    longest_s: float = LONGEST_S


def one_file(name: str, write: Callable[[Path], object]) -> Callable[[Path], Path]:
    """Writer of an example that is one file of this name."""

    def written(folder: Path) -> Path:
        write(folder / name)
        return folder / name

    return written


def one_text(name: str, text: str) -> Callable[[Path], Path]:
    """Writer of an example that is one file of text."""
    return one_file(name, lambda path: path.write_text(text))


class Finding(NamedTuple):
    """A file that a reader did not come to terms with."""

    reader: str
    file: str
    """Damaged file of the example, below its folder."""
    content: bytes
    what: str


class Example:
    """A sound example on the disk: one of its files is damaged for a moment at a time."""

    def __init__(self, reader: Reader, folder: Path) -> None:
        self.reader = reader
        self.folder = folder
        self.opened = reader.write(folder)
        self._files: list[tuple[Path, bytes, Damage]] = []
        for file in sorted(path for path in folder.rglob("*") if path.is_file()):
            fitting = [damage for pattern, damage in reader.damage if file.match(pattern)]
            if fitting:
                self._files.append((file, file.read_bytes(), fitting[0]))
        assert self._files, f"{reader.name}: nothing of its example is damaged"
        reader.read(self.opened)  # what is sound is read; and whatever is imported late is imported now

    def damaged(self, seed: int) -> tuple[str, bytes]:
        """One of the files' names, and what becomes of it."""
        chance = Random(f"{self.reader.name} {seed}")
        file, content, damage = self._files[chance.randrange(len(self._files))]
        return file.relative_to(self.folder).as_posix(), damage(content, chance)

    def tried(self, seed: int) -> Finding | None:
        """Read the example with one file damaged, as the seed decides; None where all is well."""
        return self.tried_with(*self.damaged(seed))

    def tried_with(self, name: str, content: bytes) -> Finding | None:
        """Read the example with another content of one of its files; None where all is well."""
        file = self.folder / name
        original = file.read_bytes()
        file.write_bytes(content)
        try:
            what = self._what_is_wrong(file)
        finally:
            file.write_bytes(original)
        return None if what is None else Finding(self.reader.name, name, content, what)

    def _what_is_wrong(self, file: Path) -> str | None:
        try:
            with limited_time(self.reader.longest_s), warnings.catch_warnings():
                warnings.simplefilter("error")
                warnings.filterwarnings("ignore", module=r"PIL\.")  # of many pixels, and of odd headers
                self.reader.read(self.opened)
        except TooSlow:
            return f"took longer than {self.reader.longest_s:g} s"
        except Exception as error:
            return self._what_is_wrong_with(error, file)
        return None

    def _what_is_wrong_with(self, error: Exception, file: Path) -> str | None:
        named = f"{type(error).__name__}: {str(error)[:300]}"
        if not isinstance(error, self.reader.error):
            return f"let out {named}"
        if error.__cause__ is not None:
            return f"let out {type(error.__cause__).__name__}, caught at the last moment: {str(error)[:300]}"
        sentence = " ".join(str(error).split())
        if not any(named in sentence for named in (str(self.folder), self.opened.name, file.name)):
            return f"does not name the file: {named}"
        if len(sentence) > _LONGEST_SENTENCE:
            return f"says {len(sentence)} characters: {sentence[:200]}"
        strange = [sign for sign in sentence.encode(errors="replace").decode() if not sign.isprintable()]
        return f"says signs that steer a terminal: {strange[:3]!r} in {sentence[:200]!r}" if strange else None


class TooSlow(BaseException):
    """Time is up; no reader catches it by accident."""


@contextmanager
def limited_time(seconds: float) -> Iterator[None]:
    """Interrupt by `TooSlow` what takes more of the processor's time, or waits for minutes. For the main thread."""

    def stop(_signal: int, _frame: FrameType | None) -> None:
        raise TooSlow

    clocks = ((signal.ITIMER_PROF, signal.SIGPROF, seconds), (signal.ITIMER_REAL, signal.SIGALRM, _LONGEST_WAIT_S))
    before = [signal.signal(number, stop) for _, number, _ in clocks]
    for clock, _, limit_s in clocks:
        signal.setitimer(clock, limit_s)
    try:
        yield
    finally:
        for (clock, number, _), handler in zip(clocks, before, strict=True):
            signal.setitimer(clock, 0)
            signal.signal(number, handler)


@contextmanager
def limited_memory(more_bytes: int = MOST_MEMORY_BYTES) -> Iterator[None]:
    """Let this process ask for so much address space more, and for no byte beyond (MemoryError)."""
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (pages * resource.getpagesize() + more_bytes, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, (soft, hard))
