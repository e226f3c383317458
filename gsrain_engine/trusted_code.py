"""Python that a file from elsewhere names: it runs only when a person has said yes to its very bytes.

A sweep names agents, the settings of a training or a comparison the program of an estimator of normals. Whoever loads
such a file gets `UntrustedCodeError` with what it names; who asks the person then calls `trust` (for this process) or
`remember` (for good), by content. What runs is compiled from the bytes that were hashed, so that a file that changes
meanwhile runs in neither form. Code that a person names himself, on the command line or in a program, needs no answer.
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
from typing import Any

import msgspec
import platformdirs

from .safe_io.limits import open_file, read_file
from .scene.files import lock_path, whole_file

logger = logging.getLogger("gsrain")

_MAX_FILES, _MAX_BYTES = 2000, 1 << 25
"""Of one program. More is no program that somebody looks at before he says yes."""


class CodeFile(msgspec.Struct, frozen=True):
    """One Python file as it was read."""

    path: Path
    is_package: bool
    source: bytes


@dataclass(frozen=True, eq=False)
class Code:
    """A Python program that a file names, as it was read: the file itself and all files near it that it imports."""

    path: Path
    """File or folder by its absolute path."""
    files: Mapping[str, CodeFile]
    """By the names by which they are imported; the file that was named itself is `MAIN`."""

    @cached_property
    def digest(self) -> str:
        """SHA-256 (64 hex digits): of the file, where it imports none of its neighbors; else over all of them."""
        hashes = {name: hashlib.sha256(file.source).hexdigest() for name, file in self.files.items()}
        if list(hashes) == [MAIN]:
            return hashes[MAIN]
        lines = (f"{name}\0{self.files[name].is_package:d}\0{hashes[name]}\n" for name in sorted(hashes))
        return hashlib.sha256("".join(lines).encode()).hexdigest()

    @property
    def others(self) -> list[str]:
        """Names of the files that it brings along, beside the one that was named."""
        return sorted(file.path.name for name, file in self.files.items() if name != MAIN)


MAIN = ""


class UntrustedCodeError(ValueError):
    """Python code that a file names, which no person has allowed to run; says what it is and how to allow it."""

    def __init__(self, named_by: str | Path, codes: Sequence[Code]) -> None:
        listed = ", ".join(f"{each.path} (SHA-256 {each.digest[:12]})" for each in codes)
        super().__init__(
            f"{named_by}: names Python code, which would run with all your rights: {listed}; look at it, then give "
            "--trust, or run this in a terminal to be asked"
        )
        self.named_by, self.codes = str(named_by), tuple(codes)


def read_code(path: Path, packages: Sequence[str] = ()) -> Code:
    """Read a Python file with those files near it that it imports, or all `packages` of a folder.

    Raises ValueError for what is no Python file, or is too large; OSError where it can't be read.
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
                    found = dict(_near(path.parent, name))
                    waiting += [each for each in found if each not in files]
                    files |= found
                    _check_size(path, files)
    _check_size(path, files)
    return Code(path, files)


def _imported(source: bytes) -> set[str]:
    """First parts of all names that a file imports, anywhere in it; nothing where it can't be read as Python."""
    try:
        tree = ast.parse(source)
    except (SyntaxError, ValueError, RecursionError, MemoryError):  # running it says so, by its line
        return set()
    names: set[str] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names |= {each.name.partition(".")[0] for each in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            names.add(node.module.partition(".")[0])
    return names


def _near(folder: Path, name: str) -> Iterable[tuple[str, CodeFile]]:
    file = folder / f"{name}.py"
    if file.is_file():
        return [(name, CodeFile(file, False, _read(file)))]
    return _package(folder, name)


def _package(folder: Path, name: str) -> Iterable[tuple[str, CodeFile]]:
    """All Python files of a package, which may have no `__init__.py`, or the file of that name."""
    root = folder / name
    if not root.is_dir():
        if root.with_suffix(".py").is_file():
            yield name, CodeFile(root.with_suffix(".py"), False, _read(root.with_suffix(".py")))
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


# Answers

_trusted: set[str] = set()
"""Digests of what may run in this process, besides those that are remembered."""

_named_by_files: set[str] = set()
"""Absolute paths of code that files have named in this process: what stands there must be trusted when it runs."""


def trust(digests: Iterable[str]) -> None:
    """Let code of these digests run in this process."""
    _trusted.update(digests)


def expect_trusted(digests: Mapping[str, str]) -> None:
    """Take over another process's decision: code at these paths runs here if it has these digests."""
    _named_by_files.update(digests)
    trust(digests.values())


def check_unchanged(code: Code) -> None:
    """Raise `UntrustedCodeError` for code that a file has named, if it is not what a person has allowed."""
    if str(code.path) in _named_by_files and not is_trusted(code):
        raise UntrustedCodeError(code.path, [code])


def is_trusted(code: Code) -> bool:
    """Whether a person has allowed this very code, now or earlier."""
    return code.digest in _trusted or code.digest in _remembered()


def check_trusted(named_by: str | Path, codes: Iterable[Code]) -> None:
    """Raise `UntrustedCodeError` for code that nobody has allowed."""
    codes = list(codes)
    _named_by_files.update(str(each.path) for each in codes)
    untrusted = [each for each in codes if not is_trusted(each)]
    if untrusted:
        raise UntrustedCodeError(named_by, untrusted)


def check_named(named_by: str | Path, path: Path, packages: Sequence[str] = ()) -> None:
    """Raise `UntrustedCodeError` where a file names code that nobody has allowed; later content is checked, too.

    `check_unchanged` does that when it is to run.
    """
    _named_by_files.add(str(path.absolute()))
    if path.exists():
        check_trusted(named_by, [read_code(path, packages)])


def trust_permanently(codes: Iterable[Code]) -> None:
    """Allow code for good, and in this process; a log line says so where the answer can't be written down."""
    codes = list(codes)
    trust(each.digest for each in codes)
    path = answers_file()
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with lock_path(path.parent):
            known = _remembered() | {each.digest: str(each.path) for each in codes}
            with suppress(FileNotFoundError):
                path.chmod(0o600)  # the new file keeps the permissions of the old one
            with whole_file(path) as beside:
                beside.touch(mode=0o600)
                beside.write_bytes(msgspec.json.format(msgspec.json.encode(_Answers(trusted=known)), indent=1))
    except OSError as error:
        logger.warning("%s: the answer is not remembered: %s", path, error.strerror or error)


def answers_file() -> Path:
    return Path(platformdirs.user_config_dir("gsrain", appauthor=False)) / "trusted_code.json"


class _Answers(msgspec.Struct, frozen=True):
    trusted: dict[str, str]
    """Digest to the path under which it was first allowed."""


def _remembered() -> dict[str, str]:
    """Answers of earlier runs; none where the file is missing, damaged, or could have been written by others."""
    path = answers_file()
    try:
        with open_file(path, _MAX_BYTES) as file:
            status = os.fstat(file.fileno())
            by_others = status.st_mode & (stat.S_IWGRP | stat.S_IWOTH)
            if hasattr(os, "getuid") and (by_others or status.st_uid != os.getuid()):
                logger.warning("%s: others could have written it, so no answer in it counts", path)
                return {}
            return msgspec.json.decode(file.read(), type=_Answers).trusted
    except (OSError, msgspec.DecodeError, UnicodeDecodeError):
        return {}


# Running


def run_main(code: Code, name: str) -> ModuleType:
    """Run the file that was named as a module of a name; what it imports of its neighbors is what was read.

    Raises whatever the code raises, `SyntaxError` among it.
    """
    main = code.files[MAIN]
    module = ModuleType(name)
    module.__file__ = str(main.path)
    sys.modules[name] = module  # dataclasses look there
    compiled = _compiled(main)
    _serve(code)
    exec(compiled, module.__dict__)
    return module


@contextmanager
def importable(code: Code) -> Generator[None]:
    """Let the packages of a folder be imported by their names while the block runs; no trace of them stays behind."""
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


def _serve(code: Code) -> None:
    """Serve the neighbors of a file from now on: a driver may import one when it is asked for a plan."""
    for name in code.files:  # what another file's neighbor of that name was is not this one's
        module = sys.modules.get(name)
        if module is not None and isinstance(module.__loader__, _CodeLoader):
            del sys.modules[name]
    sys.meta_path[:] = [
        each for each in sys.meta_path if not (isinstance(each, _CodeFinder) and each.path == code.path)
    ]
    if set(code.files) != {MAIN}:
        sys.meta_path.insert(0, _CodeFinder(code))


class _CodeFinder(importlib.abc.MetaPathFinder):
    """Finds the modules of one program, in memory."""

    def __init__(self, code: Code) -> None:
        self.path = code.path
        self._files = code.files
        self._folders = {name.rpartition(".")[0] for name in code.files} - set(code.files) - {MAIN}
        while more := {name.rpartition(".")[0] for name in self._folders} - self._folders - set(code.files) - {MAIN}:
            self._folders |= more

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
    """Runs a file from the bytes that were read; bytecode that lies near it is never used."""

    def __init__(self, file: CodeFile | None) -> None:
        self._file = file

    def exec_module(self, module: ModuleType) -> None:
        if self._file is not None:
            module.__file__ = str(self._file.path)
            exec(_compiled(self._file), module.__dict__)


def _compiled(file: CodeFile) -> CodeType:
    return compile(file.source, str(file.path), "exec", dont_inherit=True)
