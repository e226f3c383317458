"""Rows of the table: captures of every kind, with the pixels that their views read later."""

import json
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
from mini_drive import FOCAL, HEIGHT, WIDTH, MiniDrive
from tests.datasets.test_dgp import write_dgp
from tests.datasets.test_kitti_odometry import write_sequence
from tests.datasets.test_kitti_raw import drive_on_the_road, write_kitti
from tests.datasets.test_nuscenes import write_nuscenes
from tests.datasets.test_nuscenes_infos import write_infos
from tests.datasets.test_waymo_records import write_frames
from tests.datasets.test_waymo_tables import segment_tables, write_segment
from tfrecord_framing import framed

from .containers import Damage, inside_records, inside_zip
from .json_mutations import damaged_json
from .mutations import damaged_bytes, damaged_header, damaged_text
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


def _written(write: Callable[[Path], Any], below: str = ".") -> Callable[[Path], Path]:
    def written(folder: Path) -> Path:
        write(folder)
        return folder / below

    return written


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


def _colmap(write: Callable[[Path], None]) -> Callable[[Path], Path]:
    def written(folder: Path) -> Path:
        write(folder / "sparse/0")
        write_pictures(folder / "images")
        return folder

    return written


def _nerfstudio(kind: str, folder: Path) -> None:
    write_pictures(folder / "images", ("a.png", "b.png", "c.png"))
    np.save(folder / "depth.npy", np.full((48, 64), 2.5, np.float32))
    Image.fromarray(np.full((48, 64), 2500, np.uint16)).save(folder / "depth.png")
    Image.fromarray(np.full((48, 64), 255, np.uint8)).save(folder / "mask.png")
    rows = np.zeros(4, [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("red", "u1"), ("green", "u1"), ("blue", "u1")])
    names = "".join(f"property {'float' if name in 'xyz' else 'uchar'} {name}\n" for name in rows.dtype.names or ())
    header = f"ply\nformat {kind} 1.0\nelement vertex 4\n{names}end_header\n"
    text = "".join(f"{k} 2.5 -1 10 20 30\n" for k in range(4)).encode()
    (folder / "points.ply").write_bytes(header.encode() + (text if kind == "ascii" else rows.tobytes()))
    frames = []
    for k, name in enumerate("abc"):
        pose = np.eye(4)
        pose[:3, 3] = [k, 1, 2]
        frames.append({"file_path": f"images/{name}.png", "transform_matrix": pose.tolist()})
    frames[0] |= {"depth_file_path": "depth.npy", "mask_path": "mask.png"}
    frames[1] |= {"depth_file_path": "depth.png", "depth_unit_scale_factor": 0.001}
    once = {"fl_x": 50.0, "fl_y": 51.0, "cx": 32.0, "cy": 24.0, "w": 64, "h": 48, "k1": 0.1, "camera_model": "OPENCV"}
    (folder / "transforms.json").write_text(json.dumps({**once, "ply_file_path": "points.ply", "frames": frames}))


def _rainsense(folder: Path) -> None:
    for name in ("image", "context", "lidar", "label"):
        (folder / name).mkdir()
    write_pictures(folder / "image", ("image_000.jpg", "image_001.jpg"))
    matrix = f"{FOCAL} 0 {WIDTH / 2}\n0 {FOCAL} {HEIGHT / 2}\n0 0 1\n"
    (folder / "context/camera_intrinsics.txt").write_text(f"K:\n{matrix}D: 0.1 0.2 0.01 0.02 0.3\n")
    (folder / "context/rainfall_intensity.txt").write_text("rainfall intensity: 2.654 mm/h\n".replace(" mm/h", ""))
    (folder / "context/calib_lid_to_cam.txt").write_text("0 -1 0 0.1\n0 0 -1 0.2\n1 0 0 0.3\n0 0 0 1\n")
    (folder / "timestamps.txt").write_text("timestamp\n10.0,1\n10.5,2\n")
    for k in range(2):
        (folder / f"lidar/frame_{k:03d}.csv").write_text("X,Y,Z,Reflectivity\n1.5,2,3,9\n4,5,6,20\n7,8,9,3\n")
        (folder / f"label/label_{k:03d}.txt").write_text("Car 0 0 0 1 2 3 4 1.5 1.8 4.2 1 1.6 12 0.3\n")


def _bdd100k(folder: Path) -> None:
    names = ("0000f77c-6257be58", "0000f77c-cb820c98")
    write_pictures(folder / "images/100k/train", tuple(f"{name}.jpg" for name in names))
    rows = [{"name": f"{name}.jpg", "attributes": {"weather": "rainy", "scene": "city"}} for name in names]
    (folder / "labels").mkdir()
    (folder / "labels/det_train.json").write_text(json.dumps(rows))


def _pictures(folder: Path) -> None:
    write_pictures(folder, tuple(f"{suffix}.{suffix}" for suffix in ("png", "jpg", "webp", "bmp", "tif")))
    noise = np.random.default_rng(1).integers(0, 65535, (20, 30)).astype(np.uint16)
    Image.fromarray(noise).save(folder / "gray.png")
    Image.fromarray((noise % 4).astype(np.uint8), mode="L").convert("P").save(folder / "palette.png")
    Image.fromarray(noise.astype(np.uint8)).convert("CMYK").save(folder / "cmyk.jpg")


def _infos(layout: str, folder: Path) -> None:
    write_infos(folder, _SMALL, layout)


def _kitti_raw(folder: Path) -> None:
    write_kitti(folder, drive_on_the_road())


def _waymo_records(folder: Path) -> None:
    write_frames(folder / "a.tfrecord", _SMALL)


def _waymo_tables(folder: Path) -> None:
    write_segment(folder, segment_tables(_SMALL))


def _row(name: str, kind: str, write: Callable[[Path], Path], *damage: tuple[str, Damage]) -> Reader:
    def written(folder: Path) -> Path:
        path = write(folder)
        found = capture_format(path)
        assert found is not None and found.name == kind, f"{name}: taken for {found}"
        return path

    return Reader(name, written, _read, CaptureError, (*damage, *_PICTURES))


_JSON, _TEXT, _BYTES = ("*.json", damaged_json), ("*.txt", damaged_text), ("*.bin", damaged_bytes)
_NPY, _PKL = ("*.npy", damaged_bytes), ("*.pkl", damaged_bytes)
_PLY = ("*.ply", damaged_header(b"end_header\n"))
_NPZ = ("*.npz", inside_zip(lambda _: damaged_bytes))

CAPTURE_READERS = (
    _row("capture-folder", "capture folder", _written(_capture_folder), _JSON, _NPY),
    _row("colmap-binary", "COLMAP", _colmap(write_binary), _BYTES),
    _row("colmap-text", "COLMAP", _colmap(write_text), _TEXT),
    _row("nerfstudio", "nerfstudio", _written(partial(_nerfstudio, "ascii")), _JSON, _NPY, _PLY),
    _row("nerfstudio-binary", "nerfstudio", _written(partial(_nerfstudio, "binary_little_endian")), _JSON, _NPY, _PLY),
    _row("dgp", "DGP", _written(lambda folder: write_dgp(folder, _SMALL)), _JSON, _NPZ),
    _row("nuscenes", "nuScenes", _written(lambda folder: write_nuscenes(folder, _SMALL)), _JSON, _BYTES),
    _row("nuscenes-infos", "nuScenes (MMDetection3D)", _written(partial(_infos, "1.x")), _PKL, _BYTES),
    _row("nuscenes-infos-old", "nuScenes (MMDetection3D)", _written(partial(_infos, "0.x")), _PKL, _BYTES),
    _row("kitti-raw", "KITTI raw", _written(_kitti_raw), _TEXT, _BYTES, ("*.xml", damaged_text)),
    _row("kitti-odometry", "KITTI odometry", _written(write_sequence), _TEXT, _BYTES),
    _row("waymo-records", "Waymo Perception v1", _written(_waymo_records), ("*.tfrecord", inside_records(framed))),
    _row("waymo-tables", "Waymo Perception v2", _written(_waymo_tables), ("*.parquet", damaged_bytes)),
    _row("rainsense", "RainSense", _written(_rainsense), _TEXT, ("*.csv", damaged_text)),
    _row("bdd100k", "BDD-100K", _written(_bdd100k), _JSON),
    _row("pictures", "image folder", _written(_pictures)),
)  # fmt: skip
"""Captures, and what looks at them and at their pixels."""
