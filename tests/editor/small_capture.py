"""Written captures of a few plain pictures: views along a line, of one camera or of two."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from gsrain_engine.datasets.capture import Capture, CaptureFrame
from gsrain_engine.datasets.capture_folder import write_views
from gsrain_engine.scene.camera import Camera, look_at

UP = np.array([0.0, 0.0, 1.0])
COLORS = ((230, 40, 40), (40, 220, 60), (50, 70, 235), (230, 220, 50))


def small_capture() -> Capture:
    """Look along +x from places 1 m apart, to the left and the right in turn; each picture has a color of its own."""
    views: list[CaptureFrame] = []
    for i, color in enumerate(COLORS):
        eye = np.array([float(i), 0.0, 1.5])
        pose = look_at(eye, eye + np.array([1.0, 0.0, 0.0]), UP)
        image = np.full((48, 80, 3), color, np.uint8)
        image[:, 60:] = 255
        sensor = ("left", "right")[i % 2]
        views.append(CaptureFrame(f"{i:03d}", Camera(80, 48, 60.0, 60.0, 42.0, 22.0, pose), image, 0.5 * i, sensor))
    points = np.random.default_rng(0).uniform((4, -2, 0), (8, 2, 3), (500, 3))
    colors = np.tile(np.array([[255, 0, 255]], np.uint8), (500, 1))
    return Capture("small", tuple(views), points_m=points, point_colors=colors)


def written_capture(folder: Path) -> Path:
    """Write it as a folder that `gsrain street` could have written."""
    for _ in write_views(folder, [replace(view) for view in small_capture()]):
        pass
    return folder
