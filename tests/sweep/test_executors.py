"""Executors: workers and whole sweeps that are killed lose nothing, do nothing twice, and every byte is the same."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import msgspec
import pytest

from gsrain_engine.sweep import executors
from gsrain_engine.sweep.executors import DaskCluster, LocalPool, SerialExecutor
from gsrain_engine.sweep.expansion import jobs_of
from gsrain_engine.sweep.results import SweepFolder
from gsrain_engine.sweep.run import run_sweep
from gsrain_engine.sweep.settings import load_sweep

from .other_works import die_of_one
from .small_sweep import small_jobs, sweep_of, write_road, write_scenario

pytestmark = pytest.mark.street


def test_a_job_that_kills_every_worker_fails_and_the_others_are_done(tmp_path):
    jobs = small_jobs(tmp_path, intensities_mm_h=[0])
    outcomes = {each.id: each for each in LocalPool(1, retries=1).outcomes(die_of_one, jobs)}
    assert len(outcomes) == 2 and outcomes[jobs[0].id].error is None
    assert "2 workers" in outcomes[jobs[1].id].error and "killed" in outcomes[jobs[1].id].error
    with pytest.raises(ValueError, match="0"):
        LocalPool(0)


@pytest.fixture(scope="module")
def sweep(tmp_path_factory):
    folder = tmp_path_factory.mktemp("roads")
    scenarios = [write_scenario(folder / f"{name}.yaml", write_road(folder / name)) for name in ("one", "two")]
    return sweep_of(scenarios)


@pytest.fixture(scope="module")
def expected(sweep, tmp_path_factory):
    folder = SweepFolder(tmp_path_factory.mktemp("expected"))
    jobs = jobs_of(sweep)
    assert len(list(run_sweep(jobs, SerialExecutor(), folder))) == len(jobs) + 1 == 9
    return contents(folder)


def contents(folder):
    files = sorted([*folder.rows.iterdir(), *folder.rollouts.iterdir()])
    return {f"{file.parent.name}/{file.name}": file.read_bytes() for file in files}


def logged(folder, field):
    return [msgspec.json.decode(line)[field] for line in folder.log.read_bytes().splitlines()]


@pytest.fixture(params=["pool", "dask"])
def engine(request):
    if request.param == "pool":
        yield LocalPool(2)
        return
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(2, threads_per_worker=1, processes=True, dashboard_address=":0") as local:
        cluster = DaskCluster(local.scheduler_address)
        assert cluster.workers == 2
        yield cluster
        cluster.close()


def test_a_killed_worker(engine, sweep, expected, tmp_path):
    jobs, folder = jobs_of(sweep), SweepFolder(tmp_path)
    for done, _ in enumerate(run_sweep(jobs, engine, folder)):
        if done == 2:
            os.kill(int(logged(folder, "worker")[0].split()[-1]), signal.SIGKILL)
    assert contents(folder) == expected
    assert sorted(logged(folder, "id")) == sorted(job.id for job in jobs)


def test_a_killed_sweep_and_another_that_goes_on(sweep, expected, tmp_path):
    file, folder = tmp_path / "sweep.yaml", SweepFolder(tmp_path / "out")
    file.write_bytes(msgspec.yaml.encode(sweep))
    command = [sys.executable, "-c", "from sweep.test_executors import run_here; run_here()", str(file), folder.path]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(Path.cwd()), str(Path(__file__).parents[1])])}
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment) as running:
        for line in running.stdout:
            if line.startswith("3 of"):
                running.kill()
    jobs = jobs_of(sweep)
    rest = folder.to_do(jobs)
    assert 0 < len(rest) <= len(jobs) - 3
    list(run_sweep(rest, SerialExecutor(), folder))
    assert contents(folder) == expected and len(set(logged(folder, "id"))) == len(jobs)


def run_here():
    """Run a sweep file into a folder, the arguments of this process, and print each step."""
    for step in run_sweep(jobs_of(load_sweep(sys.argv[1])), LocalPool(1), SweepFolder(Path(sys.argv[2]))):
        print(step.message, flush=True)


def test_a_cluster_that_does_not_answer_is_named(monkeypatch):
    pytest.importorskip("distributed")
    monkeypatch.setattr(executors, "ANSWERS_WITHIN_S", 0.2)
    with pytest.raises(ValueError, match=r"tcp://127\.0\.0\.1:1"):
        DaskCluster("tcp://127.0.0.1:1")
