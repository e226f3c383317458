"""Rows of the table: captures of every kind, with the pixels that their views read later."""

import json
import shutil
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from colmap_files import write_binary, write_pictures, write_text
from gsrain_engine.datasets.capture import Capture, CaptureError, CaptureFrame
from gsrain_engine.datasets.capture_folder import write_views, write_world
from gsrain_engine.datasets.open_capture import capture_format, open_capture
from gsrain_engine.datasets.summary import summarized
from gsrain_engine.scene.camera import Camera
from mini_drive import MiniDrive
from tests.datasets.sample_captures import points_ply, write_bdd100k, write_odd_pictures, write_rainsense
from tests.datasets.sample_drives import (
    drive_on_the_road,
    segment_tables,
    write_argoverse2,
    write_dgp,
    write_frames,
    write_infos,
    write_kitti,
    write_kitti360,
    write_kitti_infos,
    write_kitti_objects,
    write_nuscenes,
    write_segment,
    write_sequence,
)
from tfrecord_framing import framed

from .mutations import Damage, damaged_bytes, damaged_header, damaged_json, damaged_text, inside_records, inside_zip
from .reader import Reader
from .scene_readers import assert_camera, assert_track

_SMALL = MiniDrive(samples=2)
_PICTURES: tuple[tuple[str, Damage], ...] = (
    ("*.jpg", damaged_bytes), ("*.png", damaged_bytes), ("*.webp", damaged_bytes), ("*.tif", damaged_bytes),
    ("*.bmp", damaged_bytes),
)  # fmt: skip


def _read(path: Path) -> None:
    """Open a capture, check what it says, and look at all its pixels."""
    capture = open_capture(path)
    assert len(capture) > 0, "has no views"
    assert all(isinstance(problem, str) and len(problem) < 5000 for problem in capture.problems), "has long problems"
    assert len(capture.problems) < 200, f"tells {len(capture.problems)} problems"
    _check_world(capture)
    for view in capture:
        assert_camera(view.camera)
        assert np.isfinite(view.time_s), "has a view at no time"
        _check_pixels(view)
    summarized(capture)


def _check_world(capture: Capture) -> None:
    assert np.isfinite(capture.up).all() and np.linalg.norm(capture.up) > 1e-9, "has no up"
    if capture.points_m is not None:
        assert np.isfinite(capture.points_m).all(), "has points that are not finite"
        assert capture.point_colors is None or len(capture.point_colors) == len(capture.points_m)
    for sweep in capture.sweeps:
        assert np.isfinite(sweep.points_m).all() and np.isfinite(sweep.time_s), "has a sweep that is not finite"
        assert sweep.intensities is None or len(sweep.intensities) == len(sweep.points_m)
    for box in capture.boxes:
        assert np.isfinite(box.size_lwh).all() and min(box.size_lwh) > 0, "has a box of no size"
        assert_track(box.track)
    if capture.ego is not None:
        assert_track(capture.ego)


def _check_pixels(view: CaptureFrame) -> None:
    for name in ("image", "depth", "normals", "labels", "mask", "sky"):
        try:
            pixels = getattr(view, name)
        except CaptureError as error:
            assert error.__cause__ is None, f"lets out {type(error.__cause__).__name__} with its {name}"
        else:
            kinds = {"image": np.uint8, "labels": np.uint8, "mask": np.bool_, "sky": np.bool_}
            assert pixels is None or pixels.dtype == kinds.get(name, np.float32), f"has {pixels.dtype} as {name}"
            assert name not in ("depth", "normals") or pixels is None or np.isfinite(pixels).all(), f"endless {name}"


def _capture_folder(folder: Path) -> None:
    pixels = np.random.default_rng(4).integers(0, 256, (48, 64, 3), np.uint8)
    camera = Camera.from_fov(64, 48, 50.0, np.eye(4))
    depth, flags = np.linspace(1, 9, 48 * 64, dtype=np.float32).reshape(48, 64), pixels[..., 0] > 99
    rest = {"depth_source": depth, "normals_source": (pixels / 255).astype(np.float32), "labels_source": pixels[..., 1]}
    view = CaptureFrame(
        "a", camera, pixels, 0.5, "LEFT", mask_source=flags, sky_source=~flags, attributes={"rain": "2"}, **rest
    )
    for _ in write_views(folder, [view, CaptureFrame("b", camera, pixels)]):
        pass
    write_world(folder, (0.0, -1.0, 0.1), is_metric=False)


def _colmap(write: Callable[[Path], None], folder: Path) -> None:
    write(folder / "sparse/0")
    write_pictures(folder / "images")


def _nerfstudio(kind: str, folder: Path) -> None:
    write_pictures(folder / "images", ("a.png", "b.png", "c.png"))
    np.save(folder / "depth.npy", np.full((48, 64), 2.5, np.float32))
    Image.fromarray(np.full((48, 64), 2500, np.uint16)).save(folder / "depth.png")
    Image.fromarray(np.full((48, 64), 255, np.uint8)).save(folder / "mask.png")
    (folder / "points.ply").write_bytes(points_ply(kind, [(float(k), 2.5, -1.0, 10, 20, 30) for k in range(4)]))
    frames = []
    for k, name in enumerate("abc"):
        pose = np.eye(4)
        pose[:3, 3] = [k, 1, 2]
        frames.append({"file_path": f"images/{name}.png", "transform_matrix": pose.tolist()})
    frames[0] |= {"depth_file_path": "depth.npy", "mask_path": "mask.png"}
    frames[1] |= {"depth_file_path": "depth.png", "depth_unit_scale_factor": 0.001}
    once = {"fl_x": 50.0, "fl_y": 51.0, "cx": 32.0, "cy": 24.0, "w": 64, "h": 48, "k1": 0.1, "camera_model": "OPENCV"}
    (folder / "transforms.json").write_text(json.dumps({**once, "ply_file_path": "points.ply", "frames": frames}))


def _row(name: str, kind: str, write: Callable[[Path], Any], *damage: tuple[str, Damage]) -> Reader:
    def written(folder: Path) -> Path:
        write(folder)
        found = capture_format(folder)
        assert found is not None and found.name == kind, f"{name}: taken for {found}"
        return folder

    return Reader(name, written, _read, CaptureError, (*damage, *_PICTURES))


_JSON, _TEXT, _BYTES = ("*.json", damaged_json), ("*.txt", damaged_text), ("*.bin", damaged_bytes)
_NPY, _PKL = ("*.npy", damaged_bytes), ("*.pkl", damaged_bytes)
_PLY = ("*.ply", damaged_header(b"end_header\n"))
_NPZ = ("*.npz", inside_zip(lambda _: damaged_bytes))

_INFOS = "MMDetection3D"
_BAG = "ROS 2 bag (MCAP, SQLite)"


def _lz4(folder: Path) -> Path:
    from tests.datasets.sample_bags import write_foxglove

    return write_foxglove(folder / "drive.mcap", _SMALL, compression="LZ4")


def _argoverse2(folder: Path) -> Path:
    return write_argoverse2(folder, _SMALL)


def _bag(storage: str, folder: Path) -> None:
    from tests.datasets.sample_bags import drive_messages, write_bag

    shutil.move(write_bag(folder / "bag", drive_messages(_SMALL), storage), folder / "moved")
    for file in (folder / "moved").iterdir():
        shutil.move(file, folder / file.name)
    (folder / "moved").rmdir()


def _waymo_infos(folder: Path) -> Path:
    return write_infos(folder, _SMALL, "waymo")


_XML, _RECORD = ("*.xml", damaged_text), ("*.tfrecord", inside_records(framed))

CAPTURE_READERS = (
    _row("capture-folder", "capture folder", _capture_folder, _JSON, _NPY),
    _row("colmap-binary", "COLMAP", partial(_colmap, write_binary), _BYTES),
    _row("colmap-text", "COLMAP", partial(_colmap, write_text), _TEXT),
    _row("nerfstudio", "nerfstudio", partial(_nerfstudio, "ascii"), _JSON, _NPY, _PLY),
    _row("nerfstudio-binary", "nerfstudio", partial(_nerfstudio, "binary_little_endian"), _JSON, _NPY, _PLY),
    _row("dgp", "DGP", lambda folder: write_dgp(folder, _SMALL), _JSON, _NPZ),
    _row("nuscenes", "nuScenes", lambda folder: write_nuscenes(folder, _SMALL), _JSON, _BYTES),
    _row("nuscenes-infos", _INFOS, lambda folder: write_infos(folder, _SMALL, "1.x"), _PKL, _BYTES),
    _row("nuscenes-infos-old", _INFOS, lambda folder: write_infos(folder, _SMALL, "0.x"), _PKL, _BYTES),
    _row("kitti-raw", "KITTI raw", lambda folder: write_kitti(folder, drive_on_the_road()), _TEXT, _BYTES, _XML),
    _row("kitti-objects", "KITTI object detection", write_kitti_objects, _TEXT, _BYTES),
    Reader("waymo-infos", _waymo_infos, _read, CaptureError, (_PKL, _BYTES, *_PICTURES)),
    Reader("kitti-infos", write_kitti_infos, _read, CaptureError, (_PKL, _BYTES, *_PICTURES)),
    _row("kitti-360", "KITTI-360", lambda folder: write_kitti360(folder, _SMALL), _TEXT, _BYTES, _XML),
    _row("kitti-odometry", "KITTI odometry", write_sequence, _TEXT, _BYTES),
    Reader("argoverse2", _argoverse2, _read, CaptureError, (("*.feather", damaged_bytes), *_PICTURES)),
    _row("waymo-records", "Waymo Perception v1", lambda folder: write_frames(folder / "a.tfrecord", _SMALL), _RECORD),
    _row(
        "waymo-tables",
        "Waymo Perception v2",
        lambda folder: write_segment(folder, segment_tables(_SMALL)),
        ("*.parquet", damaged_bytes),
    ),
    Reader("mcap-lz4", _lz4, _read, CaptureError, (("*.mcap", damaged_bytes),)),
    _row("bag-mcap", _BAG, partial(_bag, "mcap"), ("*.mcap", damaged_bytes), ("*.yaml", damaged_text)),
    _row("bag-sqlite", _BAG, partial(_bag, "sqlite3"), ("*.db3", damaged_bytes)),
    _row("rainsense", "RainSense", write_rainsense, _TEXT, ("*.csv", damaged_text)),
    _row("bdd100k", "BDD-100K", write_bdd100k, _JSON),
    _row("pictures", "image folder", write_odd_pictures),
)
"""Captures, and what looks at them and at their pixels."""
