"""Jobs in real processes and threads, started by a runner without an editor; `wait` polls as a window does."""

import os
import subprocess
import sys
import threading
from contextlib import closing
from multiprocessing.shared_memory import SharedMemory
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import psutil
import pytest

from editor.files.open_document import full_disk
from editor.job_work import deaf, ended, endless, failing, hungry, killed, leaving, painting, succeeding
from gsrain_engine.editor.background import Background
from gsrain_engine.editor.jobs import process
from gsrain_engine.editor.jobs.job import Job, JobError, JobRunner, MetricCurves
from gsrain_engine.editor.jobs.process import SharedImage
from gsrain_engine.scene.progress import Progress, duration_text
from gsrain_engine.threads import WORKER_NICENESS, usable_cores


@pytest.fixture
def problems():
    return []


@pytest.fixture
def runner(problems):
    with closing(Background()) as files:
        opened = JobRunner(files, problems.append)
        opened.files = files
        yield opened
        opened.close()


class Places:
    """The job's folder, and what the receiver of its results was called with."""

    def __init__(self):
        self.folder, self.results = None, []

    def inputs(self, folder):
        self.folder = folder
        os.mkfifo(folder / "go on")
        return (folder,)

    def take(self, result, is_final):
        self.results.append((result, is_final))

    def job(self, work, read=lambda _: None, **options):
        return Job("recolor", "Recolor", work, read, options.pop("inputs", self.inputs), **options)

    def snapshot(self, folder):
        """Read a new snapshot, and let the worker go on."""
        found = (folder / "snapshot").read_text()
        if (found, False) in self.results:
            return None
        (folder / "go on").write_text("")
        return found


# A job that succeeds


def test_a_job_reports_snapshots_metrics_a_warning_and_pictures_and_hands_over_its_result(runner, monkeypatch):
    monkeypatch.setenv("NUMBA_NUM_THREADS", "1")
    places = Places()
    job = places.job(painting, lambda folder: (folder / "result").read_text(), snapshot=places.snapshot)
    job.cancel()
    assert job.state == "queued"
    assert runner.start(job, places.take) is job
    assert (job.state, runner.running, runner.is_running("recolor")) == ("running", [job], True)
    niceness = min(psutil.Process().nice() + WORKER_NICENESS, 19)
    assert job.wait(60) == f"{niceness} {(os.environ.get('OMP_NUM_THREADS', str(usable_cores())), '1')}"
    assert job.wait(0) == job.result
    assert places.results == [(f"snapshot {k}", False) for k in (1, 2, 3)] + [(job.result, True)]
    assert (job.state, job.progress.fraction, job.progress.message) == ("finished", 1.0, "Done")
    assert job.progress.warning == "nothing is learned"
    assert job.curves.curve("loss").tolist() == [[10, 20, 30], [1, 1 / 2, 1 / 3]]
    height, width = job.progress.preview.shape[:2]
    assert width * height <= 1024 * 768 and abs(width / height - 4 / 3) < 0.01 and (job.progress.preview == 7).all()
    assert (runner.running, runner.newest("recolor"), runner.newest("drive")) == ([], job, None)
    runner.clear()
    assert runner.all == []


# Jobs that fail


def with_a_function(folder):
    return (lambda: folder,)


@pytest.mark.parametrize(
    ("options", "error", "traceback"),
    [
        ({"work": failing}, "the third wheel is missing", "in failing"),
        ({"work": failing, "in_thread": True}, "the third wheel is missing", "in failing"),
        ({"work": killed}, "killed", None),
        ({"work": leaving}, "exit code 3", None),
        ({"work": ended}, "ended from outside", "in ended"),
        ({"work": hungry}, "the machine ran out of memory", "in hungry"),
        ({"inputs": full_disk}, "No space left", "in full_disk"),
        ({"inputs": with_a_function}, "with_a_function", "with_a_function"),
        ({"read": full_disk}, "No space left", "in full_disk"),
        ({"snapshot": full_disk, "work": failing}, "", ""),  # either of the two errors comes first
        ({"on_result": full_disk}, "No space left", "in full_disk"),
    ],
)
def test_whatever_fails_is_a_failed_job_with_one_line_that_leaves_nothing_behind(
    runner, problems, options, error, traceback
):
    places = Places()
    take = options.pop("on_result", places.take)
    job = runner.start(places.job(**{"work": succeeding} | options), take)
    with pytest.raises(JobError):
        job.wait(60)
    assert job.state == "failed" and error in job.error and "\n" not in job.error
    assert job.details is None if traceback is None else traceback in job.details
    assert problems == [f"Recolor failed: {job.error}"]
    assert_nothing_is_left(runner, places)


def assert_nothing_is_left(runner, places):
    """Wait for the thread that cleans up, then look for processes and files."""
    runner.close()
    runner.files.submit(lambda: None).result(timeout=60)
    assert places.folder is None or not places.folder.exists()
    own = [each.cmdline() for each in psutil.Process().children()]
    assert not [each for each in own if "--multiprocessing-fork" in each]


# Jobs that are cancelled


@pytest.mark.parametrize(
    ("options", "until"),
    [
        ({"work": deaf}, "multiplying"),
        ({"work": endless}, "still at it"),
        ({"work": endless, "in_thread": True}, "still at it"),
        ({"work": endless}, "Starting"),
        ({"work": endless}, "Saving the scene for the worker"),
        ({"work": succeeding}, "Loading the result"),
    ],
    ids=lambda value: value if isinstance(value, str) else value["work"].__name__,
)
def test_cancel_ends_a_job_at_once_wherever_it_is(runner, problems, options, until):
    cancelled, places, may_load = [], Places(), threading.Event()
    options |= {"read": lambda _: may_load.wait(60), "on_cancel": lambda: cancelled.append(job)}
    job = runner.start(places.job(**options), places.take)
    while job.progress.message != until:
        runner.wait(0.01)
        runner.poll()
    job.cancel()
    job.cancel()
    assert (job.state, runner.running, cancelled) == ("cancelled", [], [job])
    may_load.set()
    assert_nothing_is_left(runner, places)
    with pytest.raises(JobError, match="cancelled"):
        job.wait(0)
    assert places.results == [] and problems == []


# Queue


def test_processes_run_one_after_another_in_an_order_that_can_be_changed(runner, caplog):
    caplog.set_level("INFO", "gsrain")
    ready, results = [True], []
    runner._is_ready = lambda: ready[0]
    first, *others = [
        Job("export", name, endless if name == "first" else succeeding, lambda _, name=name: name, lambda _: (0,),
            output=Path(name))
        for name in ("first", "second", "third", "fourth")
    ]  # fmt: skip
    light = Job("floaters", "light", succeeding, lambda _: "light", lambda _: (0,), in_thread=True)
    for job in (first, *others, light):
        runner.start(job, lambda result, _: results.append(result))
    assert (runner.running, runner.waiting) == ([first, light], others)
    assert light.wait(60) == "light"
    second, third, fourth = others
    fourth.run_next()
    second.cancel()
    assert (second.state, second.seconds, runner.waiting) == ("cancelled", 0.0, [fourth, third])
    assert runner.writes(Path("third")) is third and runner.writes(Path("second")) is None
    ready[0] = False  # a scene is being brought in
    first.cancel()
    runner.poll()
    assert (runner.running, third.is_pending) == ([], True)
    runner.clear()
    assert runner.all == [third, fourth]
    ready[0] = True
    assert third.wait(60) == "third" and fourth.state == "finished"
    assert results == ["light", "fourth", "third"] and runner.notices == [fourth, third]
    fourth.is_noticed = True
    assert runner.notices == [third]
    lines = [record.message.partition(" after ")[0] for record in caplog.records]
    assert lines == [
        "first: started", "second: waits for first", "third: waits for second", "fourth: waits for third",
        "light: started", "light: done", "second: canceled before it began", "first: canceled",
        "fourth: started", "fourth: done", "third: started", "third: done",
    ]  # fmt: skip


def test_a_short_job_runs_now_next_to_a_long_one(runner):
    long, before, short = (
        Job("export", name, endless if name == "long" else succeeding, lambda _, name=name: name, lambda _: (0,))
        for name in ("long", "before", "short")
    )
    for job in (long, before, short):
        runner.start(job, lambda *_: None)
    short.run_now()
    long.run_now()  # does nothing: it runs
    assert (runner.running, runner.waiting) == ([long, short], [before])
    assert short.wait(60) == "short"
    runner.poll()
    assert (long.state, before.state) == ("running", "queued")


def test_leaving_a_scene_ends_its_jobs_and_closing_ends_all(runner):
    ended = Job("recolor", "Recolor", succeeding, lambda _: "colors", lambda _: (0,))
    assert runner.start(ended, lambda *_: None).wait(60) == "colors"
    jobs = [Job("export", f"{k}", endless, lambda _: None, ends_with_scene=k == 0, in_thread=True) for k in (0, 1)]
    for job in jobs:
        runner.start(job, lambda *_: None)
    with pytest.raises(TimeoutError, match="0: has not ended"):
        jobs[0].wait(0.01)
    runner.leave_scene()
    assert ([each.state for each in jobs], ended.result) == (["cancelled", "running"], None)
    runner.close()
    assert [each.state for each in runner.all] == ["finished", "cancelled", "cancelled"]


def test_a_program_that_ends_while_a_worker_is_at_it_leaves_no_process_no_file_and_no_warning(tmp_path):
    program = Path(__file__).with_name("session_that_closes.py")
    done = subprocess.run(
        [sys.executable, program], env=os.environ | {"TMPDIR": str(tmp_path)}, capture_output=True, text=True,
        timeout=120, check=True,
    )  # fmt: skip
    assert done.stderr == ""  # such as that of shared memory that was leaked
    assert not psutil.pid_exists(int(done.stdout))
    assert not list(tmp_path.iterdir())


# Parts


def test_the_time_left_is_estimated_from_what_was_done_since_the_first_progress(monkeypatch):
    job = Places().job(lambda folder: iter(()))
    now = [100.0]
    monkeypatch.setattr("gsrain_engine.editor.jobs.job.monotonic", lambda: now[0])
    job.state, job.started_s, job.progress = "running", 0.0, Progress(0.1, "")
    assert job.remaining_s is None  # 100 s of preparation tell nothing
    job.first_step = 100.0, 0.1
    now[0], job.progress = 101.0, Progress(0.3, "")
    assert job.remaining_s is None  # too early
    now[0] = 110.0
    assert job.remaining_s == pytest.approx(35.0) and job.seconds == 110.0
    job.state, job.ended_s, now[0] = "finished", 112.0, 500.0
    assert job.remaining_s is None and job.seconds == 112.0
    texts = {0.44: "0.4 s", 41.6: "42 s", 60: "1:00 min", 3599.4: "59:59 min", 3600: "1:00 h", 9000: "2:30 h"}
    assert {seconds: duration_text(seconds) for seconds in texts} == texts


def test_curves_are_the_means_of_many_steps_by_metric():
    curves = MetricCurves()
    for step in range(1, 2001):
        curves.add(Progress(0.0, "", metrics={"step": step, "loss": 2 * step}))
    curves.add(Progress(0.25, "", metrics={"speed": 3.0}))
    steps, losses = curves.curve("loss")
    assert len(steps) == 400 and steps[0] == 3.0 and np.array_equal(losses, 2 * steps)
    assert (curves.curve("speed").tolist(), curves.curve("unknown").shape) == ([[0.25], [3.0]], (2, 0))


@pytest.mark.parametrize("lacks", ["the place", "room"])
def test_jobs_run_without_pictures_where_there_is_no_shared_memory(runner, monkeypatch, lacks):
    if lacks == "room":
        monkeypatch.setattr(process.os, "statvfs", lambda _: SimpleNamespace(f_bavail=1, f_frsize=4096))
    else:
        monkeypatch.setattr(process, "SharedMemory", full_disk)
    ours = SharedImage()
    theirs = SharedImage(ours.name)
    theirs.write(np.zeros((4, 5, 3), np.uint8))
    assert ours.take() is None
    for image in (theirs, ours):
        image.close()
    places = Places()
    job = runner.start(places.job(succeeding, lambda _: "result"), places.take)
    job.wait(60)
    assert job.state == "finished" and places.results == [("result", True)]


def test_a_reader_of_shared_images_never_gets_half_an_image():
    ours = SharedImage()
    theirs = SharedImage(ours.name)
    assert ours.take() is None
    sizes = {value: (8 + 7 * value % 300, 5 + 11 * value % 400) for value in range(1, 256)}

    def write():
        for value, size in sizes.items():
            theirs.write(np.full((*size, 3), value, np.uint8))

    writer = threading.Thread(target=write)
    writer.start()
    taken = []
    while writer.is_alive() or not taken or taken[-1] < 255:
        if (image := ours.take()) is not None:
            taken.append(int(image[0, 0, 0]))
            assert image.shape[:2] == sizes[taken[-1]] and (image == taken[-1]).all()
    writer.join()
    assert taken == sorted(set(taken)) and ours.take() is None
    theirs.close()
    ours.close()
    ours.close()
    with pytest.raises(FileNotFoundError):
        SharedMemory(ours.name)
