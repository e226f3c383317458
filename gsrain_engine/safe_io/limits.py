"""Says of a file that can't be read as what its name promises what it is instead, by its first bytes."""

import errno
import ipaddress
import os
import pickle
import queue
import select
import socket
import ssl
import stat
import threading
import time
from collections.abc import Callable
from io import BufferedReader
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, NamedTuple, NoReturn

import psutil

_HEAD_BYTES = 512
"""The mark of a tar archive stands at byte 257."""


class _FileKind(NamedTuple):
    words: str
    """The kind, and what can be done with such a file."""
    starts: tuple[bytes, ...] = ()
    """First bytes, any of them."""
    at: int = 0
    """Byte at which they stand."""
    suffixes: tuple[str, ...] = ()
    """Names that such a file rightly has: it is no surprise there. A kind without first bytes goes by them alone."""


_IMAGE = "a picture: give the folder that it is in"

_ARCHIVE = "an archive: unpack it, and give what was in it"

_VIDEO = "a video: write its frames into a folder (ffmpeg -i VIDEO FOLDER/%05d.jpg), and give that"

_MESH = "a mesh or a point cloud, no Gaussians"

_HEIC = "an HEIC or AVIF picture: convert it to JPEG or PNG"

_KINDS = (
    _FileKind(
        "a pointer of Git LFS, not the file itself: run git lfs pull where it was cloned", (b"version https://git-lfs",)
    ),
    _FileKind("a web page, not the file: the download went wrong", (b"<!doctype html", b"<html")),
    _FileKind("a file of arrays", suffixes=(".npz", ".npy")),
    _FileKind(_ARCHIVE, (b"pk\x03\x04", b"pk\x05\x06"), suffixes=(".sog",)),
    _FileKind(_ARCHIVE, (b"7z\xbc\xaf\x27\x1c", b"rar!\x1a")),
    _FileKind(_ARCHIVE, (b"ustar",), at=257),
    _FileKind(_ARCHIVE, (b"\x1f\x8b",), suffixes=(".spz",)),
    _FileKind(_IMAGE, (b"\xff\xd8\xff",), suffixes=(".jpg", ".jpeg")),
    _FileKind(_IMAGE, (b"\x89png\r\n",), suffixes=(".png",)),
    _FileKind(_IMAGE, (b"gif87a", b"gif89a"), suffixes=(".gif",)),
    _FileKind(_IMAGE, (b"ii*\0", b"mm\0*"), suffixes=(".tif", ".tiff")),
    _FileKind(_IMAGE, (b"webpvp8",), at=8, suffixes=(".webp",)),
    _FileKind(_HEIC, (b"ftyphei", b"ftyphev", b"ftypmif", b"ftypmsf", b"ftypavi"), at=4),
    _FileKind(_VIDEO, (b"ftyp", b"moov", b"mdat"), at=4),
    _FileKind(_VIDEO, (b"\x1a\x45\xdf\xa3",)),
    _FileKind(_VIDEO, (b"avi list",), at=8),
    _FileKind(_MESH, (b"gltf", b"kaydara fbx", b"lasf", b"# .pcd")),
    _FileKind("a PLY file: a scene, a mesh or a point cloud", (b"ply\n", b"ply\r\n"), suffixes=(".ply",)),
    _FileKind("a PDF", (b"%pdf-",)),
    _FileKind("a table of a data set (Parquet): give the data set's folder", (b"par1",)),
    _FileKind("a database, such as COLMAP's: give the folder with the model (sparse/0)", (b"sqlite format 3",)),
    _FileKind(_MESH, suffixes=(".obj", ".stl", ".fbx", ".gltf", ".glb", ".dae", ".las", ".laz", ".e57", ".pcd")),
    _FileKind(_VIDEO, suffixes=(".mp4", ".mov", ".avi", ".mkv", ".webm", ".m4v")),
)
"""The first that fits is right. Letters are compared as small ones."""


def kind_of_file(path: Path, *, named_rightly: bool = False) -> str | None:
    """Say what a file is ("an archive: unpack it, and give what was in it"), for the end of a refusal.

    None for what no kind fits, for what can't be opened, and, where the reader goes by names and is `named_rightly`,
    for what its name says that it is.
    """
    try:
        with open_file(path) as file:
            head = file.read(_HEAD_BYTES)
    except OSError:
        return None
    return kind_of_bytes(head, path.suffix.lower(), named_rightly=named_rightly)


def kind_of_bytes(head: bytes, suffix: str = "", *, named_rightly: bool = False) -> str | None:
    """Say what the first bytes of a file, whose name ends so in small letters, belong to, as `kind_of_file` does."""
    if not head:
        return "an empty file"
    head = head[:_HEAD_BYTES].lower().removeprefix(b"\xef\xbb\xbf")
    for kind in _KINDS:
        if head[kind.at :].startswith(kind.starts) if kind.starts else suffix in kind.suffixes:
            return None if kind.starts and named_rightly and suffix in kind.suffixes else kind.words
    return None


# § One deadline and one byte budget for all that comes from files, pipes, devices and sockets of strangers.
#
# A file is opened without waiting and only then asked for its kind, by its descriptor: nothing can take its place in
# between. A deadline holds for a whole exchange, not for each of its parts, which an endless drip of bytes would
# reset.

MAX_FILE_BYTES = 1 << 36
"""Of any file that is read as a whole."""

PIPE_WAIT_S = 30.0
"""For all that comes through a pipe that a person names in place of a file, such as `<(command)` of a shell."""

_BLOCK_BYTES = 1 << 20

_LOOK_S = 0.2
"""Pause between two looks at whether the other end of a pipe still lives."""

_SMALL_BYTES = 1 << 26
"""Files below this are read without asking for free memory."""

_PATH_KINDS = (
    (stat.S_ISDIR, "folder"),
    (stat.S_ISFIFO, "pipe"),
    (stat.S_ISSOCK, "socket"),
    (stat.S_ISCHR, "device"),
    (stat.S_ISBLK, "device"),
)


class InputError(OSError):
    """Input that is refused: `filename` is its name, `strerror` the reason."""

    def __str__(self) -> str:
        return f"{self.filename}: {self.strerror}"


class TooLargeError(InputError):
    """Input that goes beyond its byte budget."""


class Deadline:
    """The moment by which a whole exchange must be over, on the monotonic clock: nobody can set that."""

    def __init__(self, seconds: float) -> None:
        self.seconds = seconds
        self._end = time.monotonic() + seconds

    @property
    def left_s(self) -> float:
        """Seconds that are left; 0 once the moment has passed."""
        return max(0.0, self._end - time.monotonic())

    def check(self) -> float:
        """Return the seconds that are left. Raises TimeoutError where there are none."""
        left = self.left_s
        if left <= 0:
            raise TimeoutError(errno.ETIMEDOUT, f"not over within {self.seconds:g} s")
        return left


class ByteBudget:
    """Bytes that may still come from one source."""

    def __init__(self, max_bytes: int, name: Path | str) -> None:
        """Allow so many bytes; `name` is that of the source, for errors."""
        self.max_bytes, self._name = max_bytes, name
        self.spent_bytes = 0

    def spend(self, count: int) -> None:
        """Count bytes that have come. Raises `TooLargeError` where they are more than allowed."""
        self.spent_bytes += count
        if self.spent_bytes > self.max_bytes:
            _refuse_size(self._name, self.max_bytes)


def open_file(path: Path | str, max_bytes: int | None = None) -> BufferedReader:
    """Open a regular file for reading in bytes; never waits for a pipe, and opens no device.

    Raises `InputError` where something else than a file stands there, `TooLargeError` where it has more than
    `max_bytes`, OSError where it is missing or may not be read.
    """
    stream = os.fdopen(_opened(path, pipe=False), "rb")
    size = os.fstat(stream.fileno()).st_size
    if max_bytes is not None and size > max_bytes:
        stream.close()
        _refuse_size(path, max_bytes)
    return stream


def check_file(path: Path | str) -> None:
    """Refuse what is there and is no regular file, for libraries that open files by their names.

    Raises as `open_file` does.
    """
    open_file(path).close()


def read_file(path: Path | str, max_bytes: int = MAX_FILE_BYTES) -> bytes:
    """Read a regular file of at most so many bytes, and no more than memory is free.

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
        budget = ByteBudget(max_bytes, path)  # it grows, or is one of those that don't know their size
        budget.spend(len(start))
        parts = [start]
        while part := stream.read(_BLOCK_BYTES):
            budget.spend(len(part))
            parts.append(part)
        return b"".join(parts)


def read_input(path: Path | str, max_bytes: int) -> bytes:
    """Read a regular file, or a pipe such as `/dev/stdin` or `<(command)` to its end, of at most so many bytes.

    A pipe must be at its end within `PIPE_WAIT_S`. Raises `InputError` for that and for devices, sockets and
    folders, `TooLargeError`, OSError.
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
    """Read the descriptor of a pipe, opened without waiting, to its end.

    `idle` is called while nothing comes, and may raise where nothing will: what came before that still counts. Raises
    TimeoutError, `TooLargeError`.
    """
    poll = select.poll()
    poll.register(pipe, select.POLLIN)
    data = bytearray()
    while True:
        if not poll.poll(1000 * min(_LOOK_S, deadline.check())):
            try:
                idle()
            except Exception:
                if not poll.poll(0):  # what it wrote before it ended is read first
                    raise
            continue
        try:
            part = os.read(pipe, _BLOCK_BYTES)
        except BlockingIOError:  # somebody else reads from it, too
            continue
        if not part:
            return bytes(data)
        data += part
        budget.spend(len(part))


def write_pipe(pipe: int, data: memoryview | bytes, deadline: Deadline, idle: Callable[[], object]) -> None:
    """Write to the descriptor of a pipe, opened without waiting; returns when it has taken in the last byte.

    `idle` is called while it takes nothing, and may raise. Raises TimeoutError, BrokenPipeError.
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
    """Open one end of a named pipe without waiting for the other. Raises `InputError` where it is none, OSError."""
    descriptor = os.open(path, flags | os.O_NONBLOCK | os.O_CLOEXEC)
    if not stat.S_ISFIFO(os.fstat(descriptor).st_mode):
        os.close(descriptor)
        raise InputError(errno.EINVAL, "not a pipe", str(path))
    return descriptor


def receive_message(connection: Connection, max_bytes: int) -> Any:
    """Take in the next message of a process that this one has started. Raises EOFError, OSError where it is larger."""
    return pickle.loads(connection.recv_bytes(max_bytes))


class ServerConnection:
    """A connection to a server; all of it, from the look-up of its name on, is under one deadline and one budget."""

    def __init__(self, host: str, port: int, deadline: Deadline, budget: ByteBudget, *, is_secure: bool) -> None:
        """Connect, by TLS where it `is_secure`. Raises TimeoutError, OSError where nobody answers there."""
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
        """Send all of it. Raises TimeoutError, OSError."""
        rest = memoryview(data)
        while rest:
            self._socket.settimeout(self._deadline.check())
            rest = rest[self._socket.send(rest[:_BLOCK_BYTES]) :]

    def receive(self) -> bytes:
        """Return what has come since; nothing at the end. Raises TimeoutError, `TooLargeError`, OSError."""
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
    """Look a host up, in a thread: the system's own look-up has no deadline."""
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
    """Open for reading without waiting, and refuse what is neither a file nor, where it may be one, a pipe.

    Devices are not even opened: some do something then.
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
