"""Rows, summaries, figures, tables and the folder of a sweep, which damage, full disks and changes do not spoil."""

import csv
import errno
import io
import json
import math
import os
import sys

import msgspec
import numpy as np
import pytest
from msgspec import msgpack, structs
from PIL import Image

from boxy_scene import boxy_scene
from gsrain_engine.scene.formats.scene_files import write_scene
from gsrain_engine.simulation.metrics.summary import DriveMetrics, table_csv
from gsrain_engine.simulation.rollout_io import read_rollout
from gsrain_engine.sweep import results
from gsrain_engine.sweep.executors import SerialExecutor
from gsrain_engine.sweep.expansion import jobs_of
from gsrain_engine.sweep.report import scenario_figure, write_tables
from gsrain_engine.sweep.run import SweepRun, run_sweep, run_sweep_and_report
from gsrain_engine.sweep.settings import RenderSweep
from gsrain_engine.sweep.worker import JobResult, run_job, worker_cache

from .other_works import answer
from .small_sweep import small_jobs, sweep_of, write_road, write_scenario


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


# Rows


def test_columns_are_parameters_and_every_metric():
    columns = results.columns_of("drive")
    assert {each.name for each in structs.fields(DriveMetrics)} < columns.keys()
    kinds = {"collision": bool, "min_ttc_s": float, "collided_with": str, "planned_point_collision_rate": float,
             "steps": int}  # fmt: skip
    assert kinds.items() <= columns.items()


def test_a_failed_row_has_its_parameters_and_its_error(jobs):
    row = results.row_of(jobs[3], JobResult(id=jobs[3].id, error='it said "no", then\nnothing'))
    data = results.rows_parquet([row], "drive")
    assert results.rows_in(data) == [row] and results.rows_parquet([row], "drive") == data
    assert (row["status"], row["seed"], row["intensity_mm_h"], row["min_ttc_s"]) == ("failed", 1, 8.5, None)
    read = next(csv.DictReader(io.StringIO(table_csv(list(results.columns_of("drive")), [row]))))
    assert read["error"] == row["error"] and read["min_ttc_s"] == "" and read["intensity_mm_h"] == "8.5"


def drive_row(seed, intensity, *, collision=False, ttc=2.0, failed=False, agent="one"):
    row = dict.fromkeys(results.columns_of("drive"))
    row |= {"scene": "street", "scenario": "lead", "agent": agent, "seed": seed, "intensity_mm_h": intensity}
    if failed:
        return row | {"status": "failed", "error": "it broke"}
    return row | {"status": "finished", "collision": collision, "min_ttc_s": ttc, "planned_point_collision_rate": 0.1}


def test_collisions_have_wilsons_interval():
    (cell,) = results.summarized([drive_row(seed, 8.5, collision=seed < 3) for seed in range(10)])
    assert (cell.runs, cell.failed, cell.collisions, cell.collision_rate.mean) == (10, 0, 3, 0.3)
    z, n, p = 1.959963984540054, 10, 0.3
    middle, half = p + z * z / (2 * n), z * math.sqrt(p * (1 - p) / n + z * z / (4 * n * n))
    bounds = [(middle + side * half) / (1 + z * z / n) for side in (-1, 1)]
    assert [cell.collision_rate.low, cell.collision_rate.high] == pytest.approx(bounds)


def test_failed_runs_are_counted_and_do_not_count():
    rows = [drive_row(0, 1.2, failed=True), drive_row(1, 1.2, ttc=3.0), drive_row(0, 12.0, failed=True)]
    first, second = results.summarized(rows)
    assert (first.runs, first.failed, first.means["min_ttc_s"].mean) == (1, 1, 3.0)
    assert (second.runs, second.failed, second.collision_rate, second.means) == (0, 1, None, {})


def test_changes_are_those_of_the_same_seed():
    """Seeds differ by seconds, rain takes a tenth: only pairs can tell."""
    clear = [drive_row(seed, 0.0, ttc=1.0 + seed) for seed in range(8)]
    rainy = [drive_row(seed, 8.5, ttc=0.9 + seed) for seed in range(8)][::-1]
    first, second = results.summarized([*rainy, *clear, drive_row(9, 8.5, ttc=0.0)])
    change = second.changes["min_ttc_s"]
    assert first.changes == {} and change.count == 8
    assert change.mean == pytest.approx(-0.1) and change.high < -0.0999 < change.low + 0.001
    assert second.means["min_ttc_s"].high - second.means["min_ttc_s"].low > 1


def test_neither_cells_nor_their_figure_depend_on_the_order_of_rows():
    rows = [drive_row(seed, r, agent=agent, ttc=1 + seed / 3, collision=seed > r / 8) for seed in range(3)
            for r in (20.0, 0.0) for agent in ("two", "one")]  # fmt: skip
    cells = results.summarized(rows)
    assert [(cell.agent, cell.intensity_mm_h) for cell in cells] == [("one", 0), ("one", 20), ("two", 0), ("two", 20)]
    assert msgpack.encode(cells) == msgpack.encode(results.summarized(rows[::-1]))
    figure, alone = scenario_figure(cells), scenario_figure(cells[:2])
    assert np.array_equal(figure, scenario_figure(cells))
    blue, orange = (((np.abs(figure.astype(int) - color).sum(axis=2) < 6).sum()) for color in (
        (31, 119, 180), (255, 127, 14)))  # fmt: skip
    assert blue > 500 and orange > 500 and (np.abs(alone.astype(int) - (255, 127, 14)).sum(axis=2) < 6).sum() == 0


# Folder


def test_it_goes_on_where_it_was_stopped(jobs, folder):
    work = run_sweep(jobs, SerialExecutor(), folder)
    for _ in range(3):
        next(work)
    work.close()
    assert folder.to_do(jobs) == jobs[2:]
    assert run(jobs[2:], folder) == SweepRun(2, 0)
    assert folder.to_do(jobs) == [] and folder.others(jobs) == 0
    for job in jobs:
        rollout, row = read_rollout(folder.rollouts / f"{job.id}.jsonl"), folder.read([job])[job.id]
        assert (rollout.seed, rollout.scene_hash, rollout.software["gsrain"]) == (job.seed, job.scene_hash, job.program)
        assert rollout.scenario["rain"]["intensity_mm_h"] == job.scenario.rain.intensity_mm_h
        assert (row["status"], row["end"], row["steps"], row["agent"]) == ("finished", "time", 4, "constant-velocity")
        assert row["distance_m"] == pytest.approx(5.0, abs=0.1) and row["scene_hash"] == job.scene_hash
        assert not row.keys() & {"seconds", "worker", "host", "at"}  # neither when nor where
    assert '"worker"' in folder.log.read_text()


def test_without_the_package_that_writes_rows_nothing_is_begun(folder, monkeypatch):
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(ValueError, match="pyarrow"):
        folder.describe(sweep_of(["cut-in"]), [])
    assert not folder.path.exists()


def test_a_failed_job_is_a_row_and_done_again_only_when_asked(jobs, folder):
    users = (structs.replace(jobs[0].scenario.road_users[0], model="absent.ply"),)
    broken = structs.replace(jobs[0], scenario=structs.replace(jobs[0].scenario, road_users=users))
    assert run([broken, jobs[1]], folder) == SweepRun(2, 1)
    row = folder.read([broken])[broken.id]
    assert row["status"] == "failed" and "absent.ply" in row["error"]
    assert folder.to_do([broken, jobs[1]]) == []
    assert folder.to_do([broken, jobs[1]], retry_failed=True) == [broken]


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
    numbers = write_tables(folder, sweep, jobs)
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
    numbers = write_tables(folder, sweep, jobs[:3])  # rows of other settings are left out and counted
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
    numbers = finished(run_sweep_and_report(clips, folder.path, SerialExecutor()))
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


def test_a_clip_that_fails_leaves_nothing_but_its_row(clips, folder):
    job = structs.replace(jobs_of(clips)[0], recording=structs.replace(clips.recording, cameras=("absent",)))
    assert run([job], folder) == SweepRun(1, 1)
    assert "absent" in folder.read([job])[job.id]["error"] and not list(folder.path.glob("clips/*"))
