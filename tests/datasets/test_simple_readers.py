"""Data sets without much structure: plain folders, BDD-100K, RainSense; and how a format is found at all."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from colmap_files import write_binary, write_pictures
from gsrain_engine.datasets.capture import CaptureError, readable_images
from gsrain_engine.datasets.geometry import project_points
from gsrain_engine.datasets.open_capture import FORMATS, capture_format, open_capture
from gsrain_engine.datasets.rainsense import read_rain_sequence


def test_a_plain_folder_is_for_transfer_and_says_so(tmp_path: Path) -> None:
    write_pictures(tmp_path, ("one.png", "two.jpg", "two.png"))
    (tmp_path / "notes.txt").write_text("no picture")
    capture = open_capture(tmp_path)
    assert [view.name for view in capture] == ["one", "two.jpg", "two.png"]
    assert not capture.has_poses
    assert not capture.is_metric
    assert "run COLMAP" in capture.problems[0]
    camera = capture[0].camera
    assert np.degrees(2 * np.arctan(32 / camera.fx)) == pytest.approx(60)
    np.testing.assert_allclose(camera.world_to_camera[:3, :3] @ [1, 0, 0], [0, 0, 1])  # looks along +x
    np.testing.assert_allclose(camera.world_to_camera[:3, :3] @ [0, 0, 1], [0, -1, 0])  # z is up


def test_sideways_pictures_of_phones_stand_upright(tmp_path: Path) -> None:
    picture = Image.fromarray(np.zeros((48, 64, 3), np.uint8))
    picture.paste((255, 0, 0), (0, 0, 64, 10))
    exif = Image.Exif()
    exif[0x0112] = 6  # turn by 90 degrees to the right: the top row becomes the right column
    picture.save(tmp_path / "phone.jpg", exif=exif, quality=95)
    (view,) = open_capture(tmp_path)
    assert (view.camera.width, view.camera.height) == (48, 64)
    assert view.image.shape == (64, 48, 3)
    np.testing.assert_allclose(view.image[:, -5].mean(axis=0), [255, 0, 0], atol=12)


def test_broken_pictures_are_named(tmp_path: Path) -> None:
    write_pictures(tmp_path, ("a.jpg", "b.jpg"))
    (tmp_path / "a.jpg").write_bytes((tmp_path / "a.jpg").read_bytes()[:-200])
    capture = open_capture(tmp_path)
    assert [view.name for view in capture] == ["b"]
    assert "a.jpg: the picture is cut off" in capture.problems[1]
    (tmp_path / "b.jpg").write_bytes(b"")
    with pytest.raises(CaptureError, match="no picture in it can be read"):
        open_capture(tmp_path)


def test_pictures_that_only_decoding_finds_broken(tmp_path: Path) -> None:
    write_pictures(tmp_path, ("a.png", "b.png"))
    whole = (tmp_path / "a.png").read_bytes()
    (tmp_path / "a.png").write_bytes(whole[:200] + bytes(len(whole) - 300) + whole[-100:])  # its end is still there
    capture = open_capture(tmp_path)
    assert len(capture) == 2
    done: list[float] = []
    usable = readable_images(capture, done.append)
    assert [view.name for view in usable] == ["b"]
    assert "View a is left out: " in usable.problems[-1]
    assert done == [0.5, 1.0]
    assert readable_images(usable) is usable


def test_formats_are_found_in_their_order(tmp_path: Path) -> None:
    assert FORMATS[-1].name == "image folder"  # anything with pictures would be one
    write_pictures(tmp_path / "images")
    write_binary(tmp_path / "sparse/0")
    found = capture_format(tmp_path)
    assert found is not None
    assert found.name == "COLMAP"
    for below in ("sparse", "sparse/0"):
        assert capture_format(tmp_path / below) is found
    assert capture_format(tmp_path / "nothing") is None


def test_what_is_no_capture_is_refused_in_one_sentence(tmp_path: Path) -> None:
    write_pictures(tmp_path / "garden")
    with pytest.raises(CaptureError, match="gardem: no such file or folder; did you mean garden?"):
        open_capture(tmp_path / "gardem")
    with pytest.raises(CaptureError, match="street: no such file or folder; gsrain street DIR writes pictures"):
        open_capture("street")
    (tmp_path / "empty").mkdir()
    with pytest.raises(CaptureError, match="empty: not a capture that is known; expected one of capture folder, "):
        open_capture(tmp_path / "empty")
    with pytest.raises(CaptureError, match="a.png: not a capture"):
        open_capture(tmp_path / "garden" / "a.png")


def test_real_bdd100k_frames(test_data: Path) -> None:
    capture = open_capture(test_data / "weather" / "bdd100k")
    assert len(capture) == 6
    assert capture[0].image.shape == (720, 1280, 3)
    assert not capture.has_poses
    found = capture_format(test_data / "weather" / "bdd100k")
    assert found is not None
    assert found.name == "BDD-100K"


@pytest.mark.parametrize("layout", ["list", "one each"])
def test_bdd100k_labels_tell_the_weather(tmp_path: Path, layout: str) -> None:
    names = ("0000f77c-6257be58", "0000f77c-cb820c98")
    write_pictures(tmp_path / "images/100k/train", tuple(f"{name}.jpg" for name in names))
    attributes = {"weather": "rainy", "timeofday": "night", "scene": "city street"}
    row = {"name": f"{names[0]}.jpg", "attributes": attributes, "labels": [{"category": "car", "box2d": {"x1": 1}}]}
    folder = tmp_path / "labels"
    if layout == "list":
        folder.mkdir()
        (folder / "bdd100k_labels_images_train.json").write_text(json.dumps([row]))
    else:
        (folder / "100k/train").mkdir(parents=True)
        (folder / f"100k/train/{names[0]}.json").write_text(json.dumps({**row, "name": names[0]}))
    (folder / "broken.json").write_text("[{")
    for path in (tmp_path, tmp_path / "images/100k/train"):
        capture = open_capture(path)
        assert [view.name for view in capture] == list(names)
        assert capture[0].attributes == attributes
        assert capture[1].attributes == {}
        assert any("1 label files are left out" in told and "broken.json" in told for told in capture.problems)


def test_real_rainsense_sequence_has_lidar_and_boxes(test_data: Path) -> None:
    folder = test_data / "weather" / "rainsense" / "clear" / "scene_0" / "case_000"
    capture = open_capture(folder)
    (view,) = capture
    assert view.attributes == {"rain_mm_h": "0"}
    assert view.lens is not None
    assert view.camera.to_json() == read_rain_sequence(folder).camera.to_json()
    assert len(capture.sweeps[0].points_m) == 17700
    assert "holds no exact rotation (it stretches by 2.5%)" in capture.problems[0]
    # What the lidar sees close by is the road below the camera, which stands 1.5 m above it (as assumed).
    near = capture.sweeps[0].points_m[capture.sweeps[0].points_m[:, 0] < 12]
    assert abs(np.median(near[:, 2])) < 0.35
    (person,) = capture.boxes
    assert person.class_name == "Pedestrian"
    pose = person.track.pose(view.time_s)
    assert pose is not None
    # The label's own 2D box must hold the projected middle of the thing.
    label = (folder / "label" / "label_000.txt").read_text().split()
    left, top, right, bottom = (float(word) for word in label[4:8])
    middle = pose[:3, 3] + pose[:3, 2] * person.size_lwh[2] / 2
    (pixel,), _ = project_points(middle[None], view.camera, view.lens)
    assert left < pixel[0] < right
    assert top < pixel[1] < bottom


def test_real_rainsense_as_a_whole(test_data: Path) -> None:
    capture = open_capture(test_data / "weather" / "rainsense")
    assert [view.attributes["rain_mm_h"] for view in capture] == ["0", "1.376", "2.654", "4.75", "9.245", "9.245"]
    assert len(capture.sensors) == 5
    assert not capture.has_poses
    assert not capture.sweeps
    assert len({view.name for view in capture}) == 6


def test_damaged_rainsense_lidar_is_named(test_data: Path, tmp_path: Path) -> None:
    folder = tmp_path / "case"
    shutil.copytree(test_data / "weather" / "rainsense" / "clear" / "scene_0" / "case_000", folder)
    (folder / "lidar" / "frame_000.csv").write_text("X,Y,Z,Reflectivity\n1,2,3\n")
    capture = open_capture(folder)
    assert capture.sweeps == ()
    assert any("frame_000.csv: no table" in told for told in capture.problems)
    (folder / "context" / "calib_lid_to_cam.txt").write_text("Tr: 1 2 3\n")
    (folder / "label" / "label_000.txt").write_text("Pedestrian 1 2\n")
    capture = open_capture(folder)
    assert any("The lidar is left out: " in told and "calib_lid_to_cam.txt" in told for told in capture.problems)
    assert any("line 1 has 3 words" in told for told in capture.problems)
    (folder / "context" / "camera_intrinsics.txt").write_text("K: 1\n")
    with pytest.raises(CaptureError, match=r"camera_intrinsics.txt: 1 numbers, expected 14"):
        open_capture(folder)


def test_a_folder_that_may_not_be_looked_into_is_no_capture(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(_: Path) -> list[Path]:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr("gsrain_engine.datasets.capture_folder.images_in", refuse)
    with pytest.raises(CaptureError, match="not a capture that is known"):
        open_capture(tmp_path)


def test_what_a_bdd_folder_leaves_out_is_counted_and_named(tmp_path: Path) -> None:
    frames = tuple(f"0000f77c-6257be5{k}.jpg" for k in range(4))
    write_pictures(tmp_path, (*frames, "holiday.jpg", "cat.png"))
    capture = open_capture(tmp_path)
    assert len(capture) == 4
    told = next(each for each in capture.problems if "not named" in each)
    assert told.startswith("2 of 6 pictures are left out") and "cat.png" in told and "holiday.jpg" in told


def test_a_few_frames_of_bdd_among_other_pictures_leave_none_out(tmp_path: Path) -> None:
    write_pictures(tmp_path, ("0000f77c-6257be58.jpg", "a.jpg", "b.jpg", "c.jpg"))
    assert getattr(capture_format(tmp_path), "name", "") == "image folder"
    assert len(open_capture(tmp_path)) == 4
