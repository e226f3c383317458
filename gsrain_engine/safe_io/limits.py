"""Limits on untrusted input (bytes, expansion, time) for files, pipes, devices and sockets."""

import errno
import hashlib
import hmac
import ipaddress
import os
import pickle
import queue
import re
import select
import socket
import stat
import threading
import time
import zipfile
from collections.abc import Callable, Generator
from contextlib import contextmanager
from io import BufferedReader, BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

import lazy_loader

if TYPE_CHECKING:
    from multiprocessing.connection import Connection

try:
    import resource
except ImportError:  # Windows
    resource = None

psutil: Any = lazy_loader.load("psutil")  # every command imports this module
ssl: Any = lazy_loader.load("ssl")

# Deadlines and byte budgets
# A file is opened without blocking and its kind is then checked on the descriptor: no other file can be swapped in
# between. A deadline covers a whole exchange, not each part of it: a slow drip of bytes would reset that.

MAX_FILE_BYTES = 1 << 36
"""Limit of any file that is read as a whole."""

PIPE_WAIT_S = 30.0
"""Limit for reading a pipe given in place of a file, such as a shell's `<(command)`."""

_BLOCK_BYTES = 1 << 20
_LOOK_S = 0.2  # interval of checks that the other end of a pipe still exists
_SMALL_BYTES = 1 << 26  # smaller files are read without a check of free memory

_PATH_KINDS = (
    (stat.S_ISDIR, "folder"),
    (stat.S_ISFIFO, "pipe"),
    (stat.S_ISSOCK, "socket"),
    (stat.S_ISCHR, "device"),
    (stat.S_ISBLK, "device"),
)


class InputError(OSError):
    """Refused input: `filename` is its name, `strerror` the reason."""

    def __str__(self) -> str:
        return f"{self.filename}: {self.strerror}"


class TooLargeError(InputError):
    """Input that exceeds its byte budget."""


class Deadline:
    """End of a whole exchange on the monotonic clock, which changes of the system time do not affect."""

    def __init__(self, seconds: float) -> None:
        self.seconds = seconds
        self._end = time.monotonic() + seconds

    @property
    def left_s(self) -> float:
        """Seconds left; 0 after the deadline."""
        return max(0.0, self._end - time.monotonic())

    def check(self) -> float:
        """Return the seconds left. Raises TimeoutError if there are none."""
        left = self.left_s
        if left <= 0:
            raise TimeoutError(errno.ETIMEDOUT, f"not over within {self.seconds:g} s")
        return left


class ByteBudget:
    """Number of bytes that one source may still deliver."""

    def __init__(self, max_bytes: int, name: Path | str) -> None:
        """Allow `max_bytes`; `name` is the source in error messages."""
        self.max_bytes, self._name = max_bytes, name
        self.spent_bytes = 0

    def spend(self, count: int) -> None:
        """Count received bytes. Raises `TooLargeError` if they exceed the budget."""
        self.spent_bytes += count
        if self.spent_bytes > self.max_bytes:
            _refuse_size(self._name, self.max_bytes)


# Expansion and time: the one limit of all compressed or queried input (docs/reliability.md)

ALWAYS_ALLOWED_BYTES = 64 << 20
"""Bytes that the content of a file of any size may take: equal numbers compress without a bound."""

_MAX_EXPANSION = 200  # real scenes and recordings expand 2 to 30 times, bombs 1000 and more
_MAX_UNIFORM_EXPANSION = 2000  # deflate can't reach 1033, a JPEG of one color reaches 1024
_MIN_READING_S, _READING_S_PER_BYTE = 60.0, 1e-6


def max_expanded_bytes(stored_bytes: int, *, is_uniform: bool = False) -> int:
    """Maximum bytes of the content of a file, or a part of one, of `stored_bytes`.

    200 times as many; 2,000 times where content can have one value all over (`is_uniform`: pictures, arrays, tables);
    at least 64 MiB.
    """
    return max(ALWAYS_ALLOWED_BYTES, (_MAX_UNIFORM_EXPANSION if is_uniform else _MAX_EXPANSION) * stored_bytes)


def check_expansion(name: Path | str, content_bytes: int, stored_bytes: int, *, is_uniform: bool = False) -> None:
    """Raise `TooLargeError` if the declared size of a content is not plausible for its stored size."""
    if content_bytes > max_expanded_bytes(stored_bytes, is_uniform=is_uniform):
        problem = f"claims to hold {content_bytes / 1e6:.0f} MB, which can't be in {stored_bytes} bytes"
        raise TooLargeError(errno.EFBIG, problem, str(name))


def check_zip_expansion(stream: BufferedReader | BytesIO, name: Path | str) -> None:
    """Raise `TooLargeError` if a stream is a zip file whose members are too large together; returns to its start."""
    if zipfile.is_zipfile(stream):
        stored = stream.seek(0, os.SEEK_END)
        with zipfile.ZipFile(stream) as archive:
            check_expansion(name, sum(each.file_size for each in archive.infolist()), stored)
    stream.seek(0)


class ExpansionBudget(ByteBudget):
    """Bytes that the parts of one file may deliver together when they are expanded."""

    def __init__(self, stored_bytes: int, name: Path | str) -> None:
        super().__init__(max_expanded_bytes(stored_bytes), name)

    @property
    def left_bytes(self) -> int:
        return max(0, self.max_bytes - self.spent_bytes)


def address_space_bytes() -> int | None:
    """Limit of this process's address space (`ulimit -v`); None without one."""
    if resource is None:
        return None
    limit, _ = resource.getrlimit(resource.RLIMIT_AS)
    return None if limit == resource.RLIM_INFINITY else limit


def reading_deadline(stored_bytes: int) -> Deadline:
    """Deadline for a library to read a file: a minute, and a second for each MB."""
    return Deadline(_MIN_READING_S + _READING_S_PER_BYTE * stored_bytes)


def open_file(path: Path | str, max_bytes: int | None = None) -> BufferedReader:
    """Open a regular file for reading in bytes; never blocks on a pipe, and opens no device.

    Raises `InputError` if it is not a regular file, `TooLargeError` if it has more than `max_bytes`, OSError if it is
    missing or can't be read.
    """
    stream = os.fdopen(_opened(path, pipe=False), "rb")
    size = os.fstat(stream.fileno()).st_size
    if max_bytes is not None and size > max_bytes:
        stream.close()
        _refuse_size(path, max_bytes)
    return stream


def file_sha256(path: Path | str) -> str:
    """SHA-256 of a file's bytes, 64 hex digits; raises as `open_file` does."""
    with open_file(path) as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def check_file(path: Path | str) -> None:
    """Raise unless the path is a regular file, for libraries that open files by name.

    Raises as `open_file` does.
    """
    open_file(path).close()


def read_file(path: Path | str, max_bytes: int = MAX_FILE_BYTES) -> bytes:
    """Read a regular file of at most `max_bytes` that fits into free memory.

    Raises as `open_file` does.
    """
    with open_file(path, max_bytes) as stream:
        size = os.fstat(stream.fileno()).st_size
        if size > _SMALL_BYTES and size > (free := psutil.virtual_memory().available):
            problem = f"has {size / 1e9:.1f} GB, and {free / 1e9:.1f} GB of memory are free"
            raise TooLargeError(errno.EFBIG, problem, str(path))
        start = stream.read(size + 1) or b""
        if len(start) <= size:
            return start
        budget = ByteBudget(max_bytes, path)  # the file grows, or has no known size
        budget.spend(len(start))
        parts = [start]
        while part := stream.read(_BLOCK_BYTES):
            budget.spend(len(part))
            parts.append(part)
        return b"".join(parts)


def read_input(path: Path | str, max_bytes: int) -> bytes:
    """Read a regular file, or a pipe such as `/dev/stdin` or `<(command)` to its end, of at most `max_bytes`.

    Raises `InputError` for a pipe that has not ended within `PIPE_WAIT_S` and for devices, sockets and folders,
    `TooLargeError`, OSError.
    """
    if not stat.S_ISFIFO(_status(path).st_mode):
        return read_file(path, max_bytes)
    pipe = _opened(path, pipe=True)
    try:
        return read_pipe(pipe, ByteBudget(max_bytes, path), Deadline(PIPE_WAIT_S))
    except TimeoutError:
        raise InputError(errno.ETIMEDOUT, f"a pipe that has not ended within {PIPE_WAIT_S:g} s", str(path)) from None
    finally:
        os.close(pipe)


def read_pipe(pipe: int, budget: ByteBudget, deadline: Deadline, idle: Callable[[], object] = bool) -> bytes:
    """Read the descriptor of a pipe, opened without blocking, to its end.

    Calls `idle` while no data arrives; it may raise if the writer is gone, after all data sent before has been read.
    Raises TimeoutError, `TooLargeError`.
    """
    poll = select.poll()
    poll.register(pipe, select.POLLIN)
    data = bytearray()
    while True:
        if not poll.poll(1000 * min(_LOOK_S, deadline.check())):
            try:
                idle()
            except Exception:
                if not poll.poll(0):  # data written before its end is read first
                    raise
            continue
        try:
            part = os.read(pipe, _BLOCK_BYTES)
        except BlockingIOError:  # another process reads from it too
            continue
        if not part:
            return bytes(data)
        data += part
        budget.spend(len(part))


def write_pipe(pipe: int, data: memoryview | bytes, deadline: Deadline, idle: Callable[[], object]) -> None:
    """Write to the descriptor of a pipe, opened without blocking; returns when the last byte is written.

    Calls `idle` while the pipe accepts no data; it may raise. Raises TimeoutError, BrokenPipeError.
    """
    poll = select.poll()
    poll.register(pipe, select.POLLOUT)
    rest = memoryview(data)
    while rest:
        if not poll.poll(1000 * min(_LOOK_S, deadline.check())):
            idle()
            continue
        try:
            rest = rest[os.write(pipe, rest[:_BLOCK_BYTES]) :]
        except BlockingIOError:
            continue


def open_pipe(path: Path, flags: int) -> int:
    """Open one end of a named pipe without waiting for the other. Raises `InputError` if it is no pipe, OSError."""
    descriptor = os.open(path, flags | os.O_NONBLOCK | os.O_CLOEXEC)
    if not stat.S_ISFIFO(os.fstat(descriptor).st_mode):
        os.close(descriptor)
        raise InputError(errno.EINVAL, "not a pipe", str(path))
    return descriptor


@contextmanager
def reader_of_pipe(path: Path) -> Generator[None]:
    """Wait until another process reads a named pipe, so that opening it for writing does not block in the block.

    Raises `InputError` if there is none within `PIPE_WAIT_S`.
    """
    deadline = Deadline(PIPE_WAIT_S)
    while True:
        try:
            pipe = open_pipe(path, os.O_WRONLY)
            break
        except OSError as error:
            if error.errno != errno.ENXIO:
                raise
            if deadline.left_s == 0:
                raise InputError(
                    errno.ETIMEDOUT, f"a pipe that nobody reads within {PIPE_WAIT_S:g} s", str(path)
                ) from None
            time.sleep(min(_LOOK_S, deadline.left_s))
    try:
        yield
    finally:
        os.close(pipe)


def receive_message(connection: "Connection", max_bytes: int) -> Any:
    """Receive the next message of a child process. Raises EOFError, OSError if it is larger than `max_bytes`."""
    return pickle.loads(connection.recv_bytes(max_bytes))


class ServerConnection:
    """A connection to a server; one deadline and one byte budget cover all of it, including the name lookup."""

    def __init__(self, host: str, port: int, deadline: Deadline, budget: ByteBudget, *, is_secure: bool) -> None:
        """Connect, by TLS if `is_secure`. Raises TimeoutError, OSError if no server answers."""
        self._deadline, self._budget = deadline, budget
        plain = _connected(host, port, deadline)
        if not is_secure:
            self._socket = plain
            return
        try:
            plain.settimeout(deadline.check())
            self._socket = ssl.create_default_context().wrap_socket(plain, server_hostname=host)
        except BaseException:
            plain.close()
            raise

    def send(self, data: bytes) -> None:
        """Send all data. Raises TimeoutError, OSError."""
        rest = memoryview(data)
        while rest:
            self._socket.settimeout(self._deadline.check())
            rest = rest[self._socket.send(rest[:_BLOCK_BYTES]) :]

    def receive(self) -> bytes:
        """Return newly received data; empty at the end. Raises TimeoutError, `TooLargeError`, OSError."""
        self._socket.settimeout(self._deadline.check())
        data = self._socket.recv(_BLOCK_BYTES)
        self._budget.spend(len(data))
        return data

    def close(self) -> None:
        self._socket.close()


def _connected(host: str, port: int, deadline: Deadline) -> socket.socket:
    """Connect to the first address of a host that answers."""
    failed: OSError = OSError(errno.EHOSTUNREACH, "it has no address")
    for family, kind, protocol, address in _addresses(host, port, deadline):
        found = socket.socket(family, kind, protocol)
        try:
            found.settimeout(deadline.check())
            found.connect(address)
        except BaseException as error:
            found.close()
            if not isinstance(error, OSError) or isinstance(error, TimeoutError):
                raise
            failed = error
        else:
            return found
    raise failed


def _addresses(host: str, port: int, deadline: Deadline) -> list[tuple[int, int, int, Any]]:
    """Look up a host in a thread: the system's lookup has no deadline."""
    found: queue.SimpleQueue[list[tuple[int, int, int, Any]] | Exception] = queue.SimpleQueue()

    def look() -> None:
        try:
            found.put([(*each[:3], each[4]) for each in socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)])
        except (OSError, UnicodeError) as error:
            found.put(error)

    if _is_address(host):
        look()
    else:
        threading.Thread(target=look, daemon=True).start()
    try:
        answer = found.get(timeout=deadline.check())
    except queue.Empty:
        raise TimeoutError(errno.ETIMEDOUT, f"no address of it within {deadline.seconds:g} s") from None
    if isinstance(answer, OSError):
        raise answer
    if isinstance(answer, Exception):
        raise OSError(errno.EINVAL, "not a name that a server can have")
    return answer


def _is_address(host: str) -> bool:
    try:
        ipaddress.ip_address(host)
    except ValueError:
        return False
    return True


def _opened(path: Path | str, *, pipe: bool) -> int:
    """Open for reading without blocking; accept regular files and, with `pipe`, pipes.

    Devices are not even opened: opening can have side effects.
    """
    _check_kind(path, _status(path), pipe=pipe)
    flags = (getattr(os, name, 0) for name in ("O_NONBLOCK", "O_NOCTTY", "O_CLOEXEC", "O_BINARY"))
    descriptor = os.open(path, sum(flags, start=os.O_RDONLY))
    try:
        _check_kind(path, os.fstat(descriptor), pipe=pipe)
    except BaseException:
        os.close(descriptor)
        raise
    return descriptor


def _status(path: Path | str) -> os.stat_result:
    try:
        return Path(path).stat()
    except ValueError:
        raise InputError(errno.EINVAL, "not a name that a file can have", str(path)) from None


def _check_kind(path: Path | str, status: os.stat_result, *, pipe: bool) -> None:
    if stat.S_ISREG(status.st_mode) or (pipe and stat.S_ISFIFO(status.st_mode)):
        return
    kind = next((name for is_kind, name in _PATH_KINDS if is_kind(status.st_mode)), "thing of another kind")
    raise InputError(errno.EINVAL, f"not a file but a {kind}", str(path))


def _refuse_size(name: Path | str, max_bytes: int) -> NoReturn:
    size = f"{max_bytes / 1e6:.0f} MB" if max_bytes >= 10**6 else f"{max_bytes} bytes"
    raise TooLargeError(errno.EFBIG, f"larger than {size}, which no such file needs", str(name))


# Tokens


def checked_token(token: str) -> str:
    """Return a token of RFC 6750, which metadata of gRPC and addresses of pages can hold.

    Raises `ValueError` for other signs than letters of ASCII, digits and -._~+/=, and for none.
    """
    if re.fullmatch(r"[A-Za-z0-9._~+/-]+=*", token) is None:
        raise ValueError(
            "--token: must be of letters from A to Z, digits and the signs -._~+/=, which every client can send"
        )
    return token


def is_same_token(given: str, token: str) -> bool:
    """Compare a token with the expected one, in a time that does not depend on where they differ."""
    return hmac.compare_digest(given.encode(errors="replace"), token.encode())
