"""Our own folder of views: what is written comes back, and what is damaged is named."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gsrain_engine.datasets.capture import CaptureError, CaptureFrame, Lens
from gsrain_engine.datasets.capture_folder import write_views
from gsrain_engine.datasets.open_capture import capture_format, open_capture
from gsrain_engine.scene.camera import Camera, look_at


def views() -> list[CaptureFrame]:
    rng = np.random.default_rng(5)
    pose = look_at(np.array([1.0, 2.0, 3.0]), np.array([5.0, 2.5, 2.0]), np.array([0.0, 0.0, 1.0]))
    camera = Camera(16, 12, 20.0, 21.0, 8.25, 6.5, pose, 0.0025)
    normals = rng.normal(size=(12, 16, 3)).astype(np.float32)
    full = CaptureFrame(
        "front_0",
        camera,
        rng.integers(0, 256, (12, 16, 3), np.uint8),
        time_s=1.25,
        sensor="front",
        lens=Lens("opencv", (0.1, 0.2, 0.3, 0.4)),
        depth_source=rng.uniform(0, 90, (12, 16)).astype(np.float32),
        normals_source=normals / np.linalg.norm(normals, axis=2, keepdims=True),
        labels_source=rng.integers(0, 20, (12, 16), np.uint8),
        mask_source=rng.random((12, 16)) > 0.5,
        sky_source=rng.random((12, 16)) > 0.5,
        attributes={"weather": "rainy"},
    )
    plain = CaptureFrame("plain", replace(camera, exposure_s=0.004), rng.integers(0, 256, (12, 16, 3), np.uint8))
    return [full, plain]


@pytest.mark.parametrize("below", [".", "images"])
def test_what_is_written_comes_back(tmp_path: Path, below: str) -> None:
    written = list(write_views(tmp_path / below, views()))
    found = capture_format(tmp_path)
    assert found is not None
    assert found.name == "capture folder"
    capture = open_capture(tmp_path)
    assert capture.problems == ()
    assert capture.is_metric
    for before, after in zip(written, capture, strict=True):
        assert (before.name, before.time_s, before.sensor) == (after.name, after.time_s, after.sensor)
        assert (before.lens, before.attributes) == (after.lens, after.attributes)
        assert before.camera.to_json() == after.camera.to_json()
        assert before.camera.exposure_s == after.camera.exposure_s
        for name in ("image", "depth", "labels", "mask", "sky"):
            np.testing.assert_array_equal(getattr(before, name), getattr(after, name))
    np.testing.assert_allclose(capture[0].normals, written[0].normals, atol=5e-4)  # written as 16-bit floats
    assert capture[1].normals is None


def change(folder: Path, **values: Any) -> None:
    rows = json.loads((folder / "cameras.json").read_text())
    rows[0].update(values)
    (folder / "cameras.json").write_text(json.dumps(rows))


@pytest.mark.parametrize(
    ("values", "told"),
    [
        ({"fx": 0}, "view 0 .front_0.: fx, fy must be above 0"),
        ({"world_to_camera": [[1]]}, "world_to_camera has shape"),
        ({"name": 3}, "view 0: has no name"),
        ({"time_s": "late"}, "time_s must be a finite number"),
        ({"lens": {"model": "fisheye", "coefficients": [1.0]}}, "lens can't be read"),
        ({"lens": {"model": "cracked", "coefficients": [1.0] * 4}}, "'cracked' must be opencv or fisheye"),
    ],
)
def test_fields_that_make_no_sense_are_named(tmp_path: Path, values: dict[str, Any], told: str) -> None:
    list(write_views(tmp_path, views()))
    change(tmp_path, **values)
    with pytest.raises(CaptureError, match=f"cameras.json, {told}" if told.startswith("view") else told):
        open_capture(tmp_path)


def test_missing_pictures_are_named_and_the_rest_is_used(tmp_path: Path) -> None:
    list(write_views(tmp_path, views()))
    (tmp_path / "front_0.png").unlink()
    capture = open_capture(tmp_path)
    assert [view.name for view in capture] == ["plain"]
    assert "front_0.png: no such picture" in capture.problems[0]
    change(tmp_path, width=17)
    (tmp_path / "plain.png").unlink()
    list(write_views(tmp_path / "again", views()[1:]))
    with pytest.raises(CaptureError, match=r"cameras.json: none of its 2 views|not a capture"):
        open_capture(tmp_path)


@pytest.mark.parametrize("name", ["depth.npy", "normals.npy", "labels.png", "mask.png"])
@pytest.mark.parametrize("cut", [0, 10, 100])
def test_cut_pixels_are_found_when_they_are_read(tmp_path: Path, name: str, cut: int) -> None:
    list(write_views(tmp_path, views()))
    file = tmp_path / f"front_0.{name}"
    file.write_bytes(file.read_bytes()[:cut])
    view = open_capture(tmp_path)[0]
    assert view.image.shape == (12, 16, 3)
    with pytest.raises(CaptureError, match=f"front_0.{name}"):
        getattr(view, name.partition(".")[0])


def test_a_lying_array_allocates_nothing(tmp_path: Path) -> None:
    list(write_views(tmp_path, views()))
    file = tmp_path / "front_0.depth.npy"
    file.write_bytes(file.read_bytes().replace(b"(12, 16)", b"(99999999, 16)"))
    with pytest.raises(CaptureError, match=r"front_0.depth.npy"):
        _ = open_capture(tmp_path)[0].depth
