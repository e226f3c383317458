"""One deadline and one byte budget: real files, pipes and devices; and no line of the program goes around them."""

import ast
import multiprocessing
import os
import re
import socket
import stat
import threading
import time
from collections.abc import Iterator
from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace

import pytest

import gsrain_engine.safe_io.limits as limits
from gsrain_engine.safe_io.limits import (
    ByteBudget,
    Deadline,
    InputError,
    ServerConnection,
    TooLargeError,
    check_expansion,
    check_file,
    max_expanded_bytes,
    open_file,
    open_pipe,
    read_file,
    read_input,
    read_pipe,
    reading_deadline,
    receive_message,
    write_pipe,
)

ROOT = Path(__file__).parents[2]


@pytest.fixture
def fifo(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    return tmp_path / "pipe"


@pytest.fixture
def drip():
    """Starts threads that give one byte every 20 ms, until the test is over; nobody sleeps."""
    over, threads = threading.Event(), []

    def start(give):
        def work():
            while not over.wait(0.02):
                try:
                    give()
                except OSError:
                    return

        threads.append(threading.Thread(target=work, daemon=True))
        threads[-1].start()

    yield start
    over.set()
    for thread in threads:
        thread.join(5)


def no_later_than(seconds):
    return pytest.raises(TimeoutError, match=rf"not over within {seconds:g} s")


def test_deadlines_run_on_the_monotonic_clock_and_budgets_allow_their_last_byte(monkeypatch):
    now = [100.0]
    monkeypatch.setattr(time, "monotonic", lambda: now[0])
    monkeypatch.setattr(time, "time", lambda: 0.0)
    deadline = Deadline(5)
    now[0] = 104.5
    assert deadline.left_s == deadline.check() == 0.5
    now[0] = 105.0
    assert deadline.left_s == 0
    with no_later_than(5):
        deadline.check()
    budget = ByteBudget(10, "answer")
    budget.spend(4)
    budget.spend(6)
    with pytest.raises(TooLargeError, match=r"^answer: larger than 10 bytes"):
        budget.spend(1)


def test_files_are_read_whole_up_to_their_budget(tmp_path, monkeypatch):
    file = tmp_path / "a"
    for size in (0, 1, 1000):
        file.write_bytes(b"x" * size)
        assert read_file(file, 1000) == read_input(file, 1000) == b"x" * size
    file.write_bytes(b"x" * 1001)
    for read in (read_file, open_file, read_input):
        with pytest.raises(TooLargeError, match="a: larger than 1000 bytes"):
            read(file, 1000)
    with pytest.raises(FileNotFoundError):
        read_input(tmp_path / "b", 1000)
    if (status := Path("/proc/self/status")).exists():  # a file without a size
        assert status.stat().st_size == 0 and len(read_file(status, 1 << 20)) > 500
        with pytest.raises(TooLargeError, match="larger than 100 bytes"):
            read_file(status, 100)
    monkeypatch.setattr(limits.psutil, "virtual_memory", lambda: SimpleNamespace(available=10**9))
    os.truncate(file, 2 * 10**9)  # a hole
    with pytest.raises(TooLargeError, match=r"a: has 2\.0 GB, and 1\.0 GB of memory are free"):
        read_file(file)


def test_only_files_are_opened(tmp_path, fifo, monkeypatch):
    server = socket.socket(socket.AF_UNIX)
    os.chdir(tmp_path)  # names of sockets are short
    server.bind("socket")
    (tmp_path / "link").symlink_to("/dev/zero")
    monkeypatch.setattr(os, "open", lambda *_: pytest.fail("opened"))  # opening alone can have effects
    for name, kind in {"pipe": "pipe", "socket": "socket", "link": "device", ".": "folder"}.items():
        for read in (open_file, check_file, read_file, *([read_input] if kind != "pipe" else [])):
            with pytest.raises(InputError, match=rf": not a file but a {kind}$"):
                read(tmp_path / name, *([10] if read is read_input else []))
    server.close()
    for read in (open_file, lambda name: read_input(name, 10)):
        with pytest.raises(InputError, match="not a name that a file can have"):
            read("a\0b")


def test_a_pipe_that_takes_the_place_of_a_file_at_the_last_moment_is_not_waited_for(tmp_path, monkeypatch):
    file = tmp_path / "a"
    file.write_bytes(b"x")
    real = os.open

    def swapped(path, *arguments):
        file.unlink()
        os.mkfifo(file)
        return real(path, *arguments)

    monkeypatch.setattr(os, "open", swapped)
    before = len(list(Path("/dev/fd").iterdir()))
    with pytest.raises(InputError, match="not a file but a pipe"):
        read_file(file)
    assert len(list(Path("/dev/fd").iterdir())) == before


@pytest.mark.skipif(not Path("/dev/fd").exists(), reason="shells hand pipes on by these names")
def test_what_a_pipe_holds_is_input(fifo):
    def write():
        with fifo.open("wb") as pipe:
            pipe.write(b"left")
            pipe.flush()
            pipe.write(b" and right" * 10_000)

    thread = threading.Thread(target=write, daemon=True)
    thread.start()
    assert read_input(fifo, 1 << 20) == b"left" + b" and right" * 10_000
    thread.join()
    reader, writer = os.pipe()  # process substitution
    os.write(writer, b"{}")
    os.close(writer)
    assert read_input(f"/dev/fd/{reader}", 10) == b"{}" and read_input(f"/dev/fd/{reader}", 10) == b""
    os.close(reader)


@pytest.mark.parametrize("drips", [False, True])
def test_a_pipe_that_is_silent_or_drips_is_not_waited_for(fifo, drip, monkeypatch, drips):
    monkeypatch.setattr(limits, "PIPE_WAIT_S", 0.2)
    both = os.open(fifo, os.O_RDWR)
    if drips:
        drip(lambda: os.write(both, b"x"))
    with pytest.raises(InputError, match=r"pipe: a pipe that has not ended within 0\.2 s"):
        read_input(fifo, 1 << 20)
    os.close(both)


def test_a_pipe_without_end_takes_no_more_memory_than_its_budget(fifo):
    def write():
        with pytest.raises(BrokenPipeError), fifo.open("wb", buffering=0) as pipe:
            while True:
                pipe.write(bytes(1 << 16))

    thread = threading.Thread(target=write, daemon=True)
    thread.start()
    with pytest.raises(TooLargeError, match="larger than 2 MB"):
        read_input(fifo, 2_000_000)
    thread.join(5)


def test_a_reader_that_takes_a_byte_at_a_time_does_not_stop_the_clock(drip):
    reader, writer = os.pipe()
    os.set_blocking(writer, False)
    drip(lambda: os.read(reader, 4096))
    with no_later_than(0.3):
        write_pipe(writer, bytes(1 << 24), Deadline(0.3), list)
    os.close(writer)


@pytest.mark.parametrize("left", [b"farewell", b""])
def test_what_was_written_before_the_end_is_read_and_nothing_is_waited_for(left):
    reader, writer = os.pipe()

    def ended():
        if left:
            os.write(writer, left)
            os.close(writer)
        raise ValueError("it ended")

    with nullcontext() if left else pytest.raises(ValueError, match="it ended"):
        assert read_pipe(reader, ByteBudget(100, "pipe"), Deadline(20), ended) == left
    os.close(reader)
    if not left:
        os.close(writer)


def connection(port, seconds, budget=1000, host="127.0.0.1", is_secure=False):
    return ServerConnection(host, port, Deadline(seconds), ByteBudget(budget, "server"), is_secure=is_secure)


@pytest.mark.parametrize("to_server", [False, True])
def test_a_wire_to_a_server_that_drips_has_one_deadline_for_all(drip, to_server):
    """Each part comes or goes in time; all of them together don't."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        wire = connection(server.getsockname()[1], 0.3)
        with server.accept()[0] as theirs:
            drip((lambda: theirs.recv(1 << 18)) if to_server else (lambda: theirs.send(b"x")))
            with pytest.raises(TimeoutError):
                if to_server:
                    wire.send(bytes(1 << 26))
                for _ in range(200):
                    wire.receive()
        wire.close()


def test_a_wire_counts_what_comes_and_sends_all_of_it():
    with socket.create_server(("127.0.0.1", 0)) as server:
        wire = connection(server.getsockname()[1], 20, 10)
        with server.accept()[0] as theirs, theirs.makefile("rb") as stream:
            got = []
            thread = threading.Thread(target=lambda: got.append(stream.read(3_000_000)), daemon=True)
            thread.start()
            wire.send(bytes(range(250)) * 12_000)
            thread.join(20)
            assert got == [bytes(range(250)) * 12_000]
            theirs.sendall(b"0123456789")
            received = b""
            while len(received) < 10:
                received += wire.receive()
            assert received == b"0123456789"
            theirs.sendall(b"!")
            with pytest.raises(TooLargeError, match="server: larger than 10 bytes"):
                wire.receive()
        wire.close()


def test_the_first_address_that_answers_is_spoken_to(monkeypatch):
    with socket.create_server(("127.0.0.1", 0)) as server, socket.create_server(("127.0.0.1", 0)) as other:
        port, closed = server.getsockname()[1], other.getsockname()[1]
        other.close()
        found = [(socket.AF_INET, socket.SOCK_STREAM, 6, "", ("127.0.0.1", each)) for each in (closed, port)]
        monkeypatch.setattr(socket, "getaddrinfo", lambda *_, **__: found)
        wire = connection(80, 20, host="somewhere")
        server.accept()[0].close()
        wire.close()
        monkeypatch.setattr(socket, "getaddrinfo", lambda *_, **__: found[:1])
        with pytest.raises(ConnectionRefusedError):
            connection(80, 20, host="somewhere")
        monkeypatch.setattr(socket, "getaddrinfo", lambda *_, **__: [])
        with pytest.raises(OSError, match="it has no address"):
            connection(80, 20, host="somewhere")


def test_only_pipes_are_opened_as_pipes(tmp_path, fifo):
    (tmp_path / "a").write_bytes(b"x")
    with pytest.raises(InputError, match="a: not a pipe"):
        open_pipe(tmp_path / "a", os.O_RDONLY)
    handle = open_pipe(fifo, os.O_RDONLY)
    assert stat.S_ISFIFO(os.fstat(handle).st_mode)
    os.close(handle)


def test_messages_of_workers_have_a_budget():
    ours, theirs = multiprocessing.Pipe()
    theirs.send({"a": 1})
    assert receive_message(ours, 1000) == {"a": 1}
    theirs.send("x" * 1000)
    with pytest.raises(OSError, match="bad message length"):
        receive_message(ours, 1000)
    theirs.close()


def test_servers_that_are_silent_or_can_not_be_are_not_waited_for(monkeypatch):
    with socket.create_server(("127.0.0.1", 0)) as server, pytest.raises(TimeoutError):
        connection(server.getsockname()[1], 0.2, is_secure=True)  # it does not shake hands
    with pytest.raises(OSError, match="not a name that a server can have"):
        connection(80, 5, host="a" * 70)
    over = threading.Event()
    monkeypatch.setattr(socket, "getaddrinfo", lambda *_, **__: over.wait(20) and [])
    with pytest.raises(TimeoutError, match=r"no address of it within 0\.1 s"):
        connection(80, 0.1, host="somewhere")
    over.set()


ALLOWED = {
    "gsrain_engine/safe_io/limits.py": "the place itself",
    "gsrain_engine/safe_io/files.py": "locks, opened without waiting and never read; writes to the disk",
    "gsrain_engine/scene/formats/scene_folder.py": "hashes a file that it has just written",
    "gsrain_engine/plugins.py": "sources of installed packages",
    "gsrain_engine/scene/formats/lod_file.py": "next to a scene's file, of the size that its header says; in parts",
    "gsrain_engine/compile_cache.py": "looks into its own folder, which nobody else may write to",
    "gsrain_engine/presets.py": "files of the package",
    "gsrain_engine/editor/news.py": "a file of the package",
    "gsrain_engine/rain/phase.py": "a file of the package",
    "gsrain_extras/street/scenes.py": "hashes its own sources",
    "gsrain_extras/street/sharpness.py": "files of the package",
    "gsrain_engine/render/opengl/shaders.py": "files of the package",
    "gsrain_engine/publish/page.py": "a file of the package",
    "gsrain_extras/alpasim/messages.py": "a file of the package",
    "gsrain_engine/publish/page_scene.py": "a file that it has just written, and its bytes in memory",
    "gsrain_engine/scene/formats/stored_zip.py": "an archive that it writes, of files of its own",
    "gsrain_extras/usd/usdz.py": "results of a process of its own",
    "gsrain_engine/editor/jobs/record.py": "a frame that a job of its own has drawn",
    "app/bench_timing.py": "reads a folder that it has written, to time that",
    "gsrain_engine/render/renderer.py": "a list of processors that Linux makes",
    "gsrain_engine/appearance/cyclegan_turbo/weights.py": "puts a file that it has just written in order",
    "gsrain_engine/sweep/executors.py": "the worker's end: jobs of the program that has started it",
    "ui/window.py": "files of the package",
    "app/main.py": "the null device",
    "app/viewer_window.py": "the null device",
}
"""Files that open others by themselves, and why they may."""


LIBRARIES = (
    "open", "io.open", "os.open", "Image.open", "gzip.open", "np.load", "np.fromfile", "np.memmap", "torch.load",
    "zipfile.ZipFile", "zipfile.is_zipfile", "cv2.imread", "cv2.VideoCapture",
)  # fmt: skip
HINTS = re.compile(r"\b(open|load|fromfile|memmap|ZipFile|is_zipfile|read_bytes|read_text|recv|imread|VideoCapture)\(")
"""Files without any of these words need no closer look."""
STREAMS = ("stream", "io.BytesIO(", "BytesIO(")
"""Names of what `open_file` gives, and bytes in memory."""
OTHERS = ("archive",)
"""Of theirs, `open` opens something else: a member of an archive that is open."""


def opened_unbounded(source: str) -> Iterator[int]:
    """Lines that read from a path, or wait for a process."""
    for node in ast.walk(ast.parse(source)):
        if not isinstance(node, ast.Call):
            continue
        dotted = ast.unparse(node.func)
        of, _, name = dotted.rpartition(".")
        first = node.args[0] if node.args else None
        mode = first.value if isinstance(first, ast.Constant) else None
        if dotted in LIBRARIES:
            is_wrong = first is None or not ast.unparse(first).startswith(STREAMS)
        elif name == "open" and of and of not in OTHERS:
            is_wrong = (first is None or isinstance(mode, str)) and set(mode or "r") <= set("rbt+")
        else:
            is_wrong = bool(of) and name in ("read_bytes", "read_text", "recv")
        if is_wrong:
            yield node.lineno


def unbounded_expansions(source: str) -> Iterator[int]:
    """Lines that decompress without a maximum of bytes, or read an archive of weights without a look at its sizes."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Call):
            dotted, _, name = ast.unparse(node.func).rpartition(".")
            is_module = dotted in ("zlib", "gzip", "bz2", "lzma", "zstandard", "lz4.frame")
            if (name == "decompress" and (is_module or len(node.args) < 2)) or name in ("extractall", "unpack_archive"):
                yield node.lineno
        if isinstance(node, ast.With) and (body := ast.unparse(node)).count("torch.load(") > body.count(
            "check_zip_expansion("
        ):
            yield node.lineno


def test_nothing_is_expanded_without_a_limit():
    found = {}
    for folder in ("app", "ui", "gsrain_engine", "gsrain_extras"):
        for path in sorted((ROOT / folder).rglob("*.py")):
            source = path.read_text(encoding="utf-8")
            if re.search(r"decompress|torch\.load|extractall|unpack_archive", source):
                lines = list(unbounded_expansions(source))
                found |= {path.relative_to(ROOT).as_posix(): lines} if lines else {}
    assert found == {}


@pytest.mark.parametrize(("stored", "is_uniform", "most"), [
    (0, False, 64 << 20), (400_000, False, 80_000_000), (400_000, True, 800_000_000), (10_000, True, 64 << 20),
])  # fmt: skip
def test_one_rule_says_what_a_file_may_hold(stored, is_uniform, most):
    assert max_expanded_bytes(stored, is_uniform=is_uniform) == max(most, 64 << 20)
    check_expansion("a", most, stored, is_uniform=is_uniform)
    with pytest.raises(TooLargeError, match=rf"^a: claims to hold \d+ MB, .* {stored} bytes"):
        check_expansion("a", most + 1, stored, is_uniform=is_uniform)


def test_the_time_to_read_a_file_grows_with_it():
    assert reading_deadline(0).seconds == 60 and reading_deadline(10**9).seconds == 1060


def test_nothing_else_opens_files():
    found = {}
    for folder in ("app", "ui", "gsrain_engine", "gsrain_extras"):
        for path in sorted((ROOT / folder).rglob("*.py")):
            source = path.read_text(encoding="utf-8")
            if HINTS.search(source) and (lines := list(opened_unbounded(source))):
                found[path.relative_to(ROOT).as_posix()] = lines
    assert {name: lines for name, lines in found.items() if name not in ALLOWED} == {}
    there = [name for name in ALLOWED if (ROOT / name).is_file() or not name.startswith("gsrain_extras/")]
    assert [name for name in there if name not in found] == []
