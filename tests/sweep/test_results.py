"""Rows, summaries, figures, tables and the folder of a sweep, which damage, full disks and changes do not spoil."""

import errno
import json
import math
import os

import msgspec
import numpy as np
import pytest
from msgspec import msgpack, structs
from PIL import Image

from boxy_scene import boxy_scene
from gsrain_engine.scene.formats.scene_files import write_scene
from gsrain_engine.simulation.rollout_io import read_rollout
from gsrain_engine.sweep import results, worker
from gsrain_engine.sweep.executors import SerialExecutor
from gsrain_engine.sweep.expansion import jobs_of
from gsrain_engine.sweep.report import scenario_figure, write_tables
from gsrain_engine.sweep.run import SweepRun, run_sweep, run_sweep_and_report
from gsrain_engine.sweep.settings import RenderSweep
from gsrain_engine.sweep.worker import JobResult, run_job, worker_cache

from .other_works import answer
from .small_sweep import small_jobs, sweep_of, write_road, write_scenario

pytestmark = pytest.mark.street


@pytest.fixture
def folder(tmp_path):
    return results.SweepFolder(tmp_path / "out")


@pytest.fixture
def jobs(tmp_path):
    return small_jobs(tmp_path)


def finished(work):
    while True:
        try:
            next(work)
        except StopIteration as end:
            return end.value


def run(jobs, folder):
    return finished(run_sweep(jobs, SerialExecutor(), folder))


# Summary


def drive_row(seed, intensity, *, collision=False, ttc=2.0, failed=False, agent="one"):
    row = dict.fromkeys(results.columns_of("drive"))
    row |= {"scene": "street", "scenario": "lead", "agent": agent, "seed": seed, "intensity_mm_h": intensity}
    if failed:
        return row | {"status": "failed", "error": "it broke"}
    return row | {"status": "finished", "collision": collision, "min_ttc_s": ttc, "planned_point_collision_rate": 0.1}


def test_collisions_have_wilsons_interval_and_failed_runs_do_not_count():
    rows = [drive_row(seed, 8.5, collision=seed < 3) for seed in range(10)]
    cell, failed = results.summarized([*rows, drive_row(10, 8.5, failed=True), drive_row(0, 12.0, failed=True)])
    assert (cell.runs, cell.failed, cell.collisions, cell.means["min_ttc_s"].value) == (10, 1, 3, 2.0)
    z, n, p = 1.959963984540054, 10, 0.3
    middle, half = p + z * z / (2 * n), z * math.sqrt(p * (1 - p) / n + z * z / (4 * n * n))
    bounds = tuple((middle + side * half) / (1 + z * z / n) for side in (-1, 1))
    rate = cell.collision_rate
    assert (rate.value, rate.low, rate.high, rate.n) == pytest.approx((0.3, *bounds, 10))
    assert (failed.runs, failed.failed, failed.collision_rate, failed.means) == (0, 1, None, {})


def test_changes_are_those_of_the_same_seed():
    """Seeds differ by seconds, rain takes a tenth: only pairs can tell."""
    clear = [drive_row(seed, 0.0, ttc=1.0 + seed) for seed in range(8)]
    rainy = [drive_row(seed, 8.5, ttc=0.9 + seed) for seed in range(8)][::-1]
    first, second = results.summarized([*rainy, *clear, drive_row(9, 8.5, ttc=0.0)])
    change = second.changes["min_ttc_s"]
    assert first.changes == {} and change.n == 8
    assert change.value == pytest.approx(-0.1) and change.high < -0.0999 < change.low + 0.001
    assert second.means["min_ttc_s"].high - second.means["min_ttc_s"].low > 1


def test_neither_cells_nor_their_figure_depend_on_the_order_of_rows():
    rows = [drive_row(seed, r, agent=agent, ttc=1 + seed / 3, collision=seed > r / 8) for seed in range(3)
            for r in (20.0, 0.0) for agent in ("two", "one")]  # fmt: skip
    cells = results.summarized(rows)
    assert [(cell.agent, cell.intensity_mm_h) for cell in cells] == [("one", 0), ("one", 20), ("two", 0), ("two", 20)]
    assert msgpack.encode(cells) == msgpack.encode(results.summarized(rows[::-1]))
    assert np.array_equal(scenario_figure(cells), scenario_figure(cells))


# Folder


def test_it_goes_on_where_it_was_stopped(jobs, folder):
    users = (structs.replace(jobs[3].scenario.road_users[0], model="absent.ply"),)
    jobs[3] = structs.replace(jobs[3], scenario=structs.replace(jobs[3].scenario, road_users=users))
    work = run_sweep(jobs, SerialExecutor(), folder)
    for _ in range(3):
        next(work)
    work.close()
    assert folder.to_do(jobs) == jobs[2:]
    assert run(jobs[2:], folder) == SweepRun(2, 1)
    assert folder.to_do(jobs) == [] and folder.to_do(jobs, retry_failed=True) == jobs[3:]
    *rows, failed = folder.read(jobs).values()
    assert failed["status"] == "failed" and "absent.ply" in failed["error"] and failed["min_ttc_s"] is None
    for job, row in zip(jobs, rows, strict=False):
        rollout = read_rollout(folder.rollouts / f"{job.id}.jsonl")
        assert (rollout.seed, rollout.scene_hash, rollout.software["gsrain"]) == (job.seed, job.scene_hash, job.program)
        assert (row["status"], row["end"], row["steps"], row["agent"]) == ("finished", "time", 4, "constant-velocity")
        assert row["intensity_mm_h"] == rollout.scenario["rain"]["intensity_mm_h"] == job.scenario.rain.intensity_mm_h
        assert list(row) == list(results.columns_of("drive"))  # neither times nor places
    assert '"worker"' in folder.log.read_text()


def test_a_damaged_row_counts_as_missing_and_of_equal_jobs_the_last_row_wins(jobs, folder):
    for job in jobs:
        folder.keep(job, JobResult(id=job.id, error="first"))
        folder.keep(job, answer(job))
        assert folder.read([job])[job.id]["status"] == "finished"
    (folder.rows / f"{jobs[0].id}.parquet").write_bytes(b"PAR1 torn")
    (folder.rows / f"{jobs[1].id}.parquet").replace(folder.rows / f"{jobs[2].id}.parquet")
    assert folder.to_do(jobs) == jobs[:3] and folder.others(jobs[3:]) == 2
    assert len(folder.log.read_text().splitlines()) == 8


def test_a_full_disk_stops_it_and_loses_nothing(jobs, folder, monkeypatch):
    written = []

    def full(path, rollout):
        if len(written) == 2:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        written.append(path)

    monkeypatch.setattr(results, "write_rollout", full)
    with pytest.raises(OSError, match="2 rows: No space left"):
        run(jobs, folder)
    assert folder.to_do(jobs) == jobs[2:]
    assert all(file.suffix == ".parquet" and not file.name.startswith(".") for file in folder.rows.iterdir())
    folder.log.write_bytes(folder.log.read_bytes() + b'{"at": "2026')  # a line that is torn stands by itself
    folder.keep(jobs[3], answer(jobs[3]))
    *_, torn, last = folder.log.read_text().splitlines()
    assert torn == '{"at": "2026' and jobs[3].id in last


def test_a_scene_a_file_or_a_version_that_changes_stops_it_and_fails_no_job(jobs, folder, tmp_path):
    scene = tmp_path / "road" / "scene.json"
    scene.write_bytes(scene.read_bytes() + b"\n")
    with pytest.raises(OSError, match="road"):
        run(jobs, folder)
    assert folder.read(jobs) == {}
    for change, word in (({"program": "0.0.1"}, "0.0.1"), ({"files": {"absent.onnx": "0123"}}, "absent.onnx")):
        outcome = run_job(structs.replace(jobs[0], **change), folder.clips)
        assert outcome.stops and word in outcome.error


# Tables


@pytest.fixture(scope="module")
def done(tmp_path_factory):
    """A sweep over two scenes of the same name, with all rows but one."""
    base = tmp_path_factory.mktemp("tables")
    roads = [write_road(base / place / "road") for place in ("a", "b")]
    sweep = sweep_of([write_scenario(base / "short.yaml", roads[0])], scenes=[str(each) for each in roads])
    jobs, folder = jobs_of(sweep), results.SweepFolder(base / "out")
    folder.describe(sweep, jobs)
    for job in jobs[:-1]:
        folder.keep(job, run_job(job, folder.clips))
    return sweep, jobs, folder


def test_tables_figures_and_report_hold_the_rows_in_the_order_of_the_jobs(done):
    sweep, jobs, folder = done
    numbers = write_tables(folder, sweep, jobs).numbers
    assert (numbers["jobs"], numbers["rows"], numbers["failed"]) == (8, 7, 0)
    rows = results.rows_in((folder.path / "table.parquet").read_bytes())
    assert [row["id"] for row in rows] == [job.id for job in jobs[:-1]] and rows == list(folder.read(jobs).values())
    assert [cell["runs"] for cell in numbers["cells"]] == [2, 2, 2, 1]
    page = (folder.path / "report.html").read_text()
    assert "1 of 8 jobs" in page and "rain changes" in page
    one, other = (np.asarray(Image.open(folder.path / "figures" / f"short-road{end}.png")) for end in ("", "-2"))
    assert one.shape == other.shape and (one != other).any()  # one has a drive less
    lines = (folder.path / "jobs.jsonl").read_text().splitlines()
    assert lines == sorted(lines) and [msgspec.json.decode(line)["id"] for line in lines] == sorted(j.id for j in jobs)
    assert '"intensities_mm_h"' in (folder.path / "sweep.json").read_text()
    numbers = write_tables(folder, sweep, jobs[:3]).numbers  # rows of other settings are left out and counted
    assert (numbers["jobs"], numbers["rows"], numbers["other_rows"]) == (3, 3, 4)


# Rendered clips


@pytest.fixture(scope="module")
def clips(tmp_path_factory):
    """Two cars stand before the ego's camera; two clips of two small frames."""
    folder = tmp_path_factory.mktemp("scenes") / "boxy"
    write_scene(boxy_scene(), folder)
    recording = {"output": "frames", "cameras": ["all"], "fps": 2, "last_s": 1, "size_px": [96, 64]}
    fields = {"kind": "render", "scenes": [str(folder)], "intensities_mm_h": [0, 12], "recording": recording}
    return msgspec.convert(fields | {"labels": "coco", "backend": "cpu"}, RenderSweep)


def test_clips_differ_in_rain_and_share_their_labels(clips, folder):
    numbers = finished(run_sweep_and_report(clips, folder.path, SerialExecutor())).numbers
    assert (numbers["rows"], numbers["failed"], numbers["cells"]) == (2, 0, [])
    jobs = jobs_of(clips)
    clear, rainy = (folder.read(jobs)[job.id] for job in jobs)
    assert (clear["frames"], clear["cameras"], clear["sizes_px"], clear["drops"]) == (2, 1, "96x64", 0)
    assert rainy["drops"] > 0 and rainy["implied_mm_h"] == pytest.approx(12, rel=0.02)
    assert [row["clip"] for row in (clear, rainy)] == [f"clips/{job.id}" for job in jobs]
    frames = [folder.path / row["clip"] / "frames" for row in (clear, rainy)]
    images = [np.asarray(Image.open(each / "000001.png")) for each in frames]
    assert images[0].shape == (64, 96, 3) and (images[0] != images[1]).mean() > 0.05
    labels = [json.loads((each / "labels.coco.json").read_text()) for each in frames]
    assert labels[0]["annotations"] == labels[1]["annotations"] and len(labels[0]["annotations"]) == 4
    assert (frames[1] / "000001.depth.png").is_file()


def test_labels_are_drawn_once_for_all_intensities(clips, folder, monkeypatch):
    calls = []
    for name in ("write_object_labels", "export_frames"):
        monkeypatch.setattr(worker, name, _counted(getattr(worker, name), calls))
    recording = structs.replace(clips.recording, passes=("color", "depth", "labels"))
    jobs = jobs_of(structs.replace(clips, recording=recording, intensities_mm_h=(0.0, 8.5, 12.0)))
    assert run(jobs, folder) == SweepRun(3, 0)
    assert calls.count("write_object_labels") == 1 and calls.count("export_frames") == 1 + 3
    (shared,) = (folder.path / "labels").iterdir()
    files = [each.relative_to(shared) for each in shared.rglob("*") if each.is_file()]
    names = {"000000.labels.png", "000001.labels.png", "labels.coco.json", "labels.json"}
    assert {each.name for each in files} == names
    for job in jobs:
        assert all((folder.clips / job.id / each).read_bytes() == (shared / each).read_bytes() for each in files)
    other = jobs_of(structs.replace(clips, recording=structs.replace(recording, fps=3.0)))
    assert other[0].labels_id != jobs[0].labels_id


def _counted(function, calls):
    def counting(*arguments):
        calls.append(function.__name__)
        return function(*arguments)

    return counting


def test_elsewhere_a_clip_is_the_same_bytes_and_one_that_stands_is_not_drawn_anew(clips, tmp_path, monkeypatch):
    job = jobs_of(clips)[1]
    first, second = results.SweepFolder(tmp_path / "first"), results.SweepFolder(tmp_path / "second")
    old, new = (first.clips / f".{job.id}.{digits}.part" for digits in ("01dc11b5", "0e3c11b5"))
    for part in (old, new):
        part.mkdir(parents=True)
    os.utime(old, (0, 0))
    for folder in (first, second):
        run([job], folder)
    rows = [(folder.rows / f"{job.id}.parquet").read_bytes() for folder in (first, second)]
    assert rows[0] == rows[1] and first.read([job])[job.id]["clip_hash"]
    assert {each.name for each in first.clips.iterdir()} == {job.id, new.name}
    (first.rows / f"{job.id}.parquet").unlink()
    monkeypatch.setattr(worker_cache(), "renderer", lambda backend: pytest.fail("drawn anew"))
    run([job], first)
    assert (first.rows / f"{job.id}.parquet").read_bytes() == rows[0]
    absent = structs.replace(job, recording=structs.replace(clips.recording, cameras=("absent",)))
    assert run([absent], first) == SweepRun(1, 1)
    assert "absent" in first.read([absent])[absent.id]["error"] and not list(first.path.glob(f"clips/{absent.id}*"))
