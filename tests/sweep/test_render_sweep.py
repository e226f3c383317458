import json
import os

import msgspec
import numpy as np
import pytest
from PIL import Image

from boxy_scene import boxy_scene
from gsrain_engine.scene.formats.scene_files import write_scene
from gsrain_engine.sweep.executors import SerialExecutor
from gsrain_engine.sweep.expansion import jobs_of
from gsrain_engine.sweep.report import write_tables
from gsrain_engine.sweep.results import SweepFolder
from gsrain_engine.sweep.run import SweepRun, run_sweep
from gsrain_engine.sweep.settings import RenderSweep
from gsrain_engine.sweep.worker import worker_cache


@pytest.fixture(scope="module")
def sweep(tmp_path_factory):
    """Two cars stand before the ego's camera; two clips of two small frames."""
    folder = tmp_path_factory.mktemp("scenes") / "boxy"
    write_scene(boxy_scene(), folder)
    recording = {"output": "frames", "cameras": ["all"], "fps": 2, "last_s": 1, "size_px": [96, 64]}
    told = {"kind": "render", "scenes": [str(folder)], "intensities_mm_h": [0, 12], "recording": recording}
    return msgspec.convert(told | {"labels": "coco", "backend": "cpu"}, RenderSweep)


def finished(work):
    while True:
        try:
            next(work)
        except StopIteration as end:
            return end.value


def test_clips_differ_in_rain_and_share_their_labels(sweep, tmp_path):
    jobs, folder = jobs_of(sweep), SweepFolder(tmp_path / "out")
    assert finished(run_sweep(jobs, SerialExecutor(), folder)) == SweepRun(2, 0)
    clear, rainy = (folder.read(jobs)[job.id] for job in jobs)
    assert (clear["frames"], clear["cameras"], clear["sizes_px"], clear["drops"]) == (2, 1, "96x64", 0)
    assert rainy["drops"] > 0 and rainy["implied_mm_h"] == pytest.approx(12, rel=0.02)
    frames = [folder.path / row["clip"] / "frames" for row in (clear, rainy)]
    pictures = [np.asarray(Image.open(each / "000001.png")) for each in frames]
    assert pictures[0].shape == (64, 96, 3) and (pictures[0] != pictures[1]).mean() > 0.05
    labels = [json.loads((each / "labels.coco.json").read_text()) for each in frames]
    assert labels[0]["annotations"] == labels[1]["annotations"] and len(labels[0]["annotations"]) == 4
    assert (frames[1] / "000001.depth.png").is_file()
    assert [row["clip"] for row in (clear, rainy)] == [f"clips/{job.id}" for job in jobs]
    numbers = write_tables(folder, sweep, jobs)
    assert (numbers["rows"], numbers["failed"], numbers["cells"]) == (2, 0, [])


def test_again_elsewhere_it_is_the_same_bytes_and_a_clip_that_stands_is_not_drawn_again(sweep, tmp_path, monkeypatch):
    job = jobs_of(sweep)[1]
    first, second = SweepFolder(tmp_path / "first"), SweepFolder(tmp_path / "second")
    old, new = (first.clips / f".{job.id}.{digits}.part" for digits in ("01dc11b5", "0e3c11b5"))
    for part in (old, new):
        part.mkdir(parents=True)
    os.utime(old, (0, 0))
    for folder in (first, second):
        finished(run_sweep([job], SerialExecutor(), folder))
    rows = [(folder.rows / f"{job.id}.parquet").read_bytes() for folder in (first, second)]
    assert rows[0] == rows[1] and first.read([job])[job.id]["clip_hash"]
    assert {each.name for each in first.clips.iterdir()} == {job.id, new.name}
    (first.rows / f"{job.id}.parquet").unlink()
    monkeypatch.setattr(worker_cache(), "renderer", lambda backend: pytest.fail("drawn again"))
    finished(run_sweep([job], SerialExecutor(), first))
    assert (first.rows / f"{job.id}.parquet").read_bytes() == rows[0]


def test_a_clip_that_fails_leaves_nothing_but_its_row(sweep, tmp_path):
    job = msgspec.structs.replace(
        jobs_of(sweep)[0], recording=msgspec.structs.replace(sweep.recording, cameras=("absent",))
    )
    folder = SweepFolder(tmp_path / "out")
    assert finished(run_sweep([job], SerialExecutor(), folder)) == SweepRun(1, 1)
    assert "absent" in folder.read([job])[job.id]["error"]
    assert not list(folder.path.glob("clips/*"))
