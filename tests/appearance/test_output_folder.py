"""Transfers by name, and their folders: written whole or not at all, read back, and taken as a capture."""

import json
import logging
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from gsrain_engine.appearance.base import ClearView, RainyView, TransferSettings
from gsrain_engine.appearance.output_folder import (
    PrecomputedTransfer,
    TransferRecord,
    read_record,
    read_transferred,
    write_transferred,
)
from gsrain_engine.appearance.registry import open_transfer
from gsrain_engine.appearance.wet_look.environment import ImageEnvironment
from gsrain_engine.datasets.capture import CaptureError
from gsrain_engine.datasets.open_capture import open_capture
from gsrain_engine.scene.camera import Camera, look_at
from gsrain_engine.scene.scene import rotation_to_z_up

SIZE = (12, 16)
TURNED = np.eye(4)
TURNED[:3, :3] = 2.5 * rotation_to_z_up((0.0, -1.0, 0.0))


def rainy(name: str, seed: int = 0, *, with_film: bool = True) -> RainyView:
    r = np.random.default_rng(seed)
    pose = look_at(r.normal(size=3) + [0, 0, 2], np.array([9.0, 0, 1]), np.array([0.0, 0, 1]))
    normals = r.normal(size=(*SIZE, 3)).astype(np.float32)
    normals /= np.linalg.norm(normals, axis=2, keepdims=True)
    image, other = (r.random((*SIZE, 3)).astype(np.float32) for _ in range(2))
    depth, sky, vehicles, film = (r.random(SIZE).astype(np.float32) for _ in range(4))
    clear = ClearView(name, Camera(16, 12, 20.0, 21.0, 8.5, 6.0, pose), 1.5, image, 30 * depth, normals, sky,
                      vehicles, "FRONT")  # fmt: skip
    return RainyView(clear, other, film if with_film else None)


def written(folder: Path, *views: RainyView, record: TransferRecord | None = None) -> Path:
    list(write_transferred(folder, views, record or TransferRecord("wet", "street", {"seed": 3})))
    return folder


def test_what_is_written_comes_back(tmp_path):
    one, two = rainy("FRONT_000"), rainy("b", 1, with_film=False)
    views = read_transferred(written(tmp_path / "out", one, two))
    assert len(views) == 2
    assert (views.record.method, views.record.made_of, views.record.settings) == ("wet", "street", {"seed": 3})
    assert views[1].film is None
    assert [view.clear.name for view in views[1:]] == ["b"]
    back = views[0]
    assert (back.clear.name, back.clear.time_s, back.clear.sensor) == ("FRONT_000", 1.5, "FRONT")
    np.testing.assert_allclose(back.clear.camera.world_to_camera, one.clear.camera.world_to_camera)
    np.testing.assert_allclose(back.image, one.image, atol=0.5 / 255 + 1e-6)
    np.testing.assert_allclose(back.film, one.film, atol=0.5 / 255 + 1e-6)
    for name in ("image", "sky", "vehicles"):
        np.testing.assert_allclose(getattr(back.clear, name), getattr(one.clear, name), atol=0.5 / 255 + 1e-6)
    np.testing.assert_allclose(back.clear.depth, one.clear.depth, rtol=1e-6)
    np.testing.assert_allclose(back.clear.normals, one.clear.normals, atol=1e-3)


def test_cameras_are_in_the_units_and_axes_of_what_it_was_made_of(tmp_path):
    view = rainy("a")
    folder = written(tmp_path / "out", view, record=TransferRecord("wet", "model", {}, TURNED))
    capture = open_capture(folder)
    assert capture.up == pytest.approx((0, -1, 0))
    assert not capture.is_metric
    own = capture[0]
    np.testing.assert_allclose(own.camera.moved(TURNED).world_to_camera, view.clear.camera.world_to_camera, atol=1e-9)
    np.testing.assert_allclose(own.depth * 2.5, view.clear.depth, rtol=1e-5)
    np.testing.assert_allclose(own.normals @ (TURNED[:3, :3] / 2.5).T, view.clear.normals, atol=2e-3)
    back = read_transferred(folder)[0].clear
    np.testing.assert_allclose(back.depth, view.clear.depth, rtol=1e-5)
    np.testing.assert_allclose(back.normals, view.clear.normals, atol=2e-3)


def test_masks_and_missing_depth_come_back(tmp_path):
    mask, view = np.zeros(SIZE, np.bool_), rainy("b")
    mask[3:] = True
    bare = replace(view, clear=replace(view.clear, depth=view.clear.depth * 0, normals=view.clear.normals * 0))
    list(write_transferred(tmp_path / "out", [rainy("a"), bare], TransferRecord("wet", "drive"), {"a": mask}.get))
    one, other = open_capture(tmp_path / "out")
    np.testing.assert_array_equal(one.mask, mask)
    assert other.mask is None and other.depth is None and one.depth is not None
    assert not read_transferred(tmp_path / "out")[1].clear.normals.any()


def test_names_of_a_data_set_become_file_names(tmp_path):
    written(tmp_path / "out", rainy("CAM/one.jpg"))
    assert (tmp_path / "out" / "CAM_one.png").is_file()
    with pytest.raises(ValueError, match="two views would have the file name CAM_one.png"):
        written(tmp_path / "twice", rainy("CAM/one.jpg"), rainy("CAM_one"))
    assert not (tmp_path / "twice").exists()


def test_stopping_leaves_what_was_there(tmp_path):
    folder = written(tmp_path / "out", rainy("old"))
    work = write_transferred(folder, (rainy(name) for name in "ab"), TransferRecord("wet", "street"))
    next(work)
    work.close()
    assert [each.name for each in tmp_path.iterdir()] == ["out"]
    assert (folder / "old.png").is_file()
    written(folder, rainy("new"))
    assert not (folder / "old.png").exists()
    assert [each.name for each in tmp_path.iterdir()] == ["out"]


def test_other_folders_and_files_are_left_alone(tmp_path):
    file = tmp_path / "photos" / "mine.png"
    file.parent.mkdir()
    file.write_bytes(b"x")
    for place, views, match in (
        (file.parent, [rainy("a")], "photos"), (file, [rainy("a")], r"mine\.png"), (tmp_path / "none", [], "none"),
    ):  # fmt: skip
        with pytest.raises(ValueError, match=match):
            written(place, *views)
    assert [each.name for each in file.parent.iterdir()] == ["mine.png"] and not (tmp_path / "none").exists()
    (tmp_path / "empty").mkdir()
    assert len(read_transferred(written(tmp_path / "empty", rainy("a")))) == 1


@pytest.mark.parametrize(
    ("change", "name"), [({"version": 9}, "version 9"), ({"to_world": [1]}, "to_world"), (None, "transfer")]
)
def test_records_are_checked(tmp_path, change, name):
    file = written(tmp_path / "out", rainy("a")) / "transfer.json"
    file.write_text(json.dumps({} if change is None else json.loads(file.read_text()) | change))
    with pytest.raises(CaptureError, match=rf"transfer\.json.*{name}"):
        read_record(tmp_path / "out")


# Methods

NOTHING = np.zeros((20, 30), np.float32)


def clear(name: str, sensor: str = "") -> ClearView:
    grey = np.full((20, 30, 3), 0.5, np.float32)
    return ClearView(name, Camera(30, 20, 30, 30, 15, 10), 0.0, grey, NOTHING, grey * 0, NOTHING, NOTHING, sensor)


def picture(value: int, size: tuple[int, int] = (30, 20)) -> Image.Image:
    return Image.new("RGB", size, (value, value, value))


def test_pictures_stand_in_by_the_names_of_views(tmp_path, caplog):
    (tmp_path / "CAM").mkdir()
    picture(10).save(tmp_path / "one.png")
    picture(20, (60, 40)).save(tmp_path / "CAM" / "two.jpg")
    picture(30).save(tmp_path / "other.png")
    stand_in = open_transfer("images", TransferSettings(images=tmp_path), ImageEnvironment())
    with caplog.at_level(logging.WARNING):
        made = list(stand_in.transferred([clear("one"), clear("x/two.jpg", "CAM"), clear("three")]))
    assert [round(float(each.image.mean()) * 255) for each in made] == [10, 20]
    assert all(each.image.shape == (20, 30, 3) and each.film is None for each in made)
    assert "'three'" in caplog.text and "'other'" in caplog.text
    caplog.clear()
    rainy_one = RainyView(clear("one"), np.full((20, 30, 3), 0.25, np.float32), NOTHING)
    (made,) = PrecomputedTransfer(written(tmp_path / "t", rainy_one)).transferred([clear("one")])
    assert made.image.mean() == pytest.approx(0.25, abs=0.01)
    assert caplog.messages == []  # the folder's other files are no pictures of views


@pytest.mark.parametrize(
    ("name", "size", "expected"),
    [("other", (30, 20), "has no picture of a view; expected one.png"), ("one", (20, 20), "other proportions")],
)
def test_pictures_that_cannot_be_those_of_the_views_are_refused(tmp_path, name, size, expected):
    picture(10, size).save(tmp_path / f"{name}.png")
    with pytest.raises(CaptureError, match=expected):
        list(PrecomputedTransfer(tmp_path).transferred([clear("one")]))
    with pytest.raises(CaptureError, match="no such folder"):
        PrecomputedTransfer(tmp_path / "nowhere")
