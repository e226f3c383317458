"""Agreement of lidar points with an image: edges in depth against edges in brightness."""

from dataclasses import replace

import cv2
import numpy as np

from gsrain_engine.datasets.capture import Capture, CaptureFrame
from gsrain_engine.datasets.geometry import nearest_sweep, project_points


def edge_agreement(view: CaptureFrame, points: np.ndarray) -> float:
    """Correlation, over points, of lying at an edge in depth and lying at one of the picture (Levinson 2013)."""
    grey = cv2.GaussianBlur(cv2.cvtColor(view.image, cv2.COLOR_RGB2GRAY).astype(np.float32), (0, 0), 2.0)
    edges = cv2.GaussianBlur(
        np.hypot(cv2.Sobel(grey, cv2.CV_32F, 1, 0), cv2.Sobel(grey, cv2.CV_32F, 0, 1)), (0, 0), 3.0
    )
    pixels, depths = project_points(points, view.camera, view.lens)
    size = [view.camera.width, view.camera.height]
    inside = (depths > 1) & (pixels >= 0).all(axis=1) & (pixels < size).all(axis=1)
    pixels, depths = pixels[inside], depths[inside]
    columns, rows = pixels.T.astype(int)
    nearest = np.full((view.camera.height // 8 + 1, view.camera.width // 8 + 1), np.inf)
    np.minimum.at(nearest, (rows // 8, columns // 8), depths)
    spread = cv2.dilate(np.where(np.isfinite(nearest), 1 / nearest, 0), np.ones((3, 3))) - 1 / depths.max()
    jump = np.clip(spread[rows // 8, columns // 8] - 1 / depths, 0, None)
    return float(np.corrcoef(np.log1p(edges[rows, columns]), jump > 0.01)[0, 1])


def agreement_when_turned(capture: Capture, view: CaptureFrame, degrees: float) -> float:
    """The same after the camera was turned about its vertical axis."""
    cosine, sine = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    turn = np.eye(4)
    turn[[0, 0, 2, 2], [0, 2, 0, 2]] = cosine, sine, -sine, cosine
    moved = replace(view, camera=replace(view.camera, world_to_camera=turn @ view.camera.world_to_camera))
    sweep = nearest_sweep(view, capture.sweeps)
    assert sweep is not None
    return edge_agreement(moved, sweep.points_m)
