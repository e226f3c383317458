"""Captures of still scenes: COLMAP, nerfstudio, our own folder, plain pictures, BDD-100K and RainSense."""

import json
import shutil
import struct
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from colmap_files import POINTS, SHIFTS, TWO, write_binary, write_pictures, write_text
from gsrain_engine.datasets.capture import Capture, CaptureError, CaptureFrame, OutsideError, readable_images
from gsrain_engine.datasets.capture_folder import write_views
from gsrain_engine.datasets.geometry import project_points
from gsrain_engine.datasets.image_override import sized_image
from gsrain_engine.datasets.open_capture import capture_format, open_capture
from gsrain_engine.scene.camera import Camera, look_at
from gsrain_engine.scene.lens import Lens

from .sample_captures import (
    EYES,
    INTRINSICS,
    TARGET,
    UP,
    opengl_pose,
    points_ply,
    views,
    write_bdd100k,
    write_nerfstudio,
)

# Captures and their views


def view_of(name: str, width: int = 8, **more: Any) -> CaptureFrame:
    camera = Camera(width, 6, 10.0, 10.0, 4.0, 3.0)
    return CaptureFrame(name, camera, **{"image_source": np.zeros((6, 8, 3), np.uint8), **more})


def test_pixels_are_read_when_they_are_asked_for_and_checked() -> None:
    read: list[str] = []

    def picture() -> np.ndarray:
        read.append("image")
        return np.zeros((6, 8, 3), np.uint8)

    view = view_of("a", image_source=picture)
    assert not read
    held = view.held()
    assert held.image is held.image and read == ["image"]
    with pytest.raises(CaptureError, match=r"view 'a': image is \(6, 8\)"):
        view_of("a", width=9).image.sum()
    depth = np.ones((6, 8), np.float32)
    both = Capture("two", (view_of("a", depth_source=depth), view_of("b", depth_source=depth, labels_source=depth)))
    assert both.has == {"depth"}


@pytest.mark.parametrize("name", ["../up", "/root", "a/../../b", "", "a\\..\\b"])
def test_impossible_names_and_lenses_are_refused(name: str) -> None:
    with pytest.raises(CaptureError, match="can't be the name of a view"):
        Capture("names", (view_of(name),))
    with pytest.raises(CaptureError, match="several views named 'a'"):
        Capture("two", (view_of("a"), view_of("a")))
    with pytest.raises(ValueError, match="not 3"):
        Lens("opencv", (0.1, 0.0, 0.0))


# Our own folder


@pytest.mark.parametrize("below", [".", "images"])
def test_views_that_are_written_come_back(tmp_path: Path, below: str) -> None:
    written = list(write_views(tmp_path / below, views()))
    found = capture_format(tmp_path)
    assert found is not None and found.name == "capture folder"
    capture = open_capture(tmp_path)
    assert capture.problems == () and capture.is_metric
    for before, after in zip(written, capture, strict=True):
        for name in ("name", "time_s", "sensor", "lens", "attributes"):
            assert getattr(before, name) == getattr(after, name)
        assert before.camera.to_json() == after.camera.to_json()
        assert before.camera.exposure_s == after.camera.exposure_s
        for name in ("image", "depth", "labels", "mask", "sky"):
            np.testing.assert_array_equal(getattr(before, name), getattr(after, name))
    np.testing.assert_allclose(capture[0].normals, written[0].normals, atol=5e-4)  # written as 16-bit floats
    assert capture[1].normals is None


@pytest.mark.parametrize(
    ("values", "field"),
    [
        ({"fx": 0}, "view 0 .front_0.: fx, fy"),
        ({"world_to_camera": [[1]]}, "world_to_camera has shape"),
        ({"name": 3}, "view 0: has no name"),
        ({"time_s": "late"}, "time_s"),
        ({"lens": {"model": "fisheye", "coefficients": [1.0]}}, "lens"),
        ({"lens": {"model": "cracked", "coefficients": [1.0] * 4}}, "'cracked'"),
        ({"attributes": []}, "attributes"),
    ],
)
def test_impossible_fields_of_our_own_folder_are_named(tmp_path: Path, values: dict[str, Any], field: str) -> None:
    list(write_views(tmp_path, views()))
    rows = json.loads((tmp_path / "cameras.json").read_text())
    rows[0].update(values)
    (tmp_path / "cameras.json").write_text(json.dumps(rows))
    with pytest.raises(CaptureError, match=rf"cameras\.json.*{field}"):
        open_capture(tmp_path)


@pytest.mark.parametrize("name", ["depth.npy", "normals.npy", "labels.png", "mask.png"])
def test_cut_pixels_are_found_when_they_are_read_and_missing_pictures_before(tmp_path: Path, name: str) -> None:
    list(write_views(tmp_path, views()))
    file = tmp_path / f"front_0.{name}"
    file.write_bytes(file.read_bytes()[:100])
    view = open_capture(tmp_path)[0]
    assert view.image.shape == (12, 16, 3)
    with pytest.raises(CaptureError, match=f"front_0.{name}"):
        getattr(view, name.partition(".")[0])
    (tmp_path / "front_0.png").unlink()
    capture = open_capture(tmp_path)
    assert [view.name for view in capture] == ["plain"] and "front_0.png: no such picture" in capture.problems[0]


# COLMAP


def test_a_real_model_explains_where_its_points_were(test_data: Path) -> None:
    real = open_capture(test_data / "driving" / "nuscenes_rear_26")
    assert (len(real), real.problems, real.is_metric, real[0].image.shape) == (26, (), False, (900, 1600, 3))
    assert real.points_m is not None and real.point_colors is not None
    assert len(real.points_m) == len(real.point_colors) == 2759
    # A plane through the points of the road (below the cameras) has this normal; the pictures' own up is 5 degrees off.
    road = np.array([0.006, -0.996, -0.084])
    assert np.degrees(np.arccos(np.array(real.up) @ road / np.linalg.norm(road))) < 1.0
    folder = test_data / "driving" / "nuscenes_rear_26" / "colmap_derived" / "sparse" / "0"
    lines = [line for line in (folder / "points3D.txt").read_text().splitlines() if not line.startswith("#")]
    places = {int(line.split()[0]): [float(word) for word in line.split()[1:4]] for line in lines}
    rows = [line for line in (folder / "images.txt").read_text().splitlines() if not line.startswith("#")]
    by_name = {view.name: view for view in real}
    errors: list[float] = []
    for header, observed in zip(rows[::2], rows[1::2], strict=True):
        triples = np.array(observed.split(), float).reshape(-1, 3)
        triples = triples[triples[:, 2] >= 0]
        points = np.array([places[int(number)] for number in triples[:, 2]])
        pixels, depths = project_points(points, by_name[header.split()[9].removesuffix(".jpg")].camera)
        assert (depths > 0).all()
        errors += np.linalg.norm(pixels - triples[:, :2], axis=1).tolist()
    assert len(errors) > 9000
    # The model's own figure is 0.82 px; a center of pixels that is off by a half would add 0.7 px.
    assert np.mean(errors) == pytest.approx(0.82, abs=0.02)


@pytest.mark.parametrize("below", [".", "sparse", "sparse/0", "colmap/sparse/0", "colmap_derived/sparse/0"])
@pytest.mark.parametrize("write", [write_binary, write_text])
def test_every_layout_of_colmap_gives_the_same_capture(tmp_path: Path, below: str, write: Any) -> None:
    write(tmp_path / below)
    write_pictures(tmp_path / "images")
    for path in (tmp_path, tmp_path / below):
        found = capture_format(path)
        assert found is not None and found.name == "COLMAP"
        capture = open_capture(path)
        assert [view.name for view in capture] == ["a", "b"]
        np.testing.assert_array_equal(capture.points_m, np.array(POINTS)[:, :3])
        np.testing.assert_array_equal(capture.point_colors, np.array(POINTS)[:, 3:])
        camera = capture[1].camera
        assert (camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy) == (64, 48, 50, 51, 32, 24)
        # The quaternion (1 1 1 1)/2 turns x into y, y into z, z into x; the translation is added after.
        np.testing.assert_allclose(camera.world_to_camera[:3] @ [1.0, 0, 0, 1], [1, 3, 3], atol=1e-12)
        assert capture[0].image.shape == (48, 64, 3)


_PLAIN, _FOUR = (50, 32, 24), (50, 51, 32, 24, 0.1, 0.2, 0.3, 0.4)


@pytest.mark.parametrize(
    ("model", "parameters", "lens"),
    [
        ("SIMPLE_PINHOLE", _PLAIN, None),
        ("SIMPLE_RADIAL", (*_PLAIN, 0.1), Lens("opencv", (0.1, 0, 0, 0))),
        ("SIMPLE_RADIAL", (*_PLAIN, 0.0), None),
        ("RADIAL", (*_PLAIN, 0.1, 0.2), Lens("opencv", (0.1, 0.2, 0, 0))),
        ("OPENCV", _FOUR, Lens("opencv", (0.1, 0.2, 0.3, 0.4))),
        ("FULL_OPENCV", (*_FOUR, 0.5, 0.6, 0.7, 0.8), Lens("opencv", (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8))),
        ("OPENCV_FISHEYE", _FOUR, Lens("fisheye", (0.1, 0.2, 0.3, 0.4))),
        ("SIMPLE_RADIAL_FISHEYE", (*_PLAIN, 0.0), Lens("fisheye", (0.0, 0, 0, 0))),
        ("RADIAL_FISHEYE", (*_PLAIN, 0.1, 0.2), Lens("fisheye", (0.1, 0.2, 0, 0))),
    ],
)
def test_camera_models_of_colmap_are_opencvs(
    tmp_path: Path, model: str, parameters: tuple[float, ...], lens: Lens | None
) -> None:
    write_binary(tmp_path / "sparse" / "0", model=model, parameters=parameters)
    write_pictures(tmp_path / "images")
    view = open_capture(tmp_path)[0]
    assert view.lens == lens
    assert (view.camera.fx, view.camera.cx, view.camera.cy) == (50, 32, 24)
    assert view.camera.fy == (51 if len(parameters) > 7 else 50)


def test_only_panoramas_are_not_for_the_undistorter_of_colmap(tmp_path: Path) -> None:
    write_pictures(tmp_path / "images")
    for model, numbers, advice in (("EQUIRECTANGULAR", "64 48", "panorama"), ("DIVISION", "50 50 32 24 0.1", "undist")):
        write_text(tmp_path / "sparse", camera=f"7 {model} 64 48 {numbers}")
        with pytest.raises(CaptureError, match=f"camera 7 has the model {model}.*{advice}") as error:
            open_capture(tmp_path)
        assert ("image_undistorter" in str(error.value)) == (model == "DIVISION")


@pytest.mark.parametrize("second", ["", "3 4 -1 5 6 -1", "1 2 3 4 5 6 7 8 9 10 11 12", None])
def test_one_line_an_image_is_read_like_two(tmp_path: Path, second: str | None) -> None:
    """Some programs leave out the line of observations, which others leave empty or fill with numbers."""
    names = ("a.png", "b 2.png", "c.png", "0004")
    write_pictures(tmp_path / "images", names[:3])
    Image.open(tmp_path / "images/a.png").save(tmp_path / "images/0004.png")
    write_text(tmp_path / "sparse", names)
    lines = [line for line in (tmp_path / "sparse/images.txt").read_text().splitlines() if " 7 " in line]
    lines = [each for line in lines for each in ((line,) if second is None else (line, second))]
    (tmp_path / "sparse/images.txt").write_text("\n".join(lines) + "\n")
    capture = open_capture(tmp_path)
    assert [view.name for view in capture] == ["0004", "a", "b 2", "c"] and capture.problems == ()
    np.testing.assert_allclose(capture[2].camera.world_to_camera[:3, 3], SHIFTS[1])


@pytest.mark.parametrize("write", [write_binary, write_text])
@pytest.mark.parametrize("kind", ["ply", "other"])
def test_points_of_another_format_than_the_images(tmp_path: Path, write: Any, kind: str) -> None:
    write(tmp_path / "sparse")
    write_pictures(tmp_path / "images")
    for file in (tmp_path / "sparse").glob("points3D.*"):
        file.unlink()
    if kind == "ply":
        (tmp_path / "sparse/points3D.ply").write_bytes(points_ply("binary_little_endian", list(POINTS)))
    else:
        other, suffix = (write_text, "txt") if write is write_binary else (write_binary, "bin")
        other(tmp_path / "other")
        (tmp_path / f"other/points3D.{suffix}").rename(tmp_path / f"sparse/points3D.{suffix}")
    capture = open_capture(tmp_path)
    np.testing.assert_array_equal(capture.points_m, np.array(POINTS)[:, :3])
    np.testing.assert_array_equal(capture.point_colors, np.array(POINTS)[:, 3:])


NAMES_OF_OTHERS = {
    "sub\\a.jpg": "sub/a.jpg",
    "sub/a.JPG": "sub/a.jpg",
    "sub/a.jpg": "sub/a.JPG",
    "sub/a.jpeg": "sub/a.png",
    "sub/a.1": "sub/a.1.png",
    r"C:\Users\me\scan\sub\a.PNG": "sub/a.png",
    "/home/me/scan/sub/a.png": "sub/a.png",
}
"""Names of pictures as other systems write them, and those on the disk."""


@pytest.mark.parametrize(("name", "on_disk"), NAMES_OF_OTHERS.items())
@pytest.mark.parametrize("kind", ["colmap", "nerfstudio"])
def test_pictures_are_found_by_names_of_other_systems(tmp_path: Path, kind: str, name: str, on_disk: str) -> None:
    folder = tmp_path / "images" if kind == "colmap" else tmp_path
    write_pictures(folder, (on_disk, on_disk.replace("a.", "b.")))
    names = (name, name.replace("a.", "b."))
    if kind == "colmap":
        write_text(tmp_path / "sparse", names)
        for file in (tmp_path / "sparse").iterdir():
            file.write_bytes(b"\xef\xbb\xbf" + file.read_bytes())  # a byte-order mark, as Windows' editors write it
    else:
        frames = [{"file_path": each, "transform_matrix": opengl_pose(EYES[0])} for each in names]
        (tmp_path / "transforms.json").write_text(json.dumps({**INTRINSICS, "frames": frames}), encoding="utf-8-sig")
    capture = open_capture(tmp_path)
    assert (len(capture), capture.problems) == (2, ())
    assert capture[0].image_file == folder / on_disk and capture[0].image.shape == (48, 64, 3)


@pytest.mark.parametrize("name", ["..\\..\\outside.png", "sub\\..\\..\\..\\outside.png"])
def test_names_of_other_systems_do_not_lead_outside(tmp_path: Path, name: str) -> None:
    write_pictures(tmp_path, ("outside.png",))
    write_pictures(tmp_path / "in/images", ("a.png",))
    (tmp_path / "in/images/sub").mkdir()
    write_text(tmp_path / "in/sparse", ("a.png", name))
    with pytest.raises(OutsideError, match="leads out of"):
        open_capture(tmp_path / "in")


@pytest.mark.parametrize("kind", ["colmap", "nerfstudio", "override"])
def test_pictures_that_are_turned_by_exif_are_turned_for_upright_cameras_only(tmp_path: Path, kind: str) -> None:
    pixels = np.zeros((48, 64, 3), np.uint8)
    pixels[:24] = 200, 30, 30  # the upper half as the sensor has it; turned by 90 degrees clockwise, the right half
    exif = Image.Exif()
    exif[0x0112] = 6
    (tmp_path / "images").mkdir()
    for name in ("a.jpg", "b.jpg"):
        Image.fromarray(pixels).save(tmp_path / "images" / name, exif=exif, quality=95)
    images = {}
    for side, (width, height) in {"upright": (48, 64), "sensor": (64, 48)}.items():
        if kind == "override":
            images[side] = sized_image(tmp_path / "images/a.jpg", (width, height))
            continue
        if kind == "colmap":
            write_text(tmp_path / "sparse", ("a.jpg", "b.jpg"), f"7 PINHOLE {width} {height} 50 51 32 24")
        else:
            frames = [{"file_path": f"images/{each}.jpg", "transform_matrix": opengl_pose(EYES[0])} for each in "ab"]
            text = json.dumps({**INTRINSICS, "w": width, "h": height, "frames": frames})
            (tmp_path / "transforms.json").write_text(text)
        images[side] = open_capture(tmp_path)[0].image
    red = {side: image[..., 0] > 100 for side, image in images.items()}
    assert red["upright"].shape == (64, 48) and red["upright"][:, 26:].all() and not red["upright"][:, :22].any()
    assert red["sensor"].shape == (48, 64) and red["sensor"][:22].all() and not red["sensor"][26:].any()


@pytest.mark.parametrize("radial", [(0.08, -0.12, 0.05, 0.03), (-0.2, 0.05, 0.01, -0.004), (0, 0, 0, 0.02)])
def test_a_fourth_radial_coefficient_bends_as_it_says(tmp_path: Path, radial: tuple[float, ...]) -> None:
    numbers = dict(zip(("k1", "k2", "k3", "k4", "p1", "p2"), (*radial, 1e-3, -2e-3), strict=True))
    write_nerfstudio(tmp_path, {**INTRINSICS, "camera_model": "OPENCV", **numbers})
    view = open_capture(tmp_path)[0]
    places = np.stack(np.meshgrid(np.linspace(-0.6, 0.6, 9), np.linspace(-0.4, 0.4, 9)), axis=-1).reshape(-1, 2)
    local = np.column_stack([places, np.ones(len(places))])
    pose = view.camera.world_to_camera
    pixels, _ = project_points((local - pose[:3, 3]) @ pose[:3, :3], view.camera, view.lens)
    x, y = places.T
    r2 = x * x + y * y
    factor = 1 + r2 * (radial[0] + r2 * (radial[1] + r2 * (radial[2] + r2 * radial[3])))
    u = x * factor + 2 * 1e-3 * x * y - 2e-3 * (r2 + 2 * x * x)
    v = y * factor + 1e-3 * (r2 + 2 * y * y) - 2 * 2e-3 * x * y
    np.testing.assert_allclose(pixels, np.stack([50 * u + 32, 51 * v + 24], axis=1), atol=0.01)


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
    (problem,) = capture.problems
    assert problem.startswith("3 of 4 images are left out: ")
    assert all(part in problem for part in ("a.png: no such", "b.png: the picture is cut", "c.png: is 64x64 px"))
    with pytest.raises(CaptureError, match=r"none of its 1 images lies in .*own \(a\.png, say\); put .*ln -s FOLDER"):
        write_text(tmp_path / "own" / "sparse" / "0", ("a.png",))
        open_capture(tmp_path / "own")


def test_smaller_pictures_in_any_folder_scale_their_camera(tmp_path: Path) -> None:
    write_binary(tmp_path / "sparse/0")
    write_pictures(tmp_path / "drive" / "photos", size=(32, 24))
    camera = open_capture(tmp_path)[0].camera
    assert (camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy) == (32, 24, 25, 25.5, 16, 12)


def test_folders_of_images_are_cameras_with_masks_and_the_largest_model_is_read(tmp_path: Path) -> None:
    names = ("left/1.png", "right/1.png")
    write_binary(tmp_path / "sparse/0", names[:1])
    write_binary(tmp_path / "sparse/1", names)
    write_pictures(tmp_path / "images", names)
    (tmp_path / "masks/left").mkdir(parents=True)
    Image.fromarray(np.tril(np.full((48, 64), 255, np.uint8))).save(tmp_path / "masks/left/1.png.png")
    capture = open_capture(tmp_path)
    assert "unread: " in capture.problems[0] and "sparse/0" in capture.problems[0]
    left, right = capture
    assert (left.name, left.sensor, right.name, right.sensor) == ("left_1", "left", "right_1", "right")
    np.testing.assert_array_equal(left.mask, np.tri(48, 64) > 0)
    assert right.mask is None


def test_the_model_of_undistorted_pictures_is_not_mixed_with_the_one_before(tmp_path: Path) -> None:
    """COLMAP's dense folder has cropped pictures and a model of their own; the pictures before are often not there."""
    write_text(tmp_path / "sparse/0", ("a.png", "b.png", "c.png"), "7 OPENCV 66 50 50 51 33 25 0.1 0 0 0")
    write_text(tmp_path / "dense/0/sparse", TWO, "7 PINHOLE 64 48 50 51 32 24")
    write_pictures(tmp_path / "dense/0/images")
    capture = open_capture(tmp_path)
    assert [(view.name, view.lens, view.camera.width) for view in capture] == [("a", None, 64), ("b", None, 64)]
    assert "dense/0/sparse is read" in capture.problems[0]
    write_pictures(tmp_path / "images", ("a.png", "b.png", "c.png"), (66, 50))
    assert [view.camera.width for view in open_capture(tmp_path)] == [66, 66, 66]


@pytest.mark.parametrize(
    ("file", "text", "field"),
    [
        *((f"{name}.bin", None, f"{name}.bin: says 1152921504606846976") for name in ("cameras", "images", "points3D")),
        ("cameras.txt", "7 PINHOLE 64 forty 50 51 32 24", "cameras.txt, line 1: expected CAMERA_ID"),
        ("cameras.txt", "7 PINHOLE 64 48 50 51", "camera 7 has 2 parameters, PINHOLE has 4"),
        ("cameras.txt", "7 CURVED 64 48 50 51", "unknown model CURVED"),
        ("cameras.txt", "7 THIN_PRISM_FISHEYE 64 48 50 50 32 24" + 8 * " 0.1", "the model THIN_PRISM_FISHEYE"),
        ("cameras.txt", "8 PINHOLE 64 48 50 51 32 24", "camera 7, which the model lacks"),
        ("images.txt", "1 1 0 0 0 0 0 0 7", "images.txt, line 1: expected IMAGE_ID"),
        ("images.txt", "1 0 0 0 0 0 0 0 7 a.png\n\n", "'a.png': .*not zero"),
        ("points3D.txt", "1 2 3", "points3D.txt, line 1: expected POINT3D_ID"),
        ("points3D.txt", "1 1 2 3 300 0 0 1", "within 0..255"),
        ("images.txt", "\udcff", "can't be read as text"),
    ],
)
def test_damaged_files_of_colmap_are_named(tmp_path: Path, file: str, text: str | None, field: str) -> None:
    write_pictures(tmp_path / "images")
    if text is None:
        write_binary(tmp_path / "sparse")
        path = tmp_path / "sparse" / file
        path.write_bytes(struct.pack("<Q", 1 << 60) + path.read_bytes()[8:])
    else:
        write_text(tmp_path / "sparse")
        (tmp_path / "sparse" / file).write_bytes(text.encode("utf-8", errors="surrogateescape"))
    with pytest.raises(CaptureError, match=field):
        open_capture(tmp_path)


# nerfstudio


@pytest.mark.parametrize("shared", [True, False])
def test_poses_turn_from_opengl_to_opencv(tmp_path: Path, shared: bool) -> None:
    write_nerfstudio(tmp_path, INTRINSICS if shared else {}, **({} if shared else INTRINSICS))
    for path in (tmp_path, tmp_path / "transforms.json"):
        found = capture_format(path)
        assert found is not None and found.name == "nerfstudio"
        capture = open_capture(path)
        for view, name, eye in zip(capture, "ab", EYES[::-1], strict=True):
            assert (view.name, view.sensor, view.image.shape) == (name, "", (48, 64, 3))
            expected = Camera(64, 48, 50.0, 51.0, 32.0, 24.0, look_at(eye, TARGET, UP))
            np.testing.assert_allclose(view.camera.world_to_camera, expected.world_to_camera, atol=1e-12)
            assert replace(view.camera, world_to_camera=expected.world_to_camera).to_json() == expected.to_json()
        assert not capture.is_metric
        np.testing.assert_allclose(capture.up, [0, 0, 1], atol=0.05)


_OPENCV = {"camera_model": "OPENCV", "k1": 0.1, "k2": 0.2, "p1": 0.3, "p2": 0.4}


@pytest.mark.parametrize(
    ("values", "lens"),
    [
        ({}, None),
        ({"camera_model": "PINHOLE", "k1": 0.0}, None),
        (_OPENCV, Lens("opencv", (0.1, 0.2, 0.3, 0.4, 0.0))),
        ({"k1": 0.1, "k3": 0.5}, Lens("opencv", (0.1, 0.0, 0.0, 0.0, 0.5))),
        ({"camera_model": "OPENCV_FISHEYE", "k1": 0.1, "k4": 0.4}, Lens("fisheye", (0.1, 0.0, 0.0, 0.4))),
        ({"is_fisheye": True}, Lens("fisheye", (0.0, 0.0, 0.0, 0.0))),
    ],
)
def test_distortion_of_nerfstudio_is_opencvs(tmp_path: Path, values: dict[str, Any], lens: Lens | None) -> None:
    assert open_capture(write_nerfstudio(tmp_path, {**INTRINSICS, **values}))[0].lens == lens


@pytest.mark.parametrize(
    ("values", "field"),
    [
        ({"camera_model": "EQUIRECTANGULAR"}, "panoramas"),
        ({"camera_model": "OPENCV", "k4": -9}, "(k1 to k4) that folds back"),
        ({"k1": float("nan")}, "not finite"),
        ({"transform_matrix": np.zeros((4, 4)).tolist()}, "without scale or mirroring"),
        ({"transform_matrix": [[1, 2], [3, 4]]}, "12 or 16 numbers"),
        ({"fl_x": -5}, "fx, fy"),
        ({"w": 64, "h": 64}, "other proportions"),
        ({"w": "wide"}, "'wide'"),
    ],
)
def test_frames_that_can_not_be_used_are_named(tmp_path: Path, values: dict[str, Any], field: str) -> None:
    write_nerfstudio(tmp_path, INTRINSICS)
    document = json.loads((tmp_path / "transforms.json").read_text())
    document["frames"][0].update(values)
    (tmp_path / "transforms.json").write_text(json.dumps(document))
    capture = open_capture(tmp_path)
    assert [view.name for view in capture] == ["a"]
    assert capture.problems[0].startswith("1 of 2 frames are left out: ") and field in capture.problems[0]


def test_blenders_angle_and_names_without_suffix(tmp_path: Path) -> None:
    write_nerfstudio(tmp_path, {})
    with pytest.raises(CaptureError, match="'fl_x'"):
        open_capture(tmp_path)
    write_nerfstudio(tmp_path, {"camera_angle_x": 2 * np.arctan(32 / 80), "camera_angle_y": 2 * np.arctan(24 / 70)})
    text = (tmp_path / "transforms.json").read_text().replace(".png", "")
    (tmp_path / "transforms.json").unlink()
    (tmp_path / "transforms_train.json").write_text(text)
    camera = open_capture(tmp_path)[0].camera
    assert (camera.fx, camera.fy, camera.cx, camera.cy) == pytest.approx((80, 70, 32, 24))


def test_depth_and_masks_of_nerfstudio(tmp_path: Path) -> None:
    write_nerfstudio(tmp_path, INTRINSICS, depth_file_path="depth.png", mask_path="mask.png")
    stored = np.arange(48 * 64, dtype=np.uint16).reshape(48, 64) * 21
    Image.fromarray(stored).save(tmp_path / "depth.png")
    Image.fromarray(np.triu(np.full((48, 64), 255, np.uint8))).save(tmp_path / "mask.png")
    capture = open_capture(tmp_path)
    np.testing.assert_allclose(capture[0].depth, stored / 1000.0, rtol=1e-6)
    np.testing.assert_array_equal(capture[0].mask, np.triu(np.ones((48, 64))) > 0)
    assert capture.is_metric and capture.has == {"depth", "mask"}
    write_nerfstudio(tmp_path, {**INTRINSICS, "depth_unit_scale_factor": 0.5}, depth_file_path="depth.npy")
    floats = np.full((48, 64), 3.0, np.float32)
    floats[0, 0] = np.inf
    np.save(tmp_path / "depth.npy", floats)
    depth = open_capture(tmp_path)[0].depth
    assert depth is not None and (depth[0, 0], depth[1, 1]) == (0.0, 1.5)


@pytest.mark.parametrize("kind", ["ascii", "binary_little_endian"])
def test_points_of_nerfstudio_come_from_the_ply_file(tmp_path: Path, kind: str) -> None:
    write_nerfstudio(tmp_path, {**INTRINSICS, "ply_file_path": "sparse_pc.ply"})
    rows = [(1.5, 2.0, -3.0, 10, 20, 30), (4.0, 5.0, 6.0, 255, 0, 1)]
    (tmp_path / "sparse_pc.ply").write_bytes(points_ply(kind, rows))
    capture = open_capture(tmp_path)
    np.testing.assert_array_equal(capture.points_m, np.array(rows)[:, :3])
    np.testing.assert_array_equal(capture.point_colors, np.array(rows)[:, 3:])
    (tmp_path / "sparse_pc.ply").write_bytes(points_ply(kind, rows)[:-7])
    cut = open_capture(tmp_path)
    assert cut.points_m is None and "sparse_pc.ply" in cut.problems[0]


# Plain pictures


def test_a_plain_folder_is_for_transfer(tmp_path: Path) -> None:
    write_pictures(tmp_path, ("one.png", "two.jpg", "two.png"))
    (tmp_path / "notes.txt").write_text("no picture")
    capture = open_capture(tmp_path)
    assert [view.name for view in capture] == ["one", "two.jpg", "two.png"]
    assert not capture.has_poses and not capture.is_metric and "run COLMAP" in capture.problems[0]
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
    assert (view.camera.width, view.camera.height, view.image.shape) == (48, 64, (64, 48, 3))
    np.testing.assert_allclose(view.image[:, -5].mean(axis=0), [255, 0, 0], atol=12)


def test_broken_pictures_are_named_some_only_when_they_are_decoded(tmp_path: Path) -> None:
    write_pictures(tmp_path, ("a.png", "b.png", "c.jpg"))
    whole = (tmp_path / "a.png").read_bytes()
    (tmp_path / "a.png").write_bytes(whole[:200] + bytes(len(whole) - 300) + whole[-100:])  # its end is still there
    (tmp_path / "c.jpg").write_bytes((tmp_path / "c.jpg").read_bytes()[:-200])
    capture = open_capture(tmp_path)
    assert [view.name for view in capture] == ["a", "b"] and "c.jpg: the picture is cut off" in capture.problems[1]
    done: list[float] = []
    usable = readable_images(capture, done.append)
    assert [view.name for view in usable] == ["b"] and "View a is left out: " in usable.problems[-1]
    assert done == [0.5, 1.0] and readable_images(usable) is usable
    for name in ("a.png", "b.png"):
        (tmp_path / name).write_bytes(b"")
    with pytest.raises(CaptureError, match="no picture in it can be read"):
        open_capture(tmp_path)


# BDD-100K and RainSense


def test_frames_of_bdd100k_have_the_attributes_of_their_labels(tmp_path: Path, test_data: Path) -> None:
    real = open_capture(test_data / "weather" / "bdd100k")
    assert (len(real), real[0].image.shape, real.has_poses) == (6, (720, 1280, 3), False)
    write_bdd100k(tmp_path)
    file = tmp_path / "labels/det_train.json"
    row = json.loads(file.read_text())[0]
    (tmp_path / "labels/broken.json").write_text("[{")
    for layout in ("list", "one each"):
        if layout == "one each":
            file.write_text(json.dumps({**row, "name": row["name"][:-4]}))
        for path in (tmp_path, tmp_path / "images/100k/train"):
            capture = open_capture(path)
            assert getattr(capture_format(path), "name", "") == "BDD-100K"
            assert capture[0].attributes == row["attributes"] and len(capture) == 2
            assert any("1 label files" in each and "broken.json" in each for each in capture.problems)


def test_other_pictures_among_those_of_bdd100k_are_named_and_few_of_its_make_none(tmp_path: Path) -> None:
    frames = tuple(f"0000f77c-6257be5{k}.jpg" for k in range(4))
    write_pictures(tmp_path / "a", (*frames, "holiday.jpg", "cat.png"))
    capture = open_capture(tmp_path / "a")
    assert len(capture) == 4 and any("2 of 6 pictures" in each and "cat.png" in each for each in capture.problems)
    write_pictures(tmp_path / "b", (frames[0], "a.jpg", "b.jpg", "c.jpg"))
    assert getattr(capture_format(tmp_path / "b"), "name", "") == "image folder"


def test_a_real_sequence_of_rainsense_has_lidar_and_boxes(test_data: Path) -> None:
    folder = test_data / "weather" / "rainsense" / "clear" / "scene_0" / "case_000"
    capture = open_capture(folder)
    (view,) = capture
    assert view.attributes == {"rain_mm_h": "0"} and view.lens is not None
    assert view.image.shape == (view.camera.height, view.camera.width, 3)
    assert len(capture.sweeps[0].points_m) == 17700
    assert "holds no exact rotation (it stretches by 2.5%)" in capture.problems[0]
    # What the lidar measures close by is the road below the camera, which stands 1.5 m above it (as assumed).
    near = capture.sweeps[0].points_m[capture.sweeps[0].points_m[:, 0] < 12]
    assert abs(np.median(near[:, 2])) < 0.35
    (person,) = capture.boxes
    pose = person.track.pose(view.time_s)
    assert person.class_name == "Pedestrian" and pose is not None
    # The label's own 2D box must hold the projected middle of the thing.
    left, top, right, bottom = (float(word) for word in (folder / "label/label_000.txt").read_text().split()[4:8])
    middle = pose[:3, 3] + pose[:3, 2] * person.size_lwh[2] / 2
    (pixel,), _ = project_points(middle[None], view.camera, view.lens)
    assert left < pixel[0] < right and top < pixel[1] < bottom


def test_damaged_files_of_rainsense_are_named_one_after_the_other(test_data: Path, tmp_path: Path) -> None:
    whole = open_capture(test_data / "weather" / "rainsense")
    assert [view.attributes["rain_mm_h"] for view in whole] == ["0", "1.376", "2.654", "4.75", "9.245", "9.245"]
    assert (len(whole.sensors), whole.has_poses, whole.sweeps) == (5, False, ())
    folder = tmp_path / "case"
    shutil.copytree(test_data / "weather" / "rainsense" / "clear" / "scene_0" / "case_000", folder)
    for file, text, problem in (
        ("lidar/frame_000.csv", "X,Y,Z,Reflectivity\n1,2,3\n", "frame_000.csv: no table"),
        ("context/calib_lid_to_cam.txt", "Tr: 1 2 3\n", "calib_lid_to_cam.txt"),
        ("label/label_000.txt", "Pedestrian 1 2\n", "line 1 has 3 words"),
    ):
        (folder / file).write_text(text)
        capture = open_capture(folder)
        assert capture.sweeps == () and any(problem in each for each in capture.problems)
    (folder / "context" / "camera_intrinsics.txt").write_text("K: 1\n")
    with pytest.raises(CaptureError, match=r"camera_intrinsics.txt: 1 numbers, expected 14"):
        open_capture(folder)
