"""Writes small COLMAP models by the specification of its files, for tests of readers."""

import struct
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from PIL import Image

from gsrain_engine.datasets.capture import Capture, CaptureFrame
from gsrain_engine.scene.geometry import quaternions_from_matrices

IDS = {
    "SIMPLE_PINHOLE": 0,
    "PINHOLE": 1,
    "SIMPLE_RADIAL": 2,
    "RADIAL": 3,
    "OPENCV": 4,
    "OPENCV_FISHEYE": 5,
    "FULL_OPENCV": 6,
    "FOV": 7,
    "SIMPLE_RADIAL_FISHEYE": 8,
    "RADIAL_FISHEYE": 9,
    "THIN_PRISM_FISHEYE": 10,
}
TWO = ("a.png", "b.png")
PINHOLE = (50.0, 51.0, 32.0, 24.0)
QUATERNIONS = ((1.0, 0.0, 0.0, 0.0), (0.5, 0.5, 0.5, 0.5))
SHIFTS = ((0.0, 0.0, 0.0), (1.0, 2.0, 3.0))
POINTS = ((1.0, 2.0, 9.0, 10, 20, 30), (-1.5, 0.5, 7.25, 255, 0, 128))


def write_binary(
    folder: Path,
    names: tuple[str, ...] = TWO,
    model: str = "PINHOLE",
    parameters: tuple[float, ...] = PINHOLE,
) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    camera = struct.pack("<QIiQQ", 1, 7, IDS[model], 64, 48) + struct.pack(f"<{len(parameters)}d", *parameters)
    (folder / "cameras.bin").write_bytes(camera)
    images = struct.pack("<Q", len(names))
    for k, name in enumerate(names):
        images += struct.pack("<I7dI", k + 1, *QUATERNIONS[k % 2], *SHIFTS[k % 2], 7) + name.encode() + b"\0"
        images += struct.pack("<Q", 2) + 2 * struct.pack("<2dq", 3.0, 4.0, -1)
    (folder / "images.bin").write_bytes(images)
    points = struct.pack("<Q", len(POINTS))
    for k, point in enumerate(POINTS):
        points += struct.pack("<Q3d3Bd", k, *point, 0.5) + struct.pack("<Q", k) + k * struct.pack("<II", 1, 0)
    (folder / "points3D.bin").write_bytes(points)


def write_text(folder: Path, names: tuple[str, ...] = TWO, camera: str = "7 PINHOLE 64 48 50 51 32 24") -> None:
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "cameras.txt").write_text(f"# cameras\n{camera}\n")
    lines = ["# images"]
    for k, name in enumerate(names):
        numbers = " ".join(str(number) for number in (*QUATERNIONS[k % 2], *SHIFTS[k % 2]))
        lines += [f"{k + 1} {numbers} 7 {name}", "3 4 -1 5 6 -1" if k == 0 else ""]
    (folder / "images.txt").write_text("\n".join(lines) + "\n")
    rows = [f"{k} {' '.join(str(each) for each in point)} 0.5 1 0" for k, point in enumerate(POINTS)]
    (folder / "points3D.txt").write_text("\n".join(["# points", *rows]) + "\n")


def write_pictures(folder: Path, names: tuple[str, ...] = TWO, size: tuple[int, int] = (64, 48)) -> None:
    for k, name in enumerate(names):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        noise = np.random.default_rng(k).integers(0, 255, (size[1], size[0], 3), np.uint8)
        Image.fromarray(noise).save(folder / name)


def cut_rows(capture: Capture) -> tuple[CaptureFrame, ...]:
    """Views that are each a row higher than the one before, as undistortion by one camera a picture makes them."""
    views = []
    for k, view in enumerate(capture):
        rows = view.camera.height - len(capture) + k + 1
        pixels = {
            f"{name}_source": None if (values := getattr(view, name)) is None else values[:rows]
            for name in ("image", "depth", "sky", "mask")
        }
        views.append(replace(view, camera=replace(view.camera, height=rows), **pixels))
    return tuple(views)


def write_undistorted(folder: Path, views: Sequence[CaptureFrame], points_m: np.ndarray) -> None:
    """Write what image_undistorter makes of photos with a camera each: images/, and a PINHOLE camera a picture."""
    (folder / "images").mkdir(parents=True)
    (folder / "sparse").mkdir()
    cameras, images = [], []
    for k, view in enumerate(views, start=1):
        camera, name = view.camera, f"{view.name}.png"
        cameras.append(f"{k} PINHOLE {camera.width} {camera.height} {camera.fx} {camera.fy} {camera.cx} {camera.cy}")
        quaternion = quaternions_from_matrices(camera.world_to_camera[None, :3, :3])[0]
        pose = " ".join(str(each) for each in (*quaternion, *camera.world_to_camera[:3, 3]))
        images += [f"{k} {pose} {k} {name}", ""]
        Image.fromarray(view.image).save(folder / "images" / name)
    (folder / "sparse" / "cameras.txt").write_text("\n".join(cameras) + "\n")
    (folder / "sparse" / "images.txt").write_text("\n".join(images) + "\n")
    rows = [f"{k} {x} {y} {z} 120 110 100 0.5 1 0" for k, (x, y, z) in enumerate(points_m)]
    (folder / "sparse" / "points3D.txt").write_text("\n".join(rows) + "\n")
