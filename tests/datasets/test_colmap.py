"""COLMAP models, binary and text: the real one, small ones by the specification, and damaged ones."""

import struct
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from colmap_files import POINTS, write_binary, write_pictures, write_text
from gsrain_engine.datasets.capture import Capture, CaptureError, Lens
from gsrain_engine.datasets.geometry import project_points
from gsrain_engine.datasets.open_capture import capture_format, open_capture


@pytest.fixture(scope="module")
def real(test_data: Path) -> Capture:
    return open_capture(test_data / "driving" / "nuscenes_rear_26")


def test_real_model_explains_where_its_points_were_seen(real: Capture, test_data: Path) -> None:
    folder = test_data / "driving" / "nuscenes_rear_26" / "colmap_derived" / "sparse" / "0"
    lines = [line for line in (folder / "points3D.txt").read_text().splitlines() if not line.startswith("#")]
    places = {int(line.split()[0]): [float(word) for word in line.split()[1:4]] for line in lines}
    rows = [line for line in (folder / "images.txt").read_text().splitlines() if not line.startswith("#")]
    views = {view.name: view for view in real}
    errors: list[float] = []
    for header, seen in zip(rows[::2], rows[1::2], strict=True):
        triples = np.array(seen.split(), float).reshape(-1, 3)
        triples = triples[triples[:, 2] >= 0]
        points = np.array([places[int(number)] for number in triples[:, 2]])
        pixels, depths = project_points(points, views[header.split()[9].removesuffix(".jpg")].camera)
        assert (depths > 0).all()
        errors += np.linalg.norm(pixels - triples[:, :2], axis=1).tolist()
    assert len(errors) > 9000
    # The model's own figure is 0.82 px; a center of pixels that is off by a half would add 0.7 px.
    assert np.mean(errors) == pytest.approx(0.82, abs=0.02)


def test_real_model_is_whole_and_knows_its_up(real: Capture) -> None:
    assert len(real) == 26
    assert real.problems == ()
    assert not real.is_metric
    assert real.points_m is not None
    assert real.point_colors is not None
    assert len(real.points_m) == len(real.point_colors) == 2759
    assert real[0].image.shape == (900, 1600, 3)
    # A plane through the points of the road (below the cameras) has this normal; the pictures' own up is 5 degrees off.
    road = np.array([0.006, -0.996, -0.084])
    assert np.degrees(np.arccos(np.array(real.up) @ road / np.linalg.norm(road))) < 1.0


@pytest.mark.parametrize("below", [".", "sparse", "sparse/0", "colmap/sparse/0", "colmap_derived/sparse/0"])
@pytest.mark.parametrize("write", [write_binary, write_text])
def test_every_layout_gives_the_same_capture(tmp_path: Path, below: str, write) -> None:
    write(tmp_path / below)
    write_pictures(tmp_path / "images")
    for path in (tmp_path, tmp_path / below):
        found = capture_format(path)
        assert found is not None
        assert found.name == "COLMAP"
        capture = open_capture(path)
        assert [view.name for view in capture] == ["a", "b"]
        np.testing.assert_array_equal(capture.points_m, np.array(POINTS)[:, :3])
        np.testing.assert_array_equal(capture.point_colors, np.array(POINTS)[:, 3:])
        camera = capture[1].camera
        assert (camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy) == (64, 48, 50, 51, 32, 24)
        # The quaternion (1 1 1 1)/2 turns x into y, y into z, z into x; the translation is added after.
        np.testing.assert_allclose(camera.world_to_camera[:3] @ [1.0, 0, 0, 1], [1, 3, 3], atol=1e-12)
        assert capture[0].image.shape == (48, 64, 3)


def test_pictures_may_lie_in_any_folder_of_the_capture(tmp_path: Path) -> None:
    write_text(tmp_path / "sparse" / "0")
    write_pictures(tmp_path / "drive" / "photos")
    assert open_capture(tmp_path)[0].image.shape == (48, 64, 3)


def test_where_pictures_belong_is_said(tmp_path: Path) -> None:
    write_text(tmp_path / "own" / "sparse" / "0")
    write_pictures(tmp_path / "photos")
    with pytest.raises(CaptureError, match=r"none of its 2 images lies in .*own \(a\.png, say\); put .*ln -s FOLDER"):
        open_capture(tmp_path / "own")


@pytest.mark.parametrize(
    ("model", "parameters", "lens"),
    [
        ("SIMPLE_PINHOLE", (50, 32, 24), None),
        ("SIMPLE_RADIAL", (50, 32, 24, 0.1), Lens("opencv", (0.1, 0, 0, 0))),
        ("SIMPLE_RADIAL", (50, 32, 24, 0.0), None),
        ("RADIAL", (50, 32, 24, 0.1, 0.2), Lens("opencv", (0.1, 0.2, 0, 0))),
        ("OPENCV", (50, 51, 32, 24, 0.1, 0.2, 0.3, 0.4), Lens("opencv", (0.1, 0.2, 0.3, 0.4))),
        (
            "FULL_OPENCV",
            (50, 51, 32, 24, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8),
            Lens("opencv", (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8)),
        ),
        ("OPENCV_FISHEYE", (50, 51, 32, 24, 0.1, 0.2, 0.3, 0.4), Lens("fisheye", (0.1, 0.2, 0.3, 0.4))),
        ("SIMPLE_RADIAL_FISHEYE", (50, 32, 24, 0.0), Lens("fisheye", (0.0, 0, 0, 0))),
        ("RADIAL_FISHEYE", (50, 32, 24, 0.1, 0.2), Lens("fisheye", (0.1, 0.2, 0, 0))),
    ],
)
def test_camera_models_are_opencvs(
    tmp_path: Path, model: str, parameters: tuple[float, ...], lens: Lens | None
) -> None:
    write_binary(tmp_path / "sparse" / "0", model=model, parameters=parameters)
    write_pictures(tmp_path / "images")
    view = open_capture(tmp_path)[0]
    assert view.lens == lens
    assert (view.camera.fx, view.camera.cx, view.camera.cy) == (50, 32, 24)
    assert view.camera.fy == (51 if len(parameters) > 7 else 50)


@pytest.mark.parametrize(("model", "count"), [("FOV", 5), ("THIN_PRISM_FISHEYE", 12)])
def test_other_camera_models_are_refused_by_name(tmp_path: Path, model: str, count: int) -> None:
    write_binary(tmp_path, model=model, parameters=(50.0, 50.0, 32.0, 24.0, *[0.1] * (count - 4)))
    write_pictures(tmp_path / "images")
    with pytest.raises(CaptureError, match=f"camera 7 has the model {model}, which OpenCV doesn't have"):
        open_capture(tmp_path)


def test_missing_and_broken_images_are_named_and_the_rest_is_used(tmp_path: Path) -> None:
    names = ("a.png", "b.png", "c.png", "d.png")
    write_binary(tmp_path / "sparse/0", names)
    write_pictures(tmp_path / "images", names)
    (tmp_path / "images/a.png").unlink()
    cut = (tmp_path / "images/b.png").read_bytes()
    (tmp_path / "images/b.png").write_bytes(cut[: len(cut) // 2])
    Image.new("RGB", (64, 64)).save(tmp_path / "images/c.png")
    capture = open_capture(tmp_path)
    assert [view.name for view in capture] == ["d"]
    (told,) = capture.problems
    assert told.startswith("3 of 4 images are left out: ")
    for part in (
        "a.png: no such picture",
        "b.png: the picture is cut off",
        "c.png: is 64x64 px, its camera says 64x48",
    ):
        assert part in told


def test_smaller_pictures_scale_their_camera(tmp_path: Path) -> None:
    write_binary(tmp_path / "sparse/0")
    write_pictures(tmp_path / "images", size=(32, 24))
    camera = open_capture(tmp_path)[0].camera
    assert (camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy) == (32, 24, 25, 25.5, 16, 12)


def test_folders_of_images_are_cameras_and_masks_come_along(tmp_path: Path) -> None:
    names = ("left/1.png", "right/1.png")
    write_text(tmp_path / "sparse/0", names)
    write_pictures(tmp_path / "images", names)
    (tmp_path / "masks/left").mkdir(parents=True)
    Image.fromarray(np.tril(np.full((48, 64), 255, np.uint8))).save(tmp_path / "masks/left/1.png.png")
    left, right = open_capture(tmp_path)
    assert (left.name, left.sensor, right.name, right.sensor) == ("left_1", "left", "right_1", "right")
    np.testing.assert_array_equal(left.mask, np.tri(48, 64) > 0)
    assert right.mask is None


def test_the_largest_of_several_models_is_read(tmp_path: Path) -> None:
    write_binary(tmp_path / "sparse/0", ("a.png",))
    write_binary(tmp_path / "sparse/1", ("a.png", "b.png"))
    write_pictures(tmp_path / "images")
    capture = open_capture(tmp_path)
    assert len(capture) == 2
    assert "unread: " in capture.problems[0]
    assert "sparse/0" in capture.problems[0]


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("colmap")
    write_binary(folder)
    write_pictures(folder / "images")
    return folder


@settings(max_examples=50)
@given(st.data())
def test_cut_binary_files_end_in_one_error(whole: Path, data: st.DataObject) -> None:
    name = data.draw(st.sampled_from(["cameras.bin", "images.bin", "points3D.bin"]))
    before = (whole / name).read_bytes()
    cut = data.draw(st.integers(0, len(before) - 1))
    try:
        (whole / name).write_bytes(before[:cut])
        with pytest.raises(CaptureError, match=name):
            open_capture(whole)
    finally:
        (whole / name).write_bytes(before)


@settings(max_examples=50)
@given(st.data())
def test_changed_bytes_never_raise_anything_else(whole: Path, data: st.DataObject) -> None:
    name = data.draw(st.sampled_from(["cameras.bin", "images.bin", "points3D.bin"]))
    before = (whole / name).read_bytes()
    at, value = data.draw(st.integers(0, len(before) - 1)), data.draw(st.integers(0, 255))
    try:
        (whole / name).write_bytes(before[:at] + bytes([value]) + before[at + 1 :])
        for view in open_capture(whole):
            assert np.isfinite(view.camera.world_to_camera).all()
    except CaptureError:
        pass
    finally:
        (whole / name).write_bytes(before)


@pytest.mark.parametrize("name", ["cameras.bin", "images.bin", "points3D.bin"])
def test_counts_that_the_file_can_not_hold_are_refused(tmp_path: Path, name: str) -> None:
    write_binary(tmp_path)
    write_pictures(tmp_path / "images")
    (tmp_path / name).write_bytes(struct.pack("<Q", 1 << 60) + (tmp_path / name).read_bytes()[8:])
    with pytest.raises(CaptureError, match=f"{name}: says 1152921504606846976 records"):
        open_capture(tmp_path)


@pytest.mark.parametrize(
    ("name", "text", "told"),
    [
        ("cameras.txt", "7 PINHOLE 64 forty 50 51 32 24", "cameras.txt, line 1: expected CAMERA_ID"),
        ("cameras.txt", "7 PINHOLE 64 48 50 51", "camera 7 has 2 parameters, PINHOLE has 4"),
        ("cameras.txt", "7 CURVED 64 48 50 51", "unknown model CURVED"),
        ("cameras.txt", "8 PINHOLE 64 48 50 51 32 24", "camera 7, which the model lacks"),
        ("images.txt", "1 1 0 0 0 0 0 0 7", "images.txt, line 1: expected IMAGE_ID"),
        ("images.txt", "1 0 0 0 0 0 0 0 7 a.png\n\n", "'a.png': .*not zero"),
        ("images.txt", "# nothing", "no registered image"),
        ("points3D.txt", "1 2 3", "points3D.txt, line 1: expected POINT3D_ID"),
        ("points3D.txt", "1 1 2 3 300 0 0 1", "within 0..255"),
        ("images.txt", "\udcff", "can't be read as text"),
    ],
)
def test_damaged_text_files_are_named(tmp_path: Path, name: str, text: str, told: str) -> None:
    write_text(tmp_path)
    write_pictures(tmp_path / "images")
    (tmp_path / name).write_bytes(text.encode("utf-8", errors="surrogateescape"))
    with pytest.raises(CaptureError, match=told):
        open_capture(tmp_path)
