"""Workers and whole sweeps that are killed: nothing is lost, nothing is there twice, and every byte is the same."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import msgspec
import pytest

from gsrain_engine.sweep.executors import LocalPool, SerialExecutor
from gsrain_engine.sweep.expansion import jobs_of
from gsrain_engine.sweep.results import SweepFolder
from gsrain_engine.sweep.run import run_sweep

from .small_sweep import sweep_of, write_road, write_scenario

_HERE = Path(__file__).parent


@pytest.fixture(scope="module")
def sweep(tmp_path_factory):
    folder = tmp_path_factory.mktemp("roads")
    scenarios = [write_scenario(folder / f"{name}.yaml", write_road(folder / name)) for name in ("one", "two")]
    return sweep_of(scenarios, seeds=3)


@pytest.fixture(scope="module")
def expected(sweep, tmp_path_factory):
    folder = SweepFolder(tmp_path_factory.mktemp("expected"))
    jobs = jobs_of(sweep)
    assert len(list(run_sweep(jobs, SerialExecutor(), folder))) == len(jobs) + 1 == 13
    return contents(folder)


def contents(folder):
    files = sorted([*folder.rows.iterdir(), *folder.rollouts.iterdir()])
    return {f"{file.parent.name}/{file.name}": file.read_bytes() for file in files}


def logged(folder):
    return [msgspec.json.decode(line)["id"] for line in folder.log.read_bytes().splitlines()]


def test_a_killed_worker(sweep, expected, tmp_path):
    jobs, folder = jobs_of(sweep), SweepFolder(tmp_path)
    work = run_sweep(jobs, LocalPool(2), folder)
    for done, _ in enumerate(work):
        if done == 3:
            worker = msgspec.json.decode(folder.log.read_bytes().splitlines()[0])["worker"]
            os.kill(int(worker.split()[-1]), signal.SIGKILL)
    assert contents(folder) == expected
    assert sorted(logged(folder)) == sorted(job.id for job in jobs)


def test_a_killed_sweep_and_another_that_goes_on(sweep, expected, tmp_path):
    file, folder = tmp_path / "sweep.yaml", SweepFolder(tmp_path / "out")
    file.write_bytes(msgspec.yaml.encode(sweep))
    environment = os.environ | {"PYTHONPATH": str(Path.cwd())}
    command = [sys.executable, str(_HERE / "run_here.py"), str(file), str(folder.path), "1"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment) as running:
        for line in running.stdout:
            if line.startswith("5 of"):
                running.kill()
    jobs = jobs_of(sweep)
    rest = folder.to_do(jobs)
    assert 0 < len(rest) <= len(jobs) - 5
    list(run_sweep(rest, SerialExecutor(), folder))
    assert contents(folder) == expected
    assert len(set(logged(folder))) == len(jobs)


def test_a_killed_worker_of_a_dask_cluster(sweep, expected, tmp_path):
    distributed = pytest.importorskip("distributed")
    from gsrain_engine.sweep.executors import DaskCluster

    jobs, folder = jobs_of(sweep), SweepFolder(tmp_path)
    with distributed.LocalCluster(2, threads_per_worker=1, processes=True, dashboard_address=":0") as local:
        cluster = DaskCluster(local.scheduler_address)
        assert cluster.workers == 2
        for done, _ in enumerate(run_sweep(jobs, cluster, folder)):
            if done == 3:
                worker = msgspec.json.decode(folder.log.read_bytes().splitlines()[0])["worker"]
                os.kill(int(worker.split()[-1]), signal.SIGKILL)
        cluster.close()
    assert contents(folder) == expected
    assert sorted(logged(folder)) == sorted(job.id for job in jobs)


def test_a_cluster_that_does_not_answer_is_said_in_a_sentence(monkeypatch):
    pytest.importorskip("distributed")
    from gsrain_engine.sweep import executors as dask_cluster

    monkeypatch.setattr(dask_cluster, "_ANSWERS_WITHIN_S", 0.2)
    with pytest.raises(ValueError, match="no Dask scheduler answers at tcp://127.0.0.1:1"):
        dask_cluster.DaskCluster("tcp://127.0.0.1:1")
