import io

import numpy as np
import pytest
from msgspec import structs
from PIL import Image

from gsrain_engine.sweep.expansion import jobs_of
from gsrain_engine.sweep.report import write_tables
from gsrain_engine.sweep.results import SweepFolder, rows_in
from gsrain_engine.sweep.worker import run_job

from .small_sweep import sweep_of, write_road, write_scenario


@pytest.fixture(scope="module")
def done(tmp_path_factory):
    """A sweep over two scenes of the same name, with all rows but one."""
    base = tmp_path_factory.mktemp("tables")
    roads = [write_road(base / place / "road") for place in ("a", "b")]
    sweep = sweep_of([write_scenario(base / "short.yaml", roads[0])], scenes=[str(each) for each in roads])
    jobs, folder = jobs_of(sweep), SweepFolder(base / "out")
    folder.describe(sweep, jobs)
    for job in jobs[:-1]:
        folder.keep(job, run_job(job, folder.clips))
    return sweep, jobs, folder


def test_tables_hold_the_rows_in_the_order_of_the_jobs(done):
    sweep, jobs, folder = done
    numbers = write_tables(folder, sweep, jobs)
    assert (numbers["jobs"], numbers["rows"], numbers["failed"]) == (8, 7, 0)
    rows = rows_in((folder.path / "table.parquet").read_bytes())
    assert [row["id"] for row in rows] == [job.id for job in jobs[:-1]]
    assert rows == list(folder.read(jobs).values())
    assert [cell["runs"] for cell in numbers["cells"]] == [2, 2, 2, 1]
    page = (folder.path / "report.html").read_text()
    assert "1 of 8 jobs have not been done yet." in page and "what rain changes" in page


def test_scenes_of_one_name_have_a_figure_each(done):
    sweep, jobs, folder = done
    write_tables(folder, sweep, jobs)
    names = sorted(file.name for file in (folder.path / "figures").iterdir())
    assert names == ["short-road-2.png", "short-road.png"]
    pixels = [np.asarray(Image.open(io.BytesIO((folder.path / "figures" / name).read_bytes()))) for name in names]
    assert pixels[0].shape == pixels[1].shape and (pixels[0] != pixels[1]).any()  # one has a drive less


def test_rows_of_other_settings_are_left_out_and_counted(done):
    sweep, jobs, folder = done
    numbers = write_tables(folder, sweep, jobs[:3])
    assert (numbers["jobs"], numbers["rows"], numbers["other_rows"]) == (3, 3, 4)


def test_a_worker_of_another_version_stops_the_sweep(done):
    _, jobs, folder = done
    outcome = run_job(structs.replace(jobs[0], program="0.0.1"), folder.clips)
    assert outcome.stops and "the sweep was made by gsrain 0.0.1" in outcome.error
    missing = run_job(structs.replace(jobs[0], files={"absent.onnx": "0123"}), folder.clips)
    assert missing.stops and "absent.onnx is not what it was when the sweep began (not there" in missing.error


def test_what_was_run_is_written_down(done):
    _, jobs, folder = done
    lines = (folder.path / "jobs.jsonl").read_text().splitlines()
    assert len(lines) == 8 and lines == sorted(lines)
    assert all(any(job.id in line for line in lines) for job in jobs)
    assert '"intensities_mm_h"' in (folder.path / "sweep.json").read_text()
