"""A session that is killed: its worker ends, and its folder is removed at the next start; those of others stay.

Run as a program, it is a session with a job that never ends; it prints the worker's process, its folder and its shared
memory.
"""

import os
import subprocess
import sys
import tempfile
import threading
from multiprocessing.shared_memory import SharedMemory
from pathlib import Path

import psutil
import pytest

from gsrain_engine.editor.jobs.folder import JOB_FOLDER_PREFIX, remove_abandoned_job_folders, temporary_folder
from gsrain_engine.editor.jobs.process import WorkerProcess
from gsrain_engine.scene.progress import Progress

pytestmark = pytest.mark.skipif(os.name != "posix", reason="needs kill -9 and locks as POSIX has them")


@pytest.fixture(autouse=True)
def own_temporary_files(tmp_path, monkeypatch):
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr(tempfile, "tempdir", None)


def silent(place):
    """Work without progress after its first message."""
    (place / "big").write_bytes(bytes(100_000))
    yield Progress(0.5, "at it")
    threading.Event().wait(3600)


def run_session():
    with temporary_folder() as place:
        job = WorkerProcess(silent, place)
        while job.progress.message != "at it":
            job.wait(60)
            job.poll()
        print(job.pid, place, job.preview.name, flush=True)
        sys.stdin.read()


def test_worker_and_folder_of_a_killed_session_are_removed(tmp_path):
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
    with subprocess.Popen([sys.executable, __file__], text=True, **pipes) as session:
        pid, place, memory = session.stdout.readline().split()
        worker = psutil.Process(int(pid))
        remove_abandoned_job_folders()
        assert (Path(place) / "big").is_file()  # in use
        session.kill()
    psutil.wait_procs([worker], timeout=20)
    assert not worker.is_running() or worker.status() == psutil.STATUS_ZOMBIE
    assert list(tmp_path.iterdir()) == [Path(place)]
    remove_abandoned_job_folders()
    assert not list(tmp_path.iterdir())
    psutil.wait_procs([each for each in psutil.process_iter() if is_orphaned_tracker(each)], timeout=20)
    with pytest.raises(FileNotFoundError):
        SharedMemory(memory)


def is_orphaned_tracker(process):
    """True for the resource tracker of a dead session, which frees shared memory a moment later."""
    try:
        return process.ppid() == 1 and "resource_tracker" in " ".join(process.cmdline())
    except psutil.Error:
        return False


def test_only_folders_of_dead_jobs_are_removed(tmp_path):
    (tmp_path / "gsrain-tests-1").mkdir()
    (tmp_path / "far").mkdir()
    (tmp_path / f"{JOB_FOLDER_PREFIX}link").symlink_to(tmp_path / "far")
    (tmp_path / f"{JOB_FOLDER_PREFIX}dead").mkdir()
    others = {"gsrain-tests-1", "far", f"{JOB_FOLDER_PREFIX}link"}
    with temporary_folder() as place:
        remove_abandoned_job_folders()
        assert {each.name for each in tmp_path.iterdir()} == {*others, place.name}
    assert {each.name for each in tmp_path.iterdir()} == others


def test_folders_removed_before_they_are_locked_are_created_again(tmp_path, monkeypatch):
    made, mkdtemp = [], tempfile.mkdtemp

    def removed_immediately(prefix):
        made.append(mkdtemp(prefix=prefix))
        if len(made) == 1:
            remove_abandoned_job_folders()
        return made[-1]

    monkeypatch.setattr(tempfile, "mkdtemp", removed_immediately)
    with temporary_folder() as place:
        assert place == Path(made[1])
    assert len(made) == 2 and not list(tmp_path.iterdir())


if __name__ == "__main__":
    run_session()
