"""transforms.json as nerfstudio, instant-ngp and Blender write it."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from colmap_files import write_pictures
from gsrain_engine.datasets.capture import CaptureError, Lens
from gsrain_engine.datasets.open_capture import capture_format, open_capture
from gsrain_engine.scene.camera import look_at

EYES = (np.array([1.0, 2.0, 3.0]), np.array([-4.0, 2.0, 3.0]))
TARGET, UP = np.array([0.0, 10.0, 2.0]), np.array([0.0, 0.0, 1.0])
INTRINSICS = {"fl_x": 50.0, "fl_y": 51.0, "cx": 32.0, "cy": 24.0, "w": 64, "h": 48}


def opengl_pose(eye: np.ndarray) -> list[list[float]]:
    """Camera to world with x right, y up, z backward, built without the reader's own matrices."""
    forward = (TARGET - eye) / np.linalg.norm(TARGET - eye)
    right = np.cross(forward, UP)
    right /= np.linalg.norm(right)
    matrix = np.eye(4)
    matrix[:3, 0], matrix[:3, 1], matrix[:3, 2], matrix[:3, 3] = right, np.cross(right, forward), -forward, eye
    return matrix.tolist()


def write(folder: Path, shared: dict[str, Any] | None = None, **each: Any) -> Path:
    names = ("images/b.png", "images/a.png")
    write_pictures(folder, names)
    frames = [{"file_path": n, "transform_matrix": opengl_pose(e), **each} for n, e in zip(names, EYES, strict=True)]
    document = {**(INTRINSICS if shared is None else shared), "frames": frames}
    (folder / "transforms.json").write_text(json.dumps(document))
    return folder


@pytest.mark.parametrize("shared", [True, False])
def test_poses_turn_from_opengl_to_opencv(tmp_path: Path, shared: bool) -> None:
    write(tmp_path, INTRINSICS if shared else {}, **({} if shared else INTRINSICS))
    for path in (tmp_path, tmp_path / "transforms.json"):
        found = capture_format(path)
        assert found is not None
        assert found.name == "nerfstudio"
        a, b = open_capture(path)
        assert (a.name, b.name, a.sensor) == ("a", "b", "")
        np.testing.assert_allclose(a.camera.world_to_camera, look_at(EYES[1], TARGET, UP), atol=1e-12)
        np.testing.assert_allclose(b.camera.world_to_camera, look_at(EYES[0], TARGET, UP), atol=1e-12)
        assert (a.camera.fx, a.camera.fy, a.camera.cx, a.camera.cy) == (50, 51, 32, 24)
        assert a.image.shape == (48, 64, 3)
    capture = open_capture(tmp_path)
    assert not capture.is_metric
    np.testing.assert_allclose(capture.up, [0, 0, 1], atol=0.05)


@pytest.mark.parametrize(
    ("values", "lens"),
    [
        ({}, None),
        ({"camera_model": "PINHOLE", "k1": 0.0}, None),
        (
            {"camera_model": "OPENCV", "k1": 0.1, "k2": 0.2, "p1": 0.3, "p2": 0.4},
            Lens("opencv", (0.1, 0.2, 0.3, 0.4, 0.0)),
        ),
        ({"k1": 0.1, "k3": 0.5}, Lens("opencv", (0.1, 0.0, 0.0, 0.0, 0.5))),
        ({"camera_model": "OPENCV_FISHEYE", "k1": 0.1, "k4": 0.4}, Lens("fisheye", (0.1, 0.0, 0.0, 0.4))),
        ({"is_fisheye": True}, Lens("fisheye", (0.0, 0.0, 0.0, 0.0))),
    ],
)
def test_distortion_is_opencvs(tmp_path: Path, values: dict[str, Any], lens: Lens | None) -> None:
    assert open_capture(write(tmp_path, {**INTRINSICS, **values}))[0].lens == lens


@pytest.mark.parametrize(
    ("values", "told"),
    [
        ({"camera_model": "EQUIRECTANGULAR"}, "camera model EQUIRECTANGULAR, which OpenCV doesn't have"),
        ({"camera_model": "OPENCV", "k4": 0.1}, "fourth radial coefficient"),
        ({"k1": float("nan")}, "not finite"),
        ({"transform_matrix": np.zeros((4, 4)).tolist()}, "without scale or mirroring"),
        ({"transform_matrix": [[1, 2], [3, 4]]}, "12 or 16 numbers"),
        ({"fl_x": -5}, "fx, fy must be above 0"),
        ({"w": 64, "h": 64}, "which has other proportions"),
        ({"w": "wide"}, "invalid literal"),
    ],
)
def test_frames_that_can_not_be_used_are_named(tmp_path: Path, values: dict[str, Any], told: str) -> None:
    write(tmp_path, INTRINSICS)
    document = json.loads((tmp_path / "transforms.json").read_text())
    document["frames"][0].update(values)
    (tmp_path / "transforms.json").write_text(json.dumps(document))
    capture = open_capture(tmp_path)
    assert [view.name for view in capture] == ["a"]
    assert capture.problems[0].startswith("1 of 2 frames are left out: ")
    assert told in capture.problems[0]


def test_missing_focal_lengths_and_pictures_are_named(tmp_path: Path) -> None:
    write(tmp_path, {})
    with pytest.raises(CaptureError, match="none of its 2 frames can be used .*has no field 'fl_x'"):
        open_capture(tmp_path)
    write(tmp_path)
    (tmp_path / "images/a.png").unlink()
    assert "images/a.png: no such picture" in open_capture(tmp_path).problems[0]


def test_blenders_angle_and_names_without_suffix(tmp_path: Path) -> None:
    write(tmp_path, {"camera_angle_x": 2 * np.arctan(32 / 80)})
    text = (tmp_path / "transforms.json").read_text().replace(".png", "")
    (tmp_path / "transforms.json").unlink()
    (tmp_path / "transforms_train.json").write_text(text)
    view = open_capture(tmp_path)[0]
    assert view.camera.fx == view.camera.fy == pytest.approx(80)
    assert (view.camera.cx, view.camera.cy) == (32, 24)
    assert view.image.shape == (48, 64, 3)


def test_depth_and_masks(tmp_path: Path) -> None:
    write(tmp_path, INTRINSICS, depth_file_path="depth.png", mask_path="mask.png")
    stored = np.arange(48 * 64, dtype=np.uint16).reshape(48, 64) * 21
    Image.fromarray(stored).save(tmp_path / "depth.png")
    Image.fromarray(np.triu(np.full((48, 64), 255, np.uint8))).save(tmp_path / "mask.png")
    capture = open_capture(tmp_path)
    np.testing.assert_allclose(capture[0].depth, stored / 1000.0, rtol=1e-6)
    np.testing.assert_array_equal(capture[0].mask, np.triu(np.ones((48, 64))) > 0)
    assert capture.is_metric
    assert capture.has == {"depth", "mask"}
    write(tmp_path, {**INTRINSICS, "depth_unit_scale_factor": 0.5}, depth_file_path="depth.npy")
    floats = np.full((48, 64), 3.0, np.float32)
    floats[0, 0] = np.inf
    np.save(tmp_path / "depth.npy", floats)
    depth = open_capture(tmp_path)[0].depth
    assert depth is not None
    assert (depth[0, 0], depth[1, 1]) == (0.0, 1.5)


@pytest.mark.parametrize("kind", ["ascii", "binary_little_endian"])
def test_points_come_from_the_ply_file(tmp_path: Path, kind: str) -> None:
    write(tmp_path, {**INTRINSICS, "ply_file_path": "sparse_pc.ply"})
    rows = [(1.5, 2.0, -3.0, 10, 20, 30), (4.0, 5.0, 6.0, 255, 0, 1)]
    names = "".join(f"property float {axis}\n" for axis in "xyz") + "".join(
        f"property uchar {name}\n" for name in ("red", "green", "blue")
    )
    header = f"ply\nformat {kind} 1.0\nelement vertex 2\n{names}end_header\n"
    if kind == "ascii":
        body = "".join(" ".join(str(number) for number in row) + "\n" for row in rows).encode()
    else:
        body = np.array(rows, "<f4,<f4,<f4,u1,u1,u1").tobytes()
    (tmp_path / "sparse_pc.ply").write_bytes(header.encode() + body)
    capture = open_capture(tmp_path)
    np.testing.assert_array_equal(capture.points_m, np.array(rows)[:, :3])
    np.testing.assert_array_equal(capture.point_colors, np.array(rows)[:, 3:])
    (tmp_path / "sparse_pc.ply").write_bytes((header.encode() + body)[:-7])
    cut = open_capture(tmp_path)
    assert cut.points_m is None
    assert "The points are left out: " in cut.problems[0]
    assert "sparse_pc.ply" in cut.problems[0]


@pytest.mark.parametrize("text", ["", "[]", '{"frames": 3}', '{"frames": []}', '{"frames": [1]}', '{"frames": [{}]}'])
def test_other_json_is_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "transforms.json").write_text(text)
    with pytest.raises(CaptureError, match="transforms.json"):
        open_capture(tmp_path)


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write(tmp_path_factory.mktemp("nerfstudio"))


@given(cut=st.integers(0, 1200))
def test_cut_files_end_in_one_error(whole: Path, cut: int) -> None:
    file = whole / "transforms.json"
    before = file.read_text()
    try:
        file.write_text(before[: min(cut, len(before) - 1)])
        with pytest.raises(CaptureError, match="transforms.json"):
            open_capture(whole)
    finally:
        file.write_text(before)


@given(
    value=st.recursive(st.none() | st.booleans() | st.floats() | st.text(max_size=5), st.lists, max_leaves=6),
    key=st.sampled_from(["transform_matrix", "file_path", "fl_x", "k1", "camera_model", "depth_file_path"]),
)
def test_odd_values_cost_their_frame_at_most(whole: Path, value: object, key: str) -> None:
    file = whole / "transforms.json"
    before = file.read_text()
    try:
        document = json.loads(before)
        document["frames"][0][key] = value
        file.write_text(json.dumps(document))
        assert len(open_capture(whole)) >= 1  # the other frame can still be used
    finally:
        file.write_text(before)
