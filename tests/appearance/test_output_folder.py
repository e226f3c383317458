"""Transfer folders, written whole or not at all and read back as views and as a capture; pictures as a transfer."""

import json
import logging
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from gsrain_engine.appearance.base import ClearView, RainyView, TransferSettings
from gsrain_engine.appearance.output_folder import (
    ContactSheet,
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


def rainy(name: str, seed: int = 0, sensor: str = "FRONT") -> RainyView:
    r = np.random.default_rng(seed)
    pose = look_at(r.normal(size=3) + [0, 0, 2], np.array([9.0, 0, 1]), np.array([0.0, 0, 1]))
    normals = r.normal(size=(*SIZE, 3)).astype(np.float32)
    normals /= np.linalg.norm(normals, axis=2, keepdims=True)
    image, other = (r.random((*SIZE, 3)).astype(np.float32) for _ in range(2))
    depth, sky, vehicles, film = (r.random(SIZE).astype(np.float32) for _ in range(4))
    camera = Camera(16, 12, 20.0, 21.0, 8.5, 6.0, pose)
    return RainyView(ClearView(name, camera, 1.5, image, 30 * depth, normals, sky, vehicles, sensor), other, film)


def written(folder: Path, *views: RainyView, record: TransferRecord | None = None) -> Path:
    list(write_transferred(folder, views, record or TransferRecord("wet", "street", {"seed": 3})))
    return folder


def assert_alike(found: ClearView | Camera, expected: ClearView | Camera) -> None:
    """Compare all fields to the precision of the files."""
    tolerances = {"depth": 1e-4, "normals": 2e-3, "world_to_camera": 1e-9}
    for name in (field.name for field in fields(expected)):
        mine, theirs = getattr(found, name), getattr(expected, name)
        if isinstance(mine, np.ndarray):
            np.testing.assert_allclose(mine, theirs, atol=tolerances.get(name, 0.501 / 255), err_msg=name)
        elif name == "camera":
            assert_alike(mine, theirs)
        else:
            assert mine == theirs, name


@pytest.mark.parametrize("to_world", [np.eye(4), TURNED])
def test_views_and_their_record_come_back(tmp_path, to_world):
    views = [rainy("FRONT_000"), replace(rainy("b", 1), film=None, left_out="no ground")]
    record = TransferRecord("wet", "street", {"seed": 3}, to_world)
    back = read_transferred(written(tmp_path / "out", *views, record=record))
    assert (back.record.method, back.record.made_of, back.record.settings) == ("wet", "street", {"seed": 3})
    assert back.record.notes == ("1 of 2 views: no ground.",)
    np.testing.assert_array_equal(back.record.to_world, to_world)
    for found, expected in zip(back, views, strict=True):
        assert_alike(found.clear, expected.clear)
        np.testing.assert_allclose(found.image, expected.image, atol=0.501 / 255)
    np.testing.assert_allclose(back[0].film, views[0].film, atol=0.501 / 255)
    assert back[1].film is None and [view.clear.name for view in back[1:]] == ["b"]
    # As a capture, it has the units and axes of what it was made of.
    capture, scale = open_capture(tmp_path / "out"), np.cbrt(np.linalg.det(to_world[:3, :3]))
    assert capture.is_metric == (scale == 1) and capture.up == pytest.approx(to_world[2, :3] / scale)
    np.testing.assert_allclose(capture[0].depth * scale, views[0].clear.depth, rtol=1e-5)
    np.testing.assert_allclose(capture[0].normals @ (to_world[:3, :3] / scale).T, views[0].clear.normals, atol=2e-3)


def test_masks_and_missing_depth_come_back(tmp_path):
    mask, view = np.zeros(SIZE, np.bool_), rainy("b")
    mask[3:] = True
    bare = replace(view, clear=replace(view.clear, depth=view.clear.depth * 0, normals=view.clear.normals * 0))
    list(write_transferred(tmp_path / "out", [rainy("a"), bare], TransferRecord("wet", "drive"), {"a": mask}.get))
    one, other = open_capture(tmp_path / "out")
    np.testing.assert_array_equal(one.mask, mask)
    assert other.mask is None and other.depth is None and one.depth is not None
    assert_alike(read_transferred(tmp_path / "out")[1].clear, bare.clear)


def test_stopping_and_refusing_leave_what_was_there(tmp_path):
    folder = written(tmp_path / "out", rainy("CAM/old.jpg"))
    work = write_transferred(folder, (rainy(name) for name in "ab"), TransferRecord("wet", "street"))
    next(work)
    work.close()
    with pytest.raises(ValueError, match=r"CAM_one\.png"):
        written(folder, rainy("CAM/one.jpg"), rainy("CAM_one"))
    assert [each.name for each in tmp_path.iterdir()] == ["out"] and (folder / "CAM_old.png").is_file()
    written(folder, rainy("new"))
    assert [each.name for each in tmp_path.iterdir()] == ["out"] and not (folder / "CAM_old.png").exists()
    file = tmp_path / "photos" / "mine.png"
    file.parent.mkdir()
    file.write_bytes(b"x")
    for place, views in ((file.parent, [rainy("a")]), (file, [rainy("a")]), (tmp_path / "none", [])):
        with pytest.raises(ValueError, match=place.name):
            written(place, *views)
    assert [each.name for each in file.parent.iterdir()] == ["mine.png"] and not (tmp_path / "none").exists()


@pytest.mark.parametrize(
    ("change", "name"), [({"version": 9}, "version 9"), ({"to_world": [1]}, "to_world"), (None, "transfer")]
)
def test_records_are_checked(tmp_path, change, name):
    file = written(tmp_path / "out", rainy("a")) / "transfer.json"
    file.write_text(json.dumps({} if change is None else json.loads(file.read_text()) | change))
    with pytest.raises(CaptureError, match=rf"transfer\.json.*{name}"):
        read_record(tmp_path / "out")


def test_a_contact_sheet_shows_views_before_and_after():
    sheet, views = ContactSheet(3, 2, 32), [rainy(name, i) for i, name in enumerate("abc")]
    for view in views:
        sheet.add(view)
    picture = np.asarray(sheet.picture())
    assert picture.shape == (8 + 2 * (16 + 24 + 8), 8 + 2 * (32 + 8), 3)
    for row, view in ((0, views[0]), (1, views[2])):
        for column, image in enumerate((view.clear.image, view.image)):
            top, left = 24 + 48 * row, 8 + 40 * column
            assert picture[top : top + 24, left : left + 32].mean() == pytest.approx(255 * image.mean(), abs=1.5)


# Pictures as a transfer


def picture(value: int, size: tuple[int, int] = (16, 12)) -> Image.Image:
    return Image.new("RGB", size, (value, value, value))


def test_pictures_stand_in_by_the_names_of_views(tmp_path, caplog):
    (tmp_path / "CAM").mkdir()
    picture(10).save(tmp_path / "one.png")
    picture(20, (60, 45)).save(tmp_path / "CAM" / "two.jpg")
    picture(30).save(tmp_path / "other.png")
    views = [rainy(name, 0, sensor).clear for name, sensor in (("one", ""), ("x/two.jpg", "CAM"), ("three", ""))]
    stand_in = open_transfer("images", TransferSettings(images=tmp_path), ImageEnvironment())
    with caplog.at_level(logging.WARNING):
        made = list(stand_in.transferred(views))
    assert [round(float(each.image.mean()) * 255) for each in made] == [10, 20]
    assert all(each.image.shape == (*SIZE, 3) and each.film is None for each in made)
    assert "'three'" in caplog.text and "'other'" in caplog.text
    caplog.clear()
    view = rainy("one", 0, "")
    (again,) = PrecomputedTransfer(written(tmp_path / "t", view)).transferred(views[:1])
    np.testing.assert_allclose(again.image, view.image, atol=0.501 / 255)
    assert caplog.messages == []  # the folder's other files are no pictures of views


@pytest.mark.parametrize(
    ("name", "size", "folder", "expected"),
    [("other", (16, 12), ".", r"one\.png"), ("one", (20, 20), ".", r"one\.png"), ("one", (16, 12), "no", "no")],
)
def test_pictures_that_cannot_be_those_of_the_views_are_refused(tmp_path, name, size, folder, expected):
    picture(10, size).save(tmp_path / f"{name}.png")
    with pytest.raises(CaptureError, match=expected):
        list(PrecomputedTransfer(tmp_path / folder).transferred([rainy("one").clear]))
