"""Exports of drives: the built-in one, and the sensors of each."""

import pytest

from app.main import BAD_INPUT, run
from gsrain_engine.backends import open_renderer
from gsrain_engine.simulation import drive_exports, lidar_turns
from gsrain_engine.simulation.drive_exports import DriveExport, FinishedDrive, drive_export_names, find_drive_export
from gsrain_engine.simulation.rollout_io import read_any_rollout
from small_rollout import approach
from small_scene import small_scene


class Video:
    """Names the camera and the step in place of each image."""

    def __init__(self, played, renderer, lod, mounted):
        self.name, self.steps = "forward" if mounted is None else mounted.name, played.rollout.steps

    def camera_images(self):
        return ((self.name, step.step) for step in self.steps)


@pytest.mark.parametrize(
    ("cameras", "lidar", "images"),
    [("none", False, []), ("front", False, ["forward"]), ("all", True, ["FRONT"]), ("none", True, [])],
)
def test_an_export_gets_the_records_that_it_contains(cameras, lidar, images, monkeypatch):
    monkeypatch.setattr(drive_exports, "RolloutVideo", Video)
    monkeypatch.setattr(lidar_turns, "rollout_lidar_turns", lambda played, sensor: range(len(played.rollout.steps)))
    export, rollout, counted = (
        DriveExport((".a",), lambda drive, path: None, cameras=cameras, lidar=lidar),
        approach(),
        [],
    )
    with open_renderer("cpu") as renderer:
        drive = FinishedDrive(export, rollout, small_scene(), renderer)
        drive.on_record = lambda: counted.append(1)
        assert [*drive.camera_images()] == [(name, step.step) for name in images for step in rollout.steps]
        turns = [*drive.lidar_turns()] if lidar else []
    assert len(turns) == len(rollout.steps) * lidar
    assert len(counted) == drive.record_count == len(rollout.steps) * (len(images) + lidar)


def test_without_a_renderer_there_are_no_images():
    export = DriveExport((".a",), lambda drive, path: None, cameras="all")
    drive = FinishedDrive(export, approach(), small_scene())
    assert [*drive.camera_images()] == [] and drive.record_count == 0


def test_parquet_is_built_in(tmp_path):
    assert drive_export_names()[0] == "parquet"
    export = find_drive_export("parquet", "--export parquet")
    export.write(FinishedDrive(export, approach(), small_scene()), tmp_path / "a.parquet")
    assert read_any_rollout(tmp_path / "a.parquet") == approach()


def test_exports_that_write_the_same_files_are_refused(tmp_path, capsys, monkeypatch):
    twin = DriveExport((".parquet",), lambda drive, path: None)
    monkeypatch.setitem(drive_exports.BUILT_IN, "twin", twin)
    assert run(["drive", "--export", "parquet,twin", "-o", str(tmp_path / "out")]) == BAD_INPUT
    assert "two files of a run would end in .parquet" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
