"""Consent for Python code that files name: it runs only after a person has allowed its exact bytes.

Sweeps name agents; the settings of a training or a comparison name a normal estimator's program. Loading such a file
raises `UntrustedCodeError` with the code. The caller asks the person, then calls `trust` (for this process) or
`trust_permanently`, by content hash. The hashed bytes themselves are compiled, so that a file that changes meanwhile
runs in neither form. Code that a person names directly, on the command line or in a program, needs no consent.
"""

import ast
import hashlib
import importlib.abc
import importlib.machinery
import importlib.util
import logging
import os
import stat
import sys
from collections.abc import Generator, Iterable, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from types import CodeType, ModuleType
from typing import TYPE_CHECKING, Any, NamedTuple

import lazy_loader
import platformdirs

from .safe_io.files import lock_path, whole_file
from .safe_io.limits import open_file, read_file

if TYPE_CHECKING:
    import msgspec
else:
    msgspec = lazy_loader.load("msgspec")  # every command imports this module

logger = logging.getLogger("gsrain")
_MAX_FILES, _MAX_BYTES = 2000, 1 << 25  # limits of one program; nobody reviews a larger one


class CodeFile(NamedTuple):
    """One Python file and the bytes that were read from it."""

    path: Path
    is_package: bool
    source: bytes


@dataclass(frozen=True, eq=False)
class Code:
    """A Python program that a file names: the file itself and all neighboring files that it imports."""

    path: Path
    """Absolute path of the file or folder."""
    files: Mapping[str, CodeFile]
    """Files by import name; the named file itself is `MAIN`."""

    @cached_property
    def digest(self) -> str:
        """SHA-256 (64 hex digits) of the file if it imports no neighbors, otherwise over all files."""
        hashes = {name: hashlib.sha256(file.source).hexdigest() for name, file in self.files.items()}
        if list(hashes) == [MAIN]:
            return hashes[MAIN]
        lines = (f"{name}\0{self.files[name].is_package:d}\0{hashes[name]}\n" for name in sorted(hashes))
        return hashlib.sha256("".join(lines).encode()).hexdigest()

    @property
    def others(self) -> list[str]:
        return sorted(file.path.name for name, file in self.files.items() if name != MAIN)


MAIN = ""


class UntrustedCodeError(ValueError):
    """Code or a command named by a file and not yet allowed; the message lists the code and how to allow it."""

    def __init__(self, named_by: str | Path, codes: Sequence[Code]) -> None:
        listed = ", ".join(f"{each.path} (SHA-256 {each.digest[:12]})" for each in codes)
        super().__init__(
            f"{named_by}: names Python code or commands, which would run with all your rights: {listed}; look at it, "
            "then give --trust, or run this in a terminal to be asked"
        )
        self.named_by, self.codes = str(named_by), tuple(codes)


def read_code(path: Path, packages: Sequence[str] = ()) -> Code:
    """Read a Python file with the neighboring files that it imports, or all `packages` of a folder.

    Raises ValueError if it is no Python file or too large, OSError if it can't be read.
    """
    path = path.absolute()
    if path.is_dir():
        files = {name: file for each in packages for name, file in _package(path, each)}
    else:
        files = {MAIN: CodeFile(path, False, _read(path))}
        waiting = [MAIN]
        while waiting:
            for name in sorted(_imported(files[waiting.pop()].source)):
                if name not in files and name != path.stem:
                    found = dict(_package(path.parent, name, prefers_file=True))
                    waiting += [each for each in found if each not in files]
                    files |= found
                    _check_size(path, files)
    _check_size(path, files)
    return Code(path, files)


def command_code(command: str) -> Code:
    """Return a shell command that a file names, to be allowed like Python code."""
    path = Path(command)
    return Code(path, {MAIN: CodeFile(path, False, command.encode())})


def _imported(source: bytes) -> set[str]:
    """First parts of all names that a file imports, anywhere in it; empty if it is not valid Python."""
    try:
        tree = ast.parse(source)
    except (SyntaxError, ValueError, RecursionError, MemoryError):  # running it raises the error with its line
        return set()
    names: set[str] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names |= {each.name.partition(".")[0] for each in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            names.add(node.module.partition(".")[0])
    return names


def _package(folder: Path, name: str, *, prefers_file: bool = False) -> Iterable[tuple[str, CodeFile]]:
    """All Python files of a package (`__init__.py` is optional), or the single file of that name."""
    root, single = folder / name, folder / f"{name}.py"
    if not root.is_dir() or (prefers_file and single.is_file()):
        if single.is_file():
            yield name, CodeFile(single, False, _read(single))
        return
    for count, file in enumerate(sorted(root.rglob("*.py"))):
        if count >= _MAX_FILES:
            raise ValueError(f"{root}: has more than {_MAX_FILES:,} Python files")
        parts = file.relative_to(folder).with_suffix("").parts
        is_package = parts[-1] == "__init__"
        yield ".".join(parts[:-1] if is_package else parts), CodeFile(file, is_package, _read(file))


def _read(file: Path) -> bytes:
    if not file.is_file():
        raise ValueError(f"{file}: no such Python file")
    return read_file(file, _MAX_BYTES)


def _check_size(path: Path, files: Mapping[str, CodeFile]) -> None:
    if len(files) > _MAX_FILES or sum(len(each.source) for each in files.values()) > _MAX_BYTES:
        raise ValueError(f"{path}: more Python than {_MAX_FILES:,} files or {_MAX_BYTES >> 20} MiB")


# Consent

TRUSTED: set[str] = set()  # digests allowed in this process, beyond the remembered ones
_named_by_files: set[str] = set()
"""Absolute paths of code named by files in this process: their content must be trusted when it runs."""


def trust(digests: Iterable[str]) -> None:
    TRUSTED.update(digests)


def expect_trusted(digests: Mapping[str, str]) -> None:
    """Adopt another process's decision: code at these paths runs here if it has these digests."""
    _named_by_files.update(digests)
    trust(digests.values())


def check_unchanged(code: Code) -> None:
    """Raise `UntrustedCodeError` for code named by a file if its content is not allowed."""
    if str(code.path) in _named_by_files and not is_trusted(code):
        raise UntrustedCodeError(code.path, [code])


def is_trusted(code: Code) -> bool:
    """Return whether a person has allowed exactly this code, now or earlier."""
    return code.digest in TRUSTED or code.digest in _remembered()


def check_trusted(named_by: str | Path, codes: Iterable[Code]) -> None:
    codes = list(codes)
    _named_by_files.update(str(each.path) for each in codes)
    untrusted = [each for each in codes if not is_trusted(each)]
    if untrusted:
        raise UntrustedCodeError(named_by, untrusted)


def check_named(named_by: str | Path, path: Path, packages: Sequence[str] = ()) -> None:
    """Raise `UntrustedCodeError` if a file names code that is not allowed.

    `check_unchanged` checks the content again before it runs.
    """
    _named_by_files.add(str(path.absolute()))
    if path.exists():
        check_trusted(named_by, [read_code(path, packages)])


def trust_permanently(codes: Iterable[Code]) -> None:
    """Allow code permanently, and in this process; logs a warning if the answer can't be written."""
    codes = list(codes)
    trust(each.digest for each in codes)
    path = answers_file()
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with lock_path(path.parent):
            known = _remembered() | {each.digest: str(each.path) for each in codes}
            with suppress(FileNotFoundError):
                path.chmod(0o600)  # the new file inherits the permissions of the old one
            with whole_file(path) as temporary:
                temporary.touch(mode=0o600)
                temporary.write_bytes(msgspec.json.format(msgspec.json.encode({"trusted": known}), indent=1))
    except OSError as error:
        logger.warning("%s: the answer is not remembered: %s", path, error.strerror or error)


def answers_file() -> Path:
    return Path(platformdirs.user_config_dir("gsrain", appauthor=False)) / "trusted_code.json"


def _remembered() -> dict[str, str]:
    """Paths of allowed code, by digest; empty if the file is missing, damaged, or writable by other users."""
    path = answers_file()
    try:
        with open_file(path, _MAX_BYTES) as file:
            status = os.fstat(file.fileno())
            by_others = status.st_mode & (stat.S_IWGRP | stat.S_IWOTH)
            if hasattr(os, "getuid") and (by_others or status.st_uid != os.getuid()):
                logger.warning("%s: others could have written it, so no answer in it counts", path)
                return {}
            return msgspec.json.decode(file.read(), type=dict[str, dict[str, str]])["trusted"]
    except (OSError, KeyError, msgspec.DecodeError, UnicodeDecodeError):
        return {}


# Execution


def run_main(code: Code, name: str) -> ModuleType:
    """Run the named file as a module called `name`; its imports of neighbors use the bytes that were read.

    Raises whatever the code raises, `SyntaxError` among it.
    """
    main = code.files[MAIN]
    module = ModuleType(name)
    module.__file__ = str(main.path)
    sys.modules[name] = module  # dataclasses look there
    compiled = _compiled(main)
    # Neighbors stay importable: an agent may import one as late as its first plan.
    for neighbor in code.files:  # another file's neighbor of the same name
        loaded = sys.modules.get(neighbor)
        if loaded is not None and isinstance(loaded.__loader__, _CodeLoader):
            del sys.modules[neighbor]
    sys.meta_path[:] = [
        each for each in sys.meta_path if not (isinstance(each, _CodeFinder) and each.path == code.path)
    ]
    if set(code.files) != {MAIN}:
        sys.meta_path.insert(0, _CodeFinder(code))
    exec(compiled, module.__dict__)
    return module


@contextmanager
def importable(code: Code) -> Generator[None]:
    """Make the packages of a folder importable while the block runs, and remove them from `sys.modules` afterwards."""
    tops = {name.partition(".")[0] for name in code.files}
    before = {name: sys.modules.pop(name) for name in list(sys.modules) if name.partition(".")[0] in tops}
    finder = _CodeFinder(code)
    sys.meta_path.insert(0, finder)
    try:
        yield
    finally:
        sys.meta_path.remove(finder)
        for name in [name for name in sys.modules if name.partition(".")[0] in tops]:
            del sys.modules[name]
        sys.modules.update(before)


class _CodeFinder(importlib.abc.MetaPathFinder):
    """Finder for the modules of one program, in memory."""

    def __init__(self, code: Code) -> None:
        self.path = code.path
        self._files = code.files
        parts = [name.split(".") for name in code.files]
        self._folders = {".".join(each[:count]) for each in parts for count in range(1, len(each))} - set(code.files)

    def find_spec(
        self, fullname: str, path: Any = None, target: ModuleType | None = None
    ) -> importlib.machinery.ModuleSpec | None:
        file = self._files.get(fullname)
        if file is not None:
            origin = str(file.path)
            loader = _CodeLoader(file)
            return importlib.util.spec_from_loader(fullname, loader, origin=origin, is_package=file.is_package)
        if fullname in self._folders:  # a folder without __init__.py
            return importlib.util.spec_from_loader(fullname, _CodeLoader(None), is_package=True)
        return None


class _CodeLoader(importlib.abc.Loader):
    """Loader that runs a file from the bytes that were read; it ignores bytecode files."""

    def __init__(self, file: CodeFile | None) -> None:
        self._file = file

    def exec_module(self, module: ModuleType) -> None:
        if self._file is not None:
            module.__file__ = str(self._file.path)
            exec(_compiled(self._file), module.__dict__)


def _compiled(file: CodeFile) -> CodeType:
    return compile(file.source, str(file.path), "exec", dont_inherit=True)
