from collections import Counter
from contextlib import closing
from functools import partial

import pytest
from msgspec import structs

from gsrain_engine.sweep import executors
from gsrain_engine.sweep.executors import LocalPool, PoolWorker, next_job

from .other_works import answer, die_once, die_over_one
from .small_sweep import small_jobs


def test_jobs_of_workers_that_died_are_done_again(tmp_path):
    jobs = small_jobs(tmp_path, intensities_mm_h=[0])
    outcomes = list(LocalPool(1).outcomes(partial(die_once, folder=str(tmp_path)), jobs))
    assert Counter(each.id for each in outcomes) == Counter(job.id for job in jobs)
    assert not any(each.error for each in outcomes)
    assert all((tmp_path / job.id).exists() == (job.seed == 1) for job in jobs)


def test_a_job_that_kills_every_worker_fails_and_the_others_are_done(tmp_path):
    jobs = small_jobs(tmp_path, intensities_mm_h=[0])
    outcomes = {each.id: each for each in LocalPool(1, retries=1).outcomes(die_over_one, jobs)}
    assert len(outcomes) == 2
    assert outcomes[jobs[0].id].error is None
    assert outcomes[jobs[1].id].error == (
        "each of 2 workers that had this job was killed; was there too little memory?"
    )


def test_closing_ends_its_workers(tmp_path, monkeypatch):
    workers = []

    def hired(*told):
        workers.append(PoolWorker(*told))
        return workers[-1]

    monkeypatch.setattr(executors, "PoolWorker", hired)
    with closing(LocalPool(1).outcomes(answer, small_jobs(tmp_path))) as outcomes:
        next(outcomes)
        assert [worker.process.exitcode for worker in workers] == [None]
    assert workers[0].process.exitcode is not None


def test_a_worker_stays_with_its_scene_and_starts_with_one_that_nobody_has(tmp_path):
    job = small_jobs(tmp_path, seeds=1, intensities_mm_h=[0])[0]
    waiting = [structs.replace(job, scene=scene) for scene in ("a", "a", "b", "b", "c")]
    taken = [next_job(waiting, *asked).scene for asked in ((None, set()), (None, {"a"}), ("b", {"a"}), ("b", {"a"}))]
    assert taken == ["a", "b", "b", "c"]
    assert next_job(waiting, "c", {"a"}).scene == "a" and waiting == []


def test_a_pool_has_a_worker():
    assert LocalPool().workers >= 1
    with pytest.raises(ValueError, match="at least one worker, got 0"):
        LocalPool(0)
