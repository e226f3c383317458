"""Data sets as a job: resumed, extended, the same bytes twice; their sources; the command and what it refuses."""

import json
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from app.main import BAD_INPUT, run
from boxy_scene import boxy_scene
from dataset_export.nuscenes_rules import check_tables
from dataset_export.small_dataset import COARSE, contents, small_source, steps_of, two_cars, write_dataset
from datasets.sample_drives import write_nuscenes
from gsrain_engine.dataset_export.captures import CaptureSource
from gsrain_engine.dataset_export.scenes import ScenarioSource, SceneSource
from gsrain_engine.dataset_export.source import DatasetChoice
from gsrain_engine.datasets.open_capture import open_capture
from gsrain_engine.scene.camera_path import CameraPath
from gsrain_engine.scene.formats.scene_files import write_scene
from gsrain_engine.scene.geometry import quaternions_from_matrices
from mini_drive import HEIGHT, WIDTH, MiniDrive
from simulation.small_drive import lead, longer_scene, scenario, scene_with_box
from small_scene import AHEAD, small_scene


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    folder = tmp_path_factory.mktemp("whole") / "set"
    write_dataset(folder, "kitti")
    return contents(folder)


@pytest.mark.parametrize("step", [1, 3, 6])
def test_a_stopped_data_set_is_resumed_to_the_same_bytes(whole, tmp_path, step):
    folder = tmp_path / "set"
    work = steps_of(folder, "kitti")
    for _ in range(step):
        next(work)
    work.close()
    before = {file: file.stat().st_mtime_ns for file in folder.rglob("*.png")}
    result = write_dataset(folder, "kitti")
    assert contents(folder) == whole
    assert {file: file.stat().st_mtime_ns for file in before} == before
    pictures = sum("image_2" in str(file) for file in before)
    assert (result.numbers["pictures_found"], result.numbers["pictures_drawn"]) == (pictures, 4 - pictures)


def test_a_rain_can_be_added_later(whole, tmp_path):
    write_dataset(tmp_path / "set", "kitti", 50)
    result = write_dataset(tmp_path / "set", "kitti", 0, 50)
    assert contents(tmp_path / "set") == whole and result.numbers["pictures_found"] == 2
    assert np.asarray(result.figure).shape == (318, 960, 3)


def test_progress_grows_to_the_end(tmp_path):
    fractions = [step.fraction for step in steps_of(tmp_path / "set", "coco", 8.5)]
    assert fractions == sorted(fractions) and fractions[-1] == 1 and len(fractions) > 6


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        (lambda folder: write_dataset(folder, "coco"), "layout differs"),
        (lambda folder: write_dataset(folder, "kitti", source=small_source(moments=1)), "times_s differs"),
        (lambda folder: write_dataset(folder, "kitti", source=small_source(boxy_scene("other"))), "name differs"),
        (lambda folder: write_dataset(folder / "rain_0", "kitti"), "something else"),
    ],
)
def test_another_data_set_in_the_folder_is_refused(tmp_path, change, problem):
    next(steps_of(tmp_path / "set", "kitti", 0))
    before = contents(tmp_path / "set")
    with pytest.raises(ValueError, match=f"^output .*{problem}"):
        change(tmp_path / "set")
    assert contents(tmp_path / "set") == before


# Sources


def test_a_recording_keeps_its_cameras_boxes_and_lidar(tmp_path):
    drive = MiniDrive()
    write_nuscenes(tmp_path / "recorded", drive)
    recorded = open_capture(tmp_path / "recorded")
    source = CaptureSource(recorded, DatasetChoice(sensor=COARSE))
    assert any("instance masks" in each for each in source.left_out)
    write_dataset(tmp_path / "set", "nuscenes", 0, 50, source=source)
    check_tables(tmp_path / "set" / "rain_50")
    clear, rainy = (open_capture(tmp_path / "set" / name) for name in ("rain_0", "rain_50"))
    drive.check(clear, has_boxes=False)
    drive.check_boxes(clear, "vehicle.car")
    assert all(len(a.points_m) < len(b.points_m) for a, b in zip(rainy.sweeps, clear.sweeps, strict=True))
    for own, other in zip(clear, recorded, strict=True):
        assert np.abs(own.image.astype(int) - other.image).max() <= 2  # compressed again
    held = json.loads((tmp_path / "set/rain_50/provenance/CAM_FRONT/000002.json").read_text())
    assert held["intensity_mm_h"] == 50 and held["time_s"] == 1.0
    objects = json.loads((tmp_path / "set/labels/objects/CAM_FRONT/000000.json").read_text())["objects"]
    assert [each["class_name"] for each in objects] == ["vehicle.car"] and objects[0]["segmentation"] == []
    depth = tmp_path / "set" / "labels" / "depth" / "CAM_FRONT" / "000000.png"
    assert depth.is_file() and not (tmp_path / "set" / "labels" / "instances").exists()


def test_a_data_set_and_a_rainy_copy_have_the_same_pictures(tmp_path):
    write_nuscenes(tmp_path / "recorded", MiniDrive())
    for file in (tmp_path / "recorded").rglob("*.jpg"):
        stripes = np.where(np.arange(WIDTH) // 8 % 2, 220, 30).astype(np.uint8)
        Image.fromarray(np.broadcast_to(stripes[:, None], (HEIGHT, WIDTH, 3)).copy()).save(file, quality=95)
    rain = ["--rain", "50"]
    assert run(["export-rain", str(tmp_path / "recorded"), "-o", str(tmp_path / "copy"), *rain]) == 0
    assert run(["dataset", str(tmp_path / "recorded"), "-o", str(tmp_path / "set"), *rain]) == 0
    views = zip(*(open_capture(tmp_path / name) for name in ("recorded", "copy", "set/rain_50")), strict=True)
    for clear, copied, own in views:
        changed = np.abs(copied.image.astype(int) - clear.image).mean()
        assert changed > 1 and np.abs(own.image.astype(int) - copied.image).mean() < 0.1 * changed


def test_moments_of_a_recording_are_thinned_and_cameras_chosen(tmp_path):
    write_nuscenes(tmp_path, MiniDrive())
    recorded = open_capture(tmp_path)
    assert len(CaptureSource(recorded).moments) == 3
    assert [each.time_s for each in CaptureSource(recorded, DatasetChoice(rate_hz=1)).moments] == [0.0, 1.0]
    assert len(CaptureSource(recorded, DatasetChoice(moments=1)).moments) == 1
    assert CaptureSource(recorded, DatasetChoice(width_px=32)).shot(0, "CAM_FRONT").camera.width == 32
    with pytest.raises(ValueError, match="no camera 'CAM_BACK', only CAM_FRONT"):
        CaptureSource(recorded, DatasetChoice(cameras=("CAM_BACK",)))


def test_layouts_with_poses_refuse_a_recording_without(tmp_path):
    write_nuscenes(tmp_path / "recorded", MiniDrive())
    recorded = open_capture(tmp_path / "recorded")
    flat = CaptureSource(replace(recorded, has_poses=False, ego=None, boxes=(), sweeps=()))
    with pytest.raises(ValueError, match=r"^layout nuscenes: .* has no camera poses"):
        write_dataset(tmp_path / "set", "nuscenes", source=flat)
    assert not (tmp_path / "set").exists()
    write_dataset(tmp_path / "flat", "coco", 8.5, source=flat)
    assert json.loads((tmp_path / "flat/rain_8.5/annotations.json").read_text())["annotations"] == []


def test_a_scenario_is_the_same_drive_in_each_rain(tmp_path):
    fields = {"road_users": [lead(ahead_m=9.0)], "duration_s": 1.0, "speed_m_s": 4.0}
    scene = replace(longer_scene(), layers=scene_with_box().layers, actors=scene_with_box().actors)
    source = ScenarioSource(
        scenario(**fields), scene, DatasetChoice(cameras=("CAM_FRONT",), rate_hz=2, moments=2, sensor=COARSE)
    )
    write_dataset(tmp_path / "set", "nuscenes", 0, 50, source=source)
    tables = check_tables(tmp_path / "set" / "rain_50")
    assert [each["timestamp"] for each in tables["sample"]] == [0, 500_000]
    clear, rainy = (open_capture(tmp_path / "set" / name) for name in ("rain_0", "rain_50"))
    assert len(clear.boxes) == 1 and clear.boxes[0].size_lwh == (4.0, 2.0, 1.5)
    moved = clear.ego.positions[1] - clear.ego.positions[0]
    assert 1.5 < moved[0] <= 2.01  # half a second at 4 m/s, or slower behind the car
    np.testing.assert_array_equal(rainy.ego.positions, clear.ego.positions)
    held = json.loads((tmp_path / "set/rain_50/provenance/CAM_FRONT/000001.json").read_text())
    assert held["intensity_mm_h"] == 50 and held["time_s"] == 0.5
    with pytest.raises(ValueError, match="no camera 'FRONT', only CAM_FRONT, CAM_BACK"):
        ScenarioSource(scenario(**fields), scene, DatasetChoice(cameras=("FRONT",)))


def test_a_scene_without_a_rig_is_taken_along_its_path(tmp_path):
    facing = np.tile(quaternions_from_matrices(AHEAD), (2, 1))
    path = CameraPath(np.array([0.0, 1.0]), np.array([[0.0, 0, 2], [6, 0, 2]]), facing, np.full(2, 50.0))
    scene = replace(small_scene(), rigs={}, ego=None)
    source = SceneSource(replace(scene, path=path), DatasetChoice(moments=2, width_px=96, sensor=COARSE))
    assert not source.has_lidar and any("no vehicle with cameras" in each for each in source.left_out)
    write_dataset(tmp_path / "set", "nuscenes", 8.5, source=source)
    places = [each["translation"] for each in check_tables(tmp_path / "set" / "rain_8.5")["ego_pose"]]
    assert places[1][0] - places[0][0] == pytest.approx(3.0, abs=0.2)
    with pytest.raises(ValueError, match="neither a vehicle with cameras nor a camera path"):
        SceneSource(scene)


# The command


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    folder = tmp_path_factory.mktemp("sources")
    write_scene(two_cars(), folder / "cars")
    write_scene(replace(small_scene(), rigs={}, ego=None), folder / "bare")
    write_nuscenes(folder / "recorded", MiniDrive())
    write_dataset(folder / "there", "coco", 0, source=small_source(moments=1))
    return folder


def test_the_command_writes_a_data_set_and_goes_on_with_it(place, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    words = ["dataset", str(place / "cars"), "-o", "set", "--rain", "0,8.5", "--layout", "kitti", "--rate", "1"]
    words += ["--moments", "1", "--width", "96", "--lidar-sensor", "none", "--backend", "cpu", "--json", "set.json"]
    assert run(words) == 0
    assert (
        "1 moments of 1 cameras, 1 pictures and 0 lidar turns in each of 2 rains, 2 objects" in capsys.readouterr().out
    )
    before = contents(tmp_path / "set")
    assert run(words) == 0 and contents(tmp_path / "set") == before
    assert "2 of 2 pictures were there already" in capsys.readouterr().out
    numbers = json.loads((tmp_path / "set.json").read_text())
    assert numbers["pictures_found"] == 2 and [each["folder"] for each in numbers["rains"]] == ["rain_0", "rain_8.5"]


@pytest.mark.parametrize(
    ("words", "problem"),
    [
        ("cars --rain 200", "--rain 200"),
        ("cars --rate 0", "--rate 0"),
        ("cars --moments 0", "--moments 0"),
        ("cars --width 3", "--width 3"),
        ("cars --layout voc", "layout"),
        ("cars --cameras REAR", "'REAR'"),
        ("cars --lidar-sensor 65", "--lidar-sensor"),
        ("cars --layout coco --lidar-sensor 64", "--lidar-sensor 64: the layout coco has no lidar"),
        ("bare", "neither a vehicle with cameras nor a camera path"),
        ("recorded --wet", "--wet: photographs"),
        ("recorded --spray", "--spray: photographs"),
        ("recorded --backend opengl", "--backend opengl: rain over photographs"),
        ("recorded --cameras CAM_BACK", "--cameras: scene-0061 has no camera"),
        ("nothing", "nothing"),
    ],
)
def test_the_command_refuses_by_name(place, tmp_path, capsys, monkeypatch, words, problem):
    monkeypatch.chdir(place)
    assert run(["dataset", *words.split(), "-o", str(tmp_path / "set")]) == BAD_INPUT
    lines = capsys.readouterr().err.strip().splitlines()
    assert problem in lines[-1] and lines[-1].startswith("gsrain: ")
    assert not (tmp_path / "set").exists()


def test_the_command_leaves_other_folders_alone(place, capsys, monkeypatch):
    monkeypatch.chdir(place)
    before = contents(place)
    for folder in ("there", "recorded"):
        assert run(["dataset", "cars", "-o", folder, "--backend", "cpu"]) == BAD_INPUT
        assert f"--output {folder}: " in capsys.readouterr().err
    assert contents(place) == before
