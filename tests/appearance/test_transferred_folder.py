import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gsrain_engine.appearance.base import ClearView, RainyView
from gsrain_engine.appearance.output_folder import TransferRecord, read_record, read_transferred, write_transferred
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


def test_the_folder_is_a_capture_of_rainy_pictures(tmp_path):
    view = rainy("a")
    capture = open_capture(written(tmp_path / "out", view))
    assert capture.problems == ()
    assert capture.is_metric and capture.up == (0, 0, 1)
    np.testing.assert_array_equal(capture[0].image, np.rint(view.image * 255).astype(np.uint8))
    np.testing.assert_array_equal(capture[0].sky, view.clear.sky >= 0.5)
    np.testing.assert_array_equal(capture[0].depth, view.clear.depth)


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


def test_what_may_not_be_learned_from_is_told(tmp_path):
    mask = np.zeros(SIZE, np.bool_)
    mask[3:] = True
    record = TransferRecord("wet", "drive")
    list(write_transferred(tmp_path / "out", [rainy("a"), rainy("b")], record, {"a": mask}.get))
    one, other = open_capture(tmp_path / "out")
    np.testing.assert_array_equal(one.mask, mask)
    assert other.mask is None


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
    (tmp_path / "photos").mkdir()
    (tmp_path / "photos" / "mine.png").write_bytes(b"x")
    with pytest.raises(ValueError, match="holds other things"):
        written(tmp_path / "photos", rainy("a"))
    with pytest.raises(ValueError, match="is a file"):
        written(tmp_path / "photos" / "mine.png", rainy("a"))
    assert [each.name for each in (tmp_path / "photos").iterdir()] == ["mine.png"]
    (tmp_path / "empty").mkdir()
    assert len(read_transferred(written(tmp_path / "empty", rainy("a")))) == 1
    with pytest.raises(ValueError, match="no view to write"):
        written(tmp_path / "none")


@pytest.mark.parametrize(
    ("change", "expected"),
    [({"version": 9}, "version 9 is newer"), ({"to_world": [1]}, "similarity"), ({"method": None}, None)],
)
def test_records_are_checked(tmp_path, change, expected):
    file = written(tmp_path / "out", rainy("a")) / "transfer.json"
    values = json.loads(file.read_text()) | change
    file.write_text(json.dumps(values if expected else {}))
    with pytest.raises(CaptureError, match=expected or "not the record of a transfer"):
        read_record(tmp_path / "out")


def test_a_view_without_depth_or_normals_comes_back_without(tmp_path):
    view = rainy("a")
    bare = replace(view, clear=replace(view.clear, depth=view.clear.depth * 0, normals=view.clear.normals * 0))
    folder = written(tmp_path / "out", bare)
    assert open_capture(folder)[0].depth is None
    assert not read_transferred(folder)[0].clear.normals.any()
