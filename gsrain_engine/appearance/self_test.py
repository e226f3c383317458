"""Self-test of published weights: their authors' own input, and how near ours comes to their output."""

import os
from pathlib import Path

import numpy as np
from msgspec import Struct

from ..datasets.io.images import read_color
from ..scene.camera import Camera
from .base import ClearView, TransferSettings
from .cyclegan_turbo.weight_paths import find_transfer_weights

PASSED_DB = 35.0
"""Peak signal-to-noise ratio from which results count as the same; other libraries round differently."""

TEST_DATA = "GSRAIN_TEST_DATA"
"""Environment variable with a folder that holds `weather/img2img_turbo/clear2rainy_input.png` and `..._output.png`."""
_PAIR = "weather/img2img_turbo/clear2rainy_{}.png"
_WHERE = "https://github.com/GaParmar/img2img-turbo (assets/examples/clear2rainy_input.png and _output.png)"
_NO_PAIR = "no input and output of its authors with a license to use is known"


class SelfTest(Struct, frozen=True, kw_only=True):
    """Result for one model."""

    model: str
    what: str
    """Finding, or instructions to get what is missing."""
    psnr_db: float | None = None
    passed: bool | None = None
    """None if it could not be tested."""


def self_tests(pair: tuple[Path, Path] | None = None) -> list[SelfTest]:
    """Test all models whose authors publish a result; `pair` are their input and output for clear2rainy.

    Without it, the pair of the folder in GSRAIN_TEST_DATA is taken.
    """
    untested = [SelfTest(model=name, what=_NO_PAIR) for name in ("DSINE", "Inception", "detectors")]
    return [_clear2rainy(pair or _pair()), *untested]


def _pair() -> tuple[Path, Path] | None:
    folder = os.environ.get(TEST_DATA)
    if folder is None:
        return None
    source, expected = (Path(folder) / _PAIR.format(end) for end in ("input", "output"))
    return (source, expected) if source.is_file() and expected.is_file() else None


def _clear2rainy(pair: tuple[Path, Path] | None) -> SelfTest:
    name = "clear2rainy"
    if pair is None:
        return SelfTest(model=name, what=f"needs its authors' input and output: --pair IN OUT, from {_WHERE}")
    try:
        weights = find_transfer_weights()
        made, expected = transferred_pair(weights, *pair)
    except (FileNotFoundError, ValueError, ImportError) as error:
        return SelfTest(model=name, what=str(error))
    error = float(np.mean((made.astype(np.float64) - expected) ** 2))
    psnr_db = float(10 * np.log10(255**2 / error)) if error else 99.0
    passed = psnr_db >= PASSED_DB
    words = f"{psnr_db:.1f} dB"
    what = f"matches the authors' result: {words}" if passed else f"differs from the authors' result: only {words}"
    return SelfTest(model=name, what=what, psnr_db=round(psnr_db, 2), passed=passed)


def transferred_pair(weights: Path, source: Path, expected: Path) -> tuple[np.ndarray, np.ndarray]:
    """Run weights on an image as its authors do; returns the result and the expected one, both (h, w, 3) uint8.

    Raises ValueError for weights that are not img2img-turbo's, and for images of different sizes.
    """
    from .cyclegan_turbo.translator import open_cyclegan_turbo  # torch and diffusers are extras
    from .cyclegan_turbo.weights import PUBLISHED

    image, wanted = read_color(source), read_color(expected)
    if image.shape != wanted.shape:
        raise ValueError(f"{expected}: is {wanted.shape[1]}x{wanted.shape[0]} px, {source} is another size")
    settings = TransferSettings(weights=weights, mutual_attention=False)
    transfer = open_cyclegan_turbo(settings)
    if transfer.model.record != PUBLISHED:
        raise ValueError(f"{weights}: not img2img-turbo's clear2rainy.pkl, whose authors' result is known")
    (rainy,) = transfer.transferred([_view(image)])
    return np.rint(255 * rainy.image).astype(np.uint8), wanted


def _view(image: np.ndarray) -> ClearView:
    """View without known geometry."""
    height, width = image.shape[:2]
    plane = np.zeros((height, width), np.float32)
    camera = Camera(width, height, width, width, width / 2, height / 2, np.eye(4))
    pixels = (image / np.float32(255)).astype(np.float32)
    return ClearView("input", camera, 0.0, pixels, plane, np.zeros_like(pixels), plane, plane, has_pose=False)
