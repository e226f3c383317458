"""The two named pipes and the watch over them."""

import contextlib
import os
import stat
import threading
import time
from types import SimpleNamespace

import pytest

from gsrain_engine.simulation.agents.http import ClientError
from gsrain_engine.simulation.interop.hugsim_protocol import Pipes, Timeouts

MESSAGE = bytes(range(256)) * 12_000  # 3 MB: more than a pipe holds


def nobody_known():
    return None


def patience(seconds=20.0, ended=nobody_known):
    return Timeouts(seconds, ended)


def other_end(work):
    thread = threading.Thread(target=work, daemon=True)
    thread.start()
    return thread


def test_pipes_are_made_where_missing(tmp_path):
    (tmp_path / "drive").mkdir()
    os.mkfifo(tmp_path / "drive" / "plan_pipe")  # the client came first
    Pipes(tmp_path / "drive")
    assert all(stat.S_ISFIFO((tmp_path / "drive" / name).stat().st_mode) for name in ("obs_pipe", "plan_pipe"))
    Pipes(tmp_path / "drive")


def test_something_else_in_its_place(tmp_path):
    (tmp_path / "obs_pipe").write_text("my notes")
    with pytest.raises(ClientError, match="obs_pipe is there, and it is no pipe"):
        Pipes(tmp_path)
    assert (tmp_path / "obs_pipe").read_text() == "my notes"


def test_a_long_message_arrives_whole_and_is_answered(tmp_path):
    pipes, got = Pipes(tmp_path), []

    def client():
        with (tmp_path / "obs_pipe").open("rb") as pipe:
            got.append(pipe.read())
        with (tmp_path / "plan_pipe").open("wb") as pipe:
            pipe.write(b"left")
            pipe.flush()
            pipe.write(b" and right")

    thread = other_end(client)
    watch = patience()
    pipes.send(memoryview(MESSAGE), watch)
    assert pipes.receive(watch, 100) == b"left and right"
    thread.join()
    assert got == [MESSAGE]


def test_a_message_that_the_pipe_holds_does_not_wait_until_it_is_read(tmp_path):
    """A pipe made as wide as a mebibyte, 16 times what it is at first."""
    pipes, got, sent = Pipes(tmp_path), [], threading.Event()

    def client():
        with (tmp_path / "obs_pipe").open("rb") as pipe:
            sent.wait(20)
            got.append(pipe.read())

    thread = other_end(client)
    pipes.send(MESSAGE[: 1 << 20], patience(5))
    sent.set()
    thread.join()
    assert got == [MESSAGE[: 1 << 20]]


def test_a_link_to_nowhere_is_no_pipe(tmp_path):
    (tmp_path / "plan_pipe").symlink_to(tmp_path / "gone")
    with pytest.raises(ClientError, match="plan_pipe is there, and it is no pipe"):
        Pipes(tmp_path)


def test_a_name_that_no_file_can_have(tmp_path, monkeypatch):
    monkeypatch.setattr("gsrain_engine.simulation.interop.hugsim_protocol.PLANS", "plan" * 100)
    with pytest.raises(ClientError, match="no pipe can be made: .*name too long"):
        Pipes(tmp_path)


def test_pipes_that_somebody_removes_are_not_waited_for(tmp_path):
    pipes = Pipes(tmp_path)
    for name in ("obs_pipe", "plan_pipe"):
        (tmp_path / name).unlink()
    with pytest.raises(ClientError, match=r"the pipe can't be opened: .*obs_pipe"):
        pipes.send(b"observation", patience())
    with pytest.raises(ClientError, match=r"the pipe can't be opened: .*plan_pipe"):
        pipes.receive(patience(), 100)


@pytest.mark.parametrize(("looks", "words"), [(5, "ended with exit code 1 before it had answered"), (99, "hung up")])
def test_a_client_that_lets_go_has_25_looks_to_end_in(monkeypatch, looks, words):
    pauses = []
    monkeypatch.setattr("gsrain_engine.simulation.interop.hugsim_protocol.time", SimpleNamespace(sleep=pauses.append))
    watch = patience(600, lambda: "ended with exit code 1" if len(pauses) >= looks else None)
    assert words in str(watch.failed("answered", "it hung up"))
    assert pauses == [0.02] * min(looks, 25)


def test_pauses_until_somebody_reads_double_up_to_20_ms(tmp_path, monkeypatch):
    pauses = []
    monkeypatch.setattr("gsrain_engine.simulation.interop.hugsim_protocol.time", SimpleNamespace(sleep=pauses.append))
    with pytest.raises(ClientError, match="the client left before it had opened obs_pipe"):
        Pipes(tmp_path).send(b"", patience(600, lambda: "left" if len(pauses) == 8 else None))
    assert pauses == [0.0005, 0.001, 0.002, 0.004, 0.008, 0.016, 0.02, 0.02]


def test_nobody_comes(tmp_path):
    with pytest.raises(ClientError, match=r"has not opened obs_pipe within 0\.05 s"):
        Pipes(tmp_path).send(b"anybody?", patience(0.05))


def test_nobody_answers(tmp_path):
    with pytest.raises(ClientError, match=r"has not answered within 0\.05 s"):
        Pipes(tmp_path).receive(patience(0.05), 100)


def test_a_client_that_ended_is_not_waited_for(tmp_path):
    with pytest.raises(ClientError, match="the client ended with exit code 3 before it had opened obs_pipe"):
        Pipes(tmp_path).send(b"", patience(600, lambda: "ended with exit code 3"))


def test_an_answer_counts_though_its_client_ended(tmp_path):
    pipes = Pipes(tmp_path)
    wrote = threading.Event()

    def client():
        with (tmp_path / "plan_pipe").open("wb") as pipe:
            pipe.write(b"farewell")
        wrote.set()

    def ended():
        wrote.wait(20)  # it ends while we look whether it lives
        return "ended with exit code 0"

    other_end(client)
    assert pipes.receive(patience(600, ended), 100) == b"farewell"


def test_reader_that_leaves(tmp_path, monkeypatch):
    monkeypatch.setattr("gsrain_engine.simulation.interop.hugsim_protocol._MOMENTS", 1)
    pipes = Pipes(tmp_path)

    def client():
        with (tmp_path / "obs_pipe").open("rb", buffering=0) as pipe:
            pipe.read(10)

    other_end(client)
    with pytest.raises(ClientError, match="closed obs_pipe before it had read the observation"):
        pipes.send(memoryview(MESSAGE), patience())


def test_writer_that_says_nothing(tmp_path, monkeypatch):
    monkeypatch.setattr("gsrain_engine.simulation.interop.hugsim_protocol._MOMENTS", 1)
    pipes = Pipes(tmp_path)
    other_end(lambda: (tmp_path / "plan_pipe").open("wb").close())
    with pytest.raises(ClientError, match="opened plan_pipe and closed it without an answer"):
        pipes.receive(patience(), 100)


def test_writer_that_does_not_stop(tmp_path):
    pipes = Pipes(tmp_path)

    def client():
        try:
            with (tmp_path / "plan_pipe").open("wb", buffering=0) as pipe:
                while True:
                    pipe.write(b"and " * 1000)
        except BrokenPipeError:
            pass

    other_end(client)
    with pytest.raises(ClientError, match="answers more than 10000 bytes"):
        pipes.receive(patience(), 10_000)


@pytest.fixture
def drip():
    """Gives one byte every 20 ms to or from a pipe, until the test is over."""
    over, threads = threading.Event(), []

    def start(open_end, move):
        def work():
            with contextlib.suppress(OSError), open_end() as end:
                while not over.wait(0.02):
                    move(end)

        threads.append(other_end(work))

    yield start
    over.set()
    for thread in threads:
        thread.join(5)


def test_a_byte_now_and_then_is_no_answer(tmp_path, drip):
    pipes = Pipes(tmp_path)
    drip(lambda: (tmp_path / "plan_pipe").open("wb", buffering=0), lambda pipe: pipe.write(b"a"))
    started = time.monotonic()
    with pytest.raises(ClientError, match=r"has not answered within 0\.4 s"):
        pipes.receive(patience(0.4), 1 << 20)
    assert time.monotonic() - started < 5


def test_a_reader_that_takes_a_byte_now_and_then_has_not_read(tmp_path, drip):
    pipes = Pipes(tmp_path)
    drip(lambda: (tmp_path / "obs_pipe").open("rb", buffering=0), lambda pipe: pipe.read(4096))
    with pytest.raises(ClientError, match=r"has not read the observation within 0\.4 s"):
        pipes.send(memoryview(MESSAGE * 4), patience(0.4))


def test_what_takes_the_place_of_a_pipe_later_is_not_used(tmp_path):
    pipes = Pipes(tmp_path)
    for name in ("obs_pipe", "plan_pipe"):
        (tmp_path / name).unlink()
        (tmp_path / name).write_bytes(b"my notes")
    with pytest.raises(ClientError, match="obs_pipe: not a pipe"):
        pipes.send(b"observation", patience())
    with pytest.raises(ClientError, match="plan_pipe: not a pipe"):
        pipes.receive(patience(), 100)
    assert (tmp_path / "obs_pipe").read_bytes() == b"my notes"
