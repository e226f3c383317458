"""Writes one scene of a million Gaussians of SH degree 3 in several formats, for what is timed when they are opened."""

import io
import json
import zipfile
from pathlib import Path

import numpy as np
from PIL import Image

from gsrain_engine.scene.formats.scene_files import write_scene
from gsrain_engine.scene.gaussians import Gaussians
from gsrain_engine.scene.open import random_scene
from gsrain_engine.scene.scene import Layer, Scene

FORMATS = ("million.ply", "million.splat", "million.spz", "million.sog", "million")
_PALETTE = 2**16
_SMALL = 2000


def write_million(folder: Path) -> None:
    """Write every format that is not there yet; of a small scene too, with which kernels are loaded."""
    missing = [name for name in FORMATS if not (folder / name).exists() or not (folder / "small" / name).exists()]
    if not missing:
        return
    scene = random_scene("random-1m")
    (layer,) = scene.layers
    # In no order that helps, as from a training.
    shuffled = layer.gaussians.take(np.random.default_rng(1).permutation(len(layer.gaussians)))
    for place, gaussians in ((folder, shuffled), (folder / "small", shuffled.take(slice(0, _SMALL)))):
        place.mkdir(parents=True, exist_ok=True)
        for name in missing:
            if name.endswith(".sog"):
                (place / name).write_bytes(sog_of(gaussians))
            else:
                write_scene(Scene("million", (Layer("million", gaussians),), up=scene.up), place / name)


def write_pictures(folder: Path) -> None:
    """Write eight pictures, and what they should be."""
    rng = np.random.default_rng(2)
    for name, noise in (("truth", 0), ("shown", 12)):
        (folder / name).mkdir(exist_ok=True)
        for number in range(8):
            y, x = np.mgrid[:640, :960]
            picture = 128 + 90 * np.sin(np.stack([x / 40, y / 30, (x + y) / 50], axis=-1) + number)
            pixels = np.clip(picture + noise * rng.standard_normal(picture.shape), 0, 255).astype(np.uint8)
            Image.fromarray(pixels).save(folder / name / f"{number}.png")


def sog_of(gaussians: Gaussians) -> bytes:
    """Encode as SOG, version 2; harmonics above degree 0 by a palette of the first of them."""
    n = len(gaussians)
    logs = np.sign(gaussians.means) * np.log1p(np.abs(gaussians.means))
    low, high = logs.min(axis=0), logs.max(axis=0)
    steps = np.rint((logs - low) / (high - low) * 65535).astype(np.int64)
    scales, scale_book = _in_codebook(np.log(gaussians.scales))
    base, base_book = _in_codebook(gaussians.sh[:, 0])
    largest = np.abs(gaussians.quaternions).argmax(axis=1)
    others = gaussians.quaternions[np.arange(4) != largest[:, None]].reshape(n, 3)
    others = others * np.sign(np.take_along_axis(gaussians.quaternions, largest[:, None], axis=1))
    quaternions = np.rint((others * np.sqrt(2) + 1) * 127.5)
    palette, palette_book = _in_codebook(gaussians.sh[: min(_PALETTE, n), 1:])
    entries = -(-len(palette) // 64) * 64
    centroids = np.zeros((entries, 15, 3), np.uint8)
    centroids[: len(palette)] = palette
    labels = np.arange(n) % len(palette)
    files = {
        "means_l.webp": _image(steps % 256),
        "means_u.webp": _image(steps // 256),
        "scales.webp": _image(scales),
        "quats.webp": _image(np.column_stack([quaternions, 252 + largest])),
        "sh0.webp": _image(np.column_stack([base, np.rint(255 * gaussians.opacities)])),
        "shN_centroids.webp": _webp(centroids.reshape(-1, 64 * 15, 3)),
        "shN_labels.webp": _image(np.column_stack([labels % 256, labels // 256])),
    }
    meta = {
        "version": 2,
        "count": n,
        "means": {"mins": low.tolist(), "maxs": high.tolist(), "files": ["means_l.webp", "means_u.webp"]},
        "scales": {"codebook": scale_book, "files": ["scales.webp"]},
        "quats": {"files": ["quats.webp"]},
        "sh0": {"codebook": base_book, "files": ["sh0.webp"]},
        "shN": {"count": len(palette), "bands": 3, "codebook": palette_book,
                "files": ["shN_centroids.webp", "shN_labels.webp"]},
    }  # fmt: skip
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w") as archive:
        archive.writestr("meta.json", json.dumps(meta))
        for name, data in files.items():
            archive.writestr(name, data)
    return file.getvalue()


def _in_codebook(values: np.ndarray) -> tuple[np.ndarray, list[float]]:
    """Nearest of 256 even steps, and those."""
    book = np.linspace(values.min(), values.max(), 256)
    return np.rint((values - book[0]) / (book[1] - book[0])).astype(np.uint8), book.tolist()


def _image(rows: np.ndarray) -> bytes:
    """A pixel a Gaussian, in a picture about as wide as high."""
    width = int(np.ceil(np.sqrt(len(rows)) / 4)) * 4
    pixels = np.zeros((-(-len(rows) // width) * width, 4), np.uint8)
    pixels[:, 3] = 255
    pixels[: len(rows), : rows.shape[1]] = rows
    return _webp(pixels.reshape(-1, width, 4))


def _webp(pixels: np.ndarray) -> bytes:
    file = io.BytesIO()
    Image.fromarray(pixels).save(file, "WEBP", lossless=True, exact=True, quality=0)
    return file.getvalue()
