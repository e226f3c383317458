"""A window that is killed: its workers end, and what it leaves goes with the next start; that of living ones stays."""

import os
import subprocess
import sys
import tempfile
from multiprocessing.shared_memory import SharedMemory
from pathlib import Path

import psutil
import pytest

from gsrain_engine.editor.jobs.folder import JOB_FOLDER_PREFIX, remove_abandoned_job_folders, temporary_folder

pytestmark = pytest.mark.skipif(os.name != "posix", reason="needs kill -9 and locks as POSIX has them")

PROGRAM = Path(__file__).with_name("session_with_a_job.py")


@pytest.fixture(autouse=True)
def own_temporary_files(tmp_path, monkeypatch):
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr(tempfile, "tempdir", None)


def test_a_killed_window_takes_its_workers_along_and_the_next_one_removes_its_folder(tmp_path):
    with subprocess.Popen(
        [sys.executable, PROGRAM], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as window:
        pid, place, memory = window.stdout.readline().split()
        worker = psutil.Process(int(pid))
        remove_abandoned_job_folders()
        assert (Path(place) / "big").is_file()  # it lives
        window.kill()
    psutil.wait_procs([worker], timeout=20)
    assert not worker.is_running() or worker.status() == psutil.STATUS_ZOMBIE
    assert list(tmp_path.iterdir()) == [Path(place)]
    remove_abandoned_job_folders()
    assert not list(tmp_path.iterdir())
    tracker_is_done = [each for each in psutil.process_iter() if _tracks(each, memory)]
    psutil.wait_procs(tracker_is_done, timeout=20)
    with pytest.raises(FileNotFoundError):
        SharedMemory(memory)


def _tracks(process, memory):
    """Return whether a process is the resource tracker of a dead session; it frees shared memory a moment later."""
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


def test_a_folder_that_is_removed_before_it_is_locked_is_made_again(tmp_path, monkeypatch):
    made, mkdtemp = [], tempfile.mkdtemp

    def taken_at_once(prefix):
        made.append(mkdtemp(prefix=prefix))
        if len(made) == 1:
            remove_abandoned_job_folders()
        return made[-1]

    monkeypatch.setattr(tempfile, "mkdtemp", taken_at_once)
    with temporary_folder() as place:
        assert place == Path(made[1])
    assert len(made) == 2 and not list(tmp_path.iterdir())
