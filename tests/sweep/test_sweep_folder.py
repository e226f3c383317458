import errno
import os
import sys

import pytest
from msgspec import structs

from gsrain_engine.simulation.rollout_io import read_rollout
from gsrain_engine.sweep import results
from gsrain_engine.sweep.executors import SerialExecutor
from gsrain_engine.sweep.results import SweepFolder
from gsrain_engine.sweep.run import SweepRun, run_sweep
from gsrain_engine.sweep.worker import JobResult

from .other_works import answer
from .small_sweep import small_jobs, sweep_of


def finished(work):
    while True:
        try:
            next(work)
        except StopIteration as end:
            return end.value


def test_it_goes_on_where_it_was_stopped(tmp_path):
    jobs, folder = small_jobs(tmp_path), SweepFolder(tmp_path / "out")
    work = run_sweep(jobs, SerialExecutor(), folder)
    for _ in range(3):
        next(work)
    work.close()
    rest = folder.to_do(jobs)
    assert rest == jobs[2:]
    assert finished(run_sweep(rest, SerialExecutor(), folder)) == SweepRun(2, 0)
    assert folder.to_do(jobs) == [] and folder.others(jobs) == 0
    for job in jobs:
        rollout = read_rollout(folder.rollouts / f"{job.id}.jsonl")
        assert (rollout.seed, rollout.scene_hash, rollout.software["gsrain"]) == (job.seed, job.scene_hash, job.program)
        assert rollout.scenario["rain"]["intensity_mm_h"] == job.scenario.rain.intensity_mm_h


def test_without_the_package_that_writes_rows_nothing_is_begun(tmp_path, monkeypatch):
    folder = SweepFolder(tmp_path / "out")
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(ValueError, match="rows of sweeps take the package pyarrow"):
        folder.describe(sweep_of(["cut-in"]), [])
    assert not folder.path.exists()


def test_a_failed_job_is_a_row_and_done_again_only_when_asked(tmp_path):
    jobs = small_jobs(tmp_path, seeds=1)
    scenario = jobs[0].scenario
    users = (structs.replace(scenario.road_users[0], model="absent.ply"),)
    broken = structs.replace(jobs[0], scenario=structs.replace(scenario, road_users=users))
    folder = SweepFolder(tmp_path / "out")
    assert finished(run_sweep([broken, jobs[1]], SerialExecutor(), folder)) == SweepRun(2, 1)
    row = folder.read([broken])[broken.id]
    assert row["status"] == "failed" and row["error"].startswith("model absent.ply: no such file")
    assert folder.to_do([broken, jobs[1]]) == []
    assert folder.to_do([broken, jobs[1]], retry_failed=True) == [broken]


def test_a_damaged_row_counts_as_missing(tmp_path):
    jobs, folder = small_jobs(tmp_path), SweepFolder(tmp_path / "out")
    for job in jobs:
        folder.keep(job, answer(job))
    (folder.rows / f"{jobs[0].id}.parquet").write_bytes(b"PAR1 torn")
    (folder.rows / f"{jobs[1].id}.parquet").replace(folder.rows / f"{jobs[2].id}.parquet")
    assert folder.to_do(jobs) == jobs[:3]
    assert folder.others(jobs[3:]) == 2


def test_a_full_disk_stops_it_with_a_sentence_and_loses_nothing(tmp_path, monkeypatch):
    jobs, folder = small_jobs(tmp_path), SweepFolder(tmp_path / "out")
    written = []

    def full(path, rollout):
        if len(written) == 2:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        written.append(path)

    monkeypatch.setattr(results, "write_rollout", full)
    with pytest.raises(OSError, match="stopped after 2 rows: No space left on device; what was written is whole"):
        finished(run_sweep(jobs, SerialExecutor(), folder))
    assert folder.to_do(jobs) == jobs[2:]
    assert all(file.suffix == ".parquet" and not file.name.startswith(".") for file in folder.rows.iterdir())


def test_a_line_of_the_log_that_a_full_disk_has_torn_stands_by_itself(tmp_path):
    jobs, folder = small_jobs(tmp_path), SweepFolder(tmp_path / "out")
    folder.keep(jobs[0], answer(jobs[0]))
    folder.log.write_bytes(folder.log.read_bytes() + b'{"at": "2026')
    folder.keep(jobs[1], answer(jobs[1]))
    whole, torn, again = folder.log.read_text().splitlines()
    assert jobs[0].id in whole and jobs[1].id in again and torn == '{"at": "2026'


def test_a_scene_that_changes_meanwhile_stops_it_and_fails_no_job(tmp_path):
    jobs, folder = small_jobs(tmp_path), SweepFolder(tmp_path / "out")
    scene = tmp_path / "road" / "scene.json"
    scene.write_bytes(scene.read_bytes() + b"\n")
    with pytest.raises(OSError, match="road is not what it was when the sweep began"):
        finished(run_sweep(jobs, SerialExecutor(), folder))
    assert folder.read(jobs) == {}


def test_of_equal_jobs_the_last_row_wins_whole(tmp_path):
    job, folder = small_jobs(tmp_path)[0], SweepFolder(tmp_path / "out")
    folder.keep(job, JobResult(id=job.id, error="first"))
    folder.keep(job, answer(job))
    assert folder.read([job])[job.id]["status"] == "finished"
    assert len(list(folder.rows.iterdir())) == 1 and len(folder.log.read_text().splitlines()) == 2
