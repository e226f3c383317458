"""Captures of still scenes and single pictures, written as each data set has them."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from colmap_files import write_pictures
from gsrain_engine.datasets.capture import CaptureFrame
from gsrain_engine.scene.camera import Camera, look_at
from gsrain_engine.scene.lens import Lens
from mini_drive import FOCAL, HEIGHT, WIDTH


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


# nerfstudio

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


def write_nerfstudio(folder: Path, shared: dict[str, Any] | None = None, **each: Any) -> Path:
    names = ("images/b.png", "images/a.png")
    write_pictures(folder, names)
    frames = [{"file_path": n, "transform_matrix": opengl_pose(e), **each} for n, e in zip(names, EYES, strict=True)]
    document = {**(INTRINSICS if shared is None else shared), "frames": frames}
    (folder / "transforms.json").write_text(json.dumps(document))
    return folder


def points_ply(kind: str, points: list[tuple[float, ...]]) -> bytes:
    """A PLY of points and their colors: `ascii` or `binary_little_endian`."""
    names = "".join(f"property float {axis}\n" for axis in "xyz")
    names += "".join(f"property uchar {name}\n" for name in ("red", "green", "blue"))
    header = f"ply\nformat {kind} 1.0\nelement vertex {len(points)}\n{names}end_header\n".encode()
    if kind == "ascii":
        return header + "".join(" ".join(str(number) for number in row) + "\n" for row in points).encode()
    return header + np.array(points, "<f4,<f4,<f4,u1,u1,u1").tobytes()


# Single pictures


def write_rainsense(folder: Path) -> None:
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


def write_bdd100k(folder: Path) -> None:
    names = ("0000f77c-6257be58", "0000f77c-cb820c98")
    write_pictures(folder / "images/100k/train", tuple(f"{name}.jpg" for name in names))
    rows = [{"name": f"{name}.jpg", "attributes": {"weather": "rainy", "scene": "city"}} for name in names]
    (folder / "labels").mkdir()
    (folder / "labels/det_train.json").write_text(json.dumps(rows))


def write_odd_pictures(folder: Path) -> None:
    write_pictures(folder, tuple(f"{suffix}.{suffix}" for suffix in ("png", "jpg", "webp", "bmp", "tif")))
    noise = np.random.default_rng(1).integers(0, 65535, (20, 30)).astype(np.uint16)
    Image.fromarray(noise).save(folder / "gray.png")
    Image.fromarray((noise % 4).astype(np.uint8), mode="L").convert("P").save(folder / "palette.png")
    Image.fromarray(noise.astype(np.uint8)).convert("CMYK").save(folder / "cmyk.jpg")
