"""The guided filters: the same as their definition, and as each build of OpenCV has what they need."""

import re
from types import ModuleType

import cv2
import numpy as np
import pytest

from gsrain_engine.render.guided_filter import color_guided_filter, guided_filter
from repository import REPOSITORY

RADIUS, SPREAD = 2, 0.05
MAIN_MODULES = {"dnn", "detail", "fisheye", "flann", "ml", "ocl", "samples", "utils", "videoio_registry", "error"}
"""Modules of OpenCV that each build has; the others are of opencv-contrib-python."""


def windows(image):
    """All windows around the pixels of an image, mirrored at its edges, (h, w, n, channels)."""
    image = np.atleast_3d(image)
    padded = np.pad(image, [(RADIUS, RADIUS), (RADIUS, RADIUS), (0, 0)], mode="symmetric")
    side = 2 * RADIUS + 1
    found = np.lib.stride_tricks.sliding_window_view(padded, (side, side), axis=(0, 1))
    return found.reshape(*image.shape, side**2).swapaxes(2, 3)


def fitted(values, guide, known):
    """He, Sun and Tang's filter by its definition: a regression in each window, over known values only."""
    colors, inputs, counts = windows(guide), windows(values)[..., 0], windows(known.astype(float))[..., 0]
    h, w, _, channels = colors.shape
    lines = np.zeros((h, w, channels + 2))
    for y, x in np.ndindex(h, w):
        weights = counts[y, x]
        if weights.sum() == 0:
            continue
        share = weights / weights.sum()
        mean, value = share @ colors[y, x], share @ inputs[y, x]
        away = colors[y, x] - mean
        slope = np.linalg.solve(away.T * share @ away + SPREAD**2 * np.eye(channels), away.T * share @ inputs[y, x])
        lines[y, x] = *slope, value - slope @ mean, 1
    means = windows(lines).mean(axis=2)
    found = (means[..., :-2] * np.atleast_3d(guide)).sum(axis=-1) + means[..., -2]
    return found / means[..., -1]


@pytest.mark.parametrize("share", [1.0, 0.5])
def test_it_is_a_regression_in_each_window(share):
    random = np.random.default_rng(1)
    guide, values = random.random((11, 13, 3)).astype(np.float32), random.random((11, 13)).astype(np.float32)
    known = random.random((11, 13)) < share
    found = color_guided_filter(values, guide, RADIUS, SPREAD, None if share == 1 else known)
    assert found == pytest.approx(fitted(values, guide, known), abs=2e-5)


def test_by_a_brightness_it_is_the_same_inside():
    random = np.random.default_rng(2)
    guide, values = random.random((15, 17)).astype(np.float32), random.random((15, 17)).astype(np.float32)
    inner = (slice(2 * RADIUS, -2 * RADIUS),) * 2  # edges are mirrored in another way
    expected = fitted(values, guide, np.ones_like(values))
    assert guided_filter(values, guide, RADIUS, SPREAD**2)[inner] == pytest.approx(expected[inner], abs=2e-5)


def test_no_file_needs_more_of_opencv_than_each_build_has():
    modules = {name for name, each in vars(cv2).items() if isinstance(each, ModuleType)} - MAIN_MODULES
    modules |= {"ximgproc", "xphoto", "aruco", "face", "optflow", "xfeatures2d"}
    contrib = re.compile(rf"\bcv2\.({'|'.join(sorted(modules))})\b")
    sources = [
        path for folder in ("gsrain", "gsrain_engine", "app", "ui") for path in (REPOSITORY / folder).rglob("*.py")
    ]
    assert len(sources) > 400
    assert [str(path) for path in sources if contrib.search(path.read_text(encoding="utf-8"))] == []
