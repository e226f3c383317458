import csv
import io

import msgspec

from gsrain_engine.simulation.metrics.summary import DriveMetrics
from gsrain_engine.sweep.executors import SerialExecutor
from gsrain_engine.sweep.results import SweepFolder, columns_of, row_of, rows_csv, rows_in, rows_parquet
from gsrain_engine.sweep.run import run_sweep
from gsrain_engine.sweep.worker import JobResult

from .small_sweep import small_jobs


def test_columns_are_parameters_and_every_metric():
    metrics = {each.name for each in msgspec.structs.fields(DriveMetrics)}
    columns = columns_of("drive")
    assert metrics < columns.keys()
    assert columns["collision"] is bool and columns["min_ttc_s"] is float and columns["collided_with"] is str
    assert columns["planned_point_collision_rate"] is float and columns["steps"] is int


def test_a_failed_row_keeps_its_parameters_and_its_error(tmp_path):
    job = small_jobs(tmp_path)[3]
    row = row_of(job, JobResult(id=job.id, error='it said "no", then\nnothing'))
    data = rows_parquet([row], "drive")
    assert rows_in(data) == [row] and rows_parquet([row], "drive") == data
    assert (row["status"], row["seed"], row["intensity_mm_h"], row["min_ttc_s"]) == ("failed", 1, 8.5, None)
    read = next(csv.DictReader(io.StringIO(rows_csv([row], "drive"))))
    assert read["error"] == row["error"] and read["min_ttc_s"] == "" and read["intensity_mm_h"] == "8.5"


def test_a_row_says_what_was_measured_and_nothing_of_when_and_where(tmp_path):
    job = small_jobs(tmp_path, seeds=1, intensities_mm_h=[8.5])[0]
    folder = SweepFolder(tmp_path / "out")
    list(run_sweep([job], SerialExecutor(), folder))
    row = folder.read([job])[job.id]
    assert (row["status"], row["end"], row["steps"], row["agent"]) == ("finished", "time", 4, "constant-velocity")
    assert abs(row["distance_m"] - 5.0) < 0.1 and row["scene_hash"] == job.scene_hash
    assert not [name for name in row if name in ("seconds", "worker", "host", "at")]
    assert '"worker"' in folder.log.read_text()
