"""Rain for other programs: rainy copies of recordings, and the rain's Gaussians."""

import json
import os
import shutil

import numpy as np
import pytest

from app.main import run
from appearance.sunny_street import capture_of, street_photo
from datasets.sample_drives import write_kitti
from gsrain_engine.datasets.capture_folder import write_views
from gsrain_engine.datasets.open_capture import open_capture
from gsrain_engine.scene.formats.scene_files import read_scene, write_scene
from small_capture import small_capture
from small_scene import small_scene


@pytest.fixture
def recording(tmp_path):
    folder = tmp_path / "drive"
    for _ in write_views(folder, small_capture()):
        pass
    (folder / "lidar").mkdir()
    (folder / "lidar" / "000000.bin").write_bytes(b"points")
    return folder


def test_a_rainy_copy_has_rain_in_its_images_and_all_else_as_it_was(recording, tmp_path):
    target = tmp_path / "rainy"
    before = {file: file.read_bytes() for file in recording.rglob("*") if file.is_file()}
    assert run(["export-rain", str(recording), "-o", str(target), "--rain", "50"]) == 0
    assert before == {file: file.read_bytes() for file in recording.rglob("*") if file.is_file()}
    clear, rainy = open_capture(recording), open_capture(target)
    images = {view.image_file for view in clear}
    sidecar = json.loads(target.with_name(f"{target.name}.provenance.json").read_text())
    assert sidecar["changed_files"] == sorted(file.relative_to(recording).as_posix() for file in images)
    for file, content in before.items():
        is_same = (target / file.relative_to(recording)).read_bytes() == content
        assert is_same == (file not in images), file
    for own, other in zip(rainy, clear, strict=True):
        assert own.name == other.name and own.image.shape == other.image.shape
        np.testing.assert_array_equal(own.camera.world_to_camera, other.camera.world_to_camera)
        assert 1 < np.abs(own.image.astype(int) - other.image).mean() < 80


def test_a_copy_has_the_same_bytes_on_any_number_of_cores(recording, tmp_path, monkeypatch):
    facts = []
    for cores in (1, 3):
        monkeypatch.setattr("gsrain_engine.recordings.pictures.usable_cores", lambda cores=cores: cores)
        target = tmp_path / f"rainy_{cores}"
        assert run(["export-rain", str(recording), "-o", str(target), "--rain", "50"]) == 0
        facts.append(json.loads(target.with_name(f"{target.name}.provenance.json").read_text())["pictures"])
    assert list(facts[0].items()) == list(facts[1].items())
    files = [file for file in (tmp_path / "rainy_1").rglob("*") if file.is_file()]
    assert len(files) > 3
    for file in files:
        assert file.read_bytes() == (tmp_path / "rainy_3" / file.relative_to(tmp_path / "rainy_1")).read_bytes()


def test_a_drive_of_kitti_is_copied_with_the_calibration_of_its_day(tmp_path):
    day = tmp_path / "2011_09_26"
    drive = write_kitti(day)
    copy, rain = tmp_path / "rainy", tmp_path / "white.yaml"
    rain.write_text("intensity_mm_h: 50\ndrop_color: [1, 1, 1]\n")  # its pictures have one color, that of their sky
    assert run(["export-rain", str(drive), "-o", str(copy), "--preset", str(rain)]) == 0
    assert relative_files(copy) == relative_files(day)
    for own, other in zip(open_capture(copy), open_capture(drive), strict=True):
        np.testing.assert_allclose(own.camera.world_to_camera, other.camera.world_to_camera, atol=0.02)
        assert not np.array_equal(own.image, other.image)


@pytest.fixture
def linked_recording(recording, tmp_path):
    """A recording with labels, calibration, an empty folder, and links of all kinds."""
    elsewhere = tmp_path / "disk"
    (elsewhere / "labels" / "deep").mkdir(parents=True)
    (elsewhere / "labels" / "deep" / "a.txt").write_text("label")
    (elsewhere / "labels" / "empty").mkdir()
    (recording / "empty").mkdir()
    (recording / "calibration.txt").write_text("calibration")
    (recording / "labels").symlink_to("../disk/labels")
    (recording / "link.txt").symlink_to("calibration.txt")
    (recording / "lidar" / "around").symlink_to("..")
    (recording / "nowhere").symlink_to("../gone")
    os.mkfifo(recording / "pipe")
    return recording


LEFT_OUT = {"lidar/around", "nowhere", "pipe"}


@pytest.mark.parametrize("rain", ["0", "5"])
def test_a_copy_is_whole_and_shares_nothing_with_the_recording(linked_recording, tmp_path, rain, capsys):
    source, target = linked_recording, tmp_path / "rainy"
    numbers = tmp_path / "numbers.json"
    assert run(["export-rain", str(source), "-o", str(target), "--rain", rain, "--json", str(numbers)]) == 0
    names = {each.relative_to(source).as_posix() for each in source.rglob("*")} - LEFT_OUT
    names |= {"labels/deep", "labels/deep/a.txt", "labels/empty"}
    copied = list(target.rglob("*"))
    assert {each.relative_to(target).as_posix() for each in copied} == names
    assert not any(each.is_symlink() for each in copied)
    before = {file: file.read_bytes() for file in source.rglob("*") if file.is_file()}
    for file in (each for each in copied if each.is_file()):
        file.write_bytes(b"edited")
    assert before == {file: file.read_bytes() for file in before}
    found = json.loads(numbers.read_text())
    images = 0 if rain == "0" else len(open_capture(source))
    assert (found["files_changed"], found["files_linked"], found["files_left_out"]) == (images, 0, 3)
    assert found["files_copied"] == len([each for each in copied if each.is_file()]) - images
    printed = capsys.readouterr().out
    assert all(f"left out: {name}: " in printed for name in LEFT_OUT)


def test_hard_links_are_made_where_they_are_asked_for(linked_recording, tmp_path):
    source, target, numbers = linked_recording, tmp_path / "rainy", tmp_path / "numbers.json"
    arguments = ["--rain", "5", "--hard-links", "--json", str(numbers)]
    assert run(["export-rain", str(source), "-o", str(target), *arguments]) == 0
    for name in ("calibration.txt", "link.txt", "labels/deep/a.txt"):
        assert (target / name).samefile(source / name) and not (target / name).is_symlink()
    found, images = json.loads(numbers.read_text()), {view.image_file for view in open_capture(source)}
    assert not any((target / file.relative_to(source)).samefile(file) for file in images)
    files = len([each for each in target.rglob("*") if each.is_file()])
    counts = [found[f"files_{what}"] for what in ("changed", "copied", "linked")]
    assert counts == [len(images), 0, files - len(images)]


def relative_files(folder):
    return sorted(each.relative_to(folder) for each in folder.rglob("*") if each.is_file())


def test_a_plain_folder_of_images_has_a_rainy_copy(recording, tmp_path):
    plain = tmp_path / "plain"
    plain.mkdir()
    for view in open_capture(recording):
        shutil.copy(view.image_file, plain / f"{view.time_s:.2f}.photo.png")
    assert run(["export-rain", str(plain), "-o", str(tmp_path / "rainy"), "--rain", "50"]) == 0
    assert sorted(each.name for each in (tmp_path / "rainy").iterdir()) == sorted(each.name for each in plain.iterdir())
    assert all((tmp_path / "rainy" / each.name).read_bytes() != each.read_bytes() for each in plain.iterdir())


def test_no_rain_is_the_same_images(recording, tmp_path):
    assert run(["export-rain", str(recording), "-o", str(tmp_path / "dry"), "--rain", "0"]) == 0
    for own, other in zip(open_capture(tmp_path / "dry"), open_capture(recording), strict=True):
        np.testing.assert_array_equal(own.image, other.image)


def test_the_light_of_photographs_is_softened_and_said_so_unless_it_is_kept(tmp_path, capsys):
    folder = tmp_path / "drive"
    for _ in write_views(folder, capture_of(street_photo(), street_photo(sunny=False))):
        pass
    colors = {}
    for name, options in {"rainy": [], "kept": ["--keep-light"]}.items():
        numbers = tmp_path / f"{name}.json"
        target = ["-o", str(tmp_path / name), "--rain", "8", *options, "--json", str(numbers)]
        assert run(["export-rain", str(folder), *target]) == 0
        kinds = {"kept (--keep-light)": 2} if options else {"softened to overcast": 1, "kept (already overcast)": 1}
        assert json.loads(numbers.read_text())["light"] == kinds
        words = "kept (--keep-light)" if options else "1 kept (already overcast), 1 softened to overcast"
        assert f"light: {words}\n" in capsys.readouterr().out
        pictures = json.loads((tmp_path / f"{name}.provenance.json").read_text())["pictures"]
        assert len({each["photo_light"] for each in pictures.values()}) == len(kinds)
        colors[name] = [view.image for view in open_capture(tmp_path / name)]
    assert colors["kept"][1].tobytes() == colors["rainy"][1].tobytes()
    assert np.ptp(colors["rainy"][0][:20].mean(axis=(0, 1))) < 15 < np.ptp(colors["kept"][0][:20].mean(axis=(0, 1)))


def test_a_scene_has_no_light_to_keep(tmp_path, capsys):
    write_scene(small_scene(), tmp_path / "scene.ply")
    target = ["-o", str(tmp_path / "rain.ply"), "--rain", "8", "--keep-light"]
    assert run(["export-rain", str(tmp_path / "scene.ply"), *target]) == 2
    assert "--keep-light: " in capsys.readouterr().err


def test_a_damaged_image_is_named_and_stays_as_it_is(recording, tmp_path, capsys):
    broken = open_capture(recording)[-1].image_file
    broken.write_bytes(broken.read_bytes()[:-2000])
    assert run(["export-rain", str(recording), "-o", str(tmp_path / "rainy"), "--rain", "5"]) == 0
    assert broken.name in capsys.readouterr().out
    assert (tmp_path / "rainy" / broken.name).read_bytes() == broken.read_bytes()


def test_a_copy_goes_to_a_new_folder_elsewhere(recording, tmp_path):
    (tmp_path / "taken").mkdir()
    (tmp_path / "taken" / "file").touch()
    for target in (recording / "inside", tmp_path / "taken", tmp_path / "rainy.mcap"):
        assert run(["export-rain", str(recording), "-o", str(target), "--rain", "5"]) == 2
    assert sorted(each.name for each in tmp_path.iterdir()) == ["drive", "taken"]
    assert not (recording / "inside").exists()


def test_a_real_sample_of_nuscenes_stays_one(test_data, tmp_path):
    shutil.copytree(test_data / "driving" / "nuscenes_sample", tmp_path / "sample")
    assert run(["export-rain", str(tmp_path / "sample"), "-o", str(tmp_path / "rainy"), "--rain", "8.5"]) == 0
    clear, rainy = open_capture(tmp_path / "sample"), open_capture(tmp_path / "rainy")
    assert (rainy.sensors, len(rainy.boxes), len(rainy.sweeps)) == (
        clear.sensors, len(clear.boxes), len(clear.sweeps)
    )  # fmt: skip
    assert all((own.image != other.image).any() for own, other in zip(rainy, clear, strict=True))


def test_the_rain_s_gaussians_are_written_with_and_without_the_scene(tmp_path, capsys):
    write_scene(small_scene(), tmp_path / "scene")
    arguments = ["export-rain", str(tmp_path / "scene"), "--rain", "20", "--time", "1", "--size", "160x120"]
    assert run([*arguments, "-o", str(tmp_path / "rain.ply")]) == 0
    assert run([*arguments, "-o", str(tmp_path / "both.ply"), "--with-scene"]) == 0
    assert run([*arguments, "-o", str(tmp_path / "wet.glb"), "--with-scene", "--wet"]) == 0
    assert "streak Gaussians and" in capsys.readouterr().out
    (rain,), (both,), (wet,) = (read_scene(tmp_path / name).layers for name in ("rain.ply", "both.ply", "wet.glb"))
    count = len(rain.gaussians)
    assert count > 1000 and len(both.gaussians) == count + small_scene().gaussian_count
    np.testing.assert_allclose(both.gaussians.means[-count:], rain.gaussians.means, atol=1e-6)
    np.testing.assert_allclose(both.gaussians.opacities[-count:], rain.gaussians.opacities, atol=1e-6)
    surfaces = slice(0, small_scene().gaussian_count)
    np.testing.assert_allclose(wet.gaussians.means[surfaces], both.gaussians.means[surfaces], atol=1e-6)
    assert np.abs(wet.gaussians.sh[surfaces] - both.gaussians.sh[surfaces]).max(axis=(1, 2)).mean() > 0.1
    # In the frame of files -y is up: rain falls around the camera, within 25 m of the ground.
    assert -25 < rain.gaussians.means[:, 1].min() < rain.gaussians.means[:, 1].max() < 5
