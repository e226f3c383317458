"""Errors about folders that are no capture name the nearest kind, and what is missing."""

import shutil
from pathlib import Path

import pytest
from PIL import Image

from app.main import BAD_INPUT, run
from colmap_files import write_binary, write_pictures
from datasets.test_kitti_odometry import write_sequence
from datasets.test_kitti_raw import drive_on_the_road, write_kitti
from datasets.test_nuscenes import write_nuscenes
from gsrain_engine.datasets.capture import CaptureError
from gsrain_engine.datasets.layout_hints import nearest_layout
from gsrain_engine.datasets.open_capture import open_capture
from gsrain_engine.scene.files import SceneFormatError
from gsrain_engine.scene.formats.scene_files import read_scene
from mini_drive import MiniDrive


def kitti_without_oxts(folder: Path) -> Path:
    write_kitti(folder, drive_on_the_road())
    drive = next(folder.glob("*_drive_*"))
    shutil.rmtree(drive / "oxts")
    return drive


def kitti_day_without_oxts(folder: Path) -> Path:
    kitti_without_oxts(folder)
    return folder


def kitti_drive_without_calibration(folder: Path) -> Path:
    drive = kitti_without_oxts(folder)
    for file in folder.glob("calib_*.txt"):
        file.unlink()
    return drive


def sequence_without_times(folder: Path) -> Path:
    sequence = write_sequence(folder)
    (sequence / "times.txt").unlink()
    return sequence


def nuscenes_without_sample_data(folder: Path) -> Path:
    write_nuscenes(folder, MiniDrive())
    (folder / "v1.0-mini" / "sample_data.json").unlink()
    return folder


def colmap_without_images(folder: Path) -> Path:
    write_binary(folder / "sparse" / "0")
    (folder / "sparse" / "0" / "images.bin").unlink()
    return folder


def cameras_alone(folder: Path) -> Path:
    (folder / "cameras.json").write_text("[]")
    return folder


def meta_alone(folder: Path) -> Path:
    (folder / "meta.json").write_text('{"title": "my pictures"}')
    return folder


def scenes_in_a_folder(folder: Path) -> Path:
    for name in ("cat.splat", "dog.spz", "meta.json", "notes.txt"):
        (folder / name).write_bytes(b"{}")
    return folder


def iterations(folder: Path) -> Path:
    for name in ("iteration_7000", "iteration_30000"):
        (folder / "point_cloud" / name).mkdir(parents=True)
        (folder / "point_cloud" / name / "point_cloud.ply").write_bytes(b"ply\n")
    return folder


def phone_pictures(folder: Path) -> Path:
    (folder / "IMG_1.HEIC").write_bytes(b"\0\0\0\x18ftypheic")
    return folder


@pytest.mark.parametrize(
    ("write", "told"),
    [
        (kitti_without_oxts, "KITTI raw without oxts"),
        (kitti_day_without_oxts, "KITTI raw without oxts"),
        (kitti_drive_without_calibration, "KITTI raw without oxts and calib_cam_to_cam.txt"),
        (sequence_without_times, "KITTI odometry without times.txt"),
        (nuscenes_without_sample_data, "nuScenes without v1.0-*/sample_data.json"),
        (colmap_without_images, "COLMAP without images.bin"),
        (cameras_alone, "capture folder without pictures"),
        (meta_alone, "SOG without its pictures (*.webp)"),
        (scenes_in_a_folder, "a folder of scenes (give one of the files in it: cat.splat, dog.spz)"),
        (
            phone_pictures,
            "a folder of pictures of formats that can't be read (convert them to JPEG or PNG): IMG_1.HEIC",
        ),
    ],
)
def test_the_nearest_kind_is_named(tmp_path: Path, write, told: str, capsys: pytest.CaptureFixture[str]) -> None:
    path = write(tmp_path)
    with pytest.raises(CaptureError) as error:
        open_capture(path)
    assert f"nearest is {told}" in str(error.value)
    assert run(["info", str(path)]) == BAD_INPUT
    printed = capsys.readouterr().err
    assert told in printed and printed.count("\n") == 1


def test_nothing_is_near_to_an_empty_folder(tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("no capture")
    assert nearest_layout(tmp_path) is None and nearest_layout(tmp_path / "notes.txt") is None
    with pytest.raises(CaptureError, match="not a capture that is known; expected one of"):
        open_capture(tmp_path)


def test_pictures_whose_model_is_incomplete_are_not_opened_without_a_word(tmp_path: Path) -> None:
    write_pictures(colmap_without_images(tmp_path) / "images")
    capture = open_capture(tmp_path)
    assert not capture.has_poses
    assert any("nearest to the folder is COLMAP without images.bin" in each for each in capture.problems)


def test_a_folder_too_high_names_the_captures_below_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_sequence(tmp_path / "data" / "drives" / "first")
    write_pictures(tmp_path / "data" / "thumbs")
    for path in (tmp_path / "data", tmp_path / "data" / "drives"):
        name = "drives/first" if path.name == "data" else "first"
        assert run(["info", str(path)]) == BAD_INPUT
        assert f"give a folder in it: {name} (KITTI odometry)" in capsys.readouterr().err
    assert run(["transfer", str(tmp_path), "-o", str(tmp_path / "out")]) == BAD_INPUT
    assert "give a folder in it: data/thumbs (image folder)" in capsys.readouterr().err


def test_pictures_that_can_not_be_read_are_named(tmp_path: Path) -> None:
    write_pictures(tmp_path)
    phone_pictures(tmp_path)
    Image.new("RGB", (8, 8)).save(tmp_path / "small.webp")
    problems = open_capture(tmp_path).problems
    assert any("1 more picture is left out" in each and "IMG_1.HEIC" in each for each in problems)
    assert not any("nearest" in each for each in problems)  # a picture in WebP makes no SOG


def test_a_scene_is_asked_for_by_its_name_where_a_folder_holds_some(tmp_path: Path) -> None:
    with pytest.raises(SceneFormatError, match=r"give one of the files in it: cat.splat, dog.spz$"):
        read_scene(scenes_in_a_folder(tmp_path))


def test_the_last_iteration_of_a_training_is_asked_for(tmp_path: Path) -> None:
    with pytest.raises(SceneFormatError, match=r"in it: point_cloud/iteration_30000/point_cloud.ply$"):
        read_scene(iterations(tmp_path))
