"""Scene of a page: all Gaussians in one SOG file, their soaked colors, and which of them move with which actor."""

import io
import json
from collections.abc import Generator, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Float32, Float64, Int64, UInt8
from PIL import Image

from ..render.passes.mirror import reflecting_items
from ..scene.formats.sog_writer import (
    coded,
    encode_harmonics,
    image_columns,
    lossless_image,
    mean_steps,
    sog_order,
    write_sog,
)
from ..scene.gaussians import SH_C0, Gaussians
from ..scene.progress import Progress
from ..scene.scene import Actor, DrawItem, Layer, Scene
from ..scene.transforms import bake_item, transform_gaussians, world_to_file
from .page_mirror import floors_below, water_codes

POSE_STEP_S = 0.1  # between the poses of actors, as recordings have them
COLUMNS = 2048
"""Columns of images with a pixel for each Gaussian."""
WET_STEPS = 85
"""Steps of a soaked color from 0 to 1. Colors from -1 to 2 have one of 256 numbers."""
CODES = 128
"""Values of scales, and of base colors: with 256, the page of the street has 0.6 MB more, and 0.3 dB."""

_STEP = 0.1  # of a position, in widths of the median Gaussian
_MOST_PARTS = 16  # of a step of a SOG file
_WET_PALETTE = 16384  # soaked harmonics at most; wet colors with all bits of a SOG file: 1.7 MB more, 0.2 dB
_ABSENT = np.full((3, 4), np.nan, np.float32)


class PageScene(NamedTuple):
    """Scene of a page."""

    sog: bytes
    """The scene as it is lit, in the frame of single-file scenes; actors where they are first."""
    parts: list[int]
    """Parts of a step of the SOG file's means, for each axis."""
    mean_parts: bytes
    """Lossless image with a pixel for each Gaussian: number of the part in which its mean is, for each axis."""
    wet_colors: dict[str, bytes] | None
    """Files with the colors of the same Gaussians in the same order when soaked (`wet_files`); None without any."""
    actors: bytes | None
    """Lossless image with a pixel for each Gaussian: number of its actor, red and 256 green; 0 does not move."""
    poses: Float32[np.ndarray, "actors steps 3 4"]
    """From an actor's first place to that at a time, NaN while it is absent."""
    floors_m: Float32[np.ndarray, "actors steps"]
    """Heights of uneven ground below the origins of actors; 0 elsewhere."""
    water: bytes | None
    """Lossless image with the `water_codes` of each Gaussian; None without a mirror."""
    antialiased: bool


class _Merged(NamedTuple):
    gaussians: Gaussians
    labels: Int64[np.ndarray, " n"]
    water: UInt8[np.ndarray, "n 3"] | None


def page_scene(
    scene: Scene, start_s: float, length_s: float, *, mirror: bool = False
) -> Generator[Progress, None, PageScene]:
    """Prepare all that is visible at any time of a path; with a `mirror`, wet ground is as it is below its water."""
    mirror = mirror and scene.water is not None
    times_s = start_s + POSE_STEP_S * np.arange(int(np.ceil(length_s / POSE_STEP_S)) + 1)
    items: list[tuple[Layer | Actor, float, int]] = []
    poses: list[Float32[np.ndarray, "steps 3 4"]] = []
    floors: list[Float32[np.ndarray, " steps"]] = []
    for member in scene.members:
        places = [scene.part(member, float(t)) for t in times_s] if member.visible else []
        first = next((k for k, place in enumerate(places) if place is not None), None)
        if first is None:
            continue
        moves = _moves(places, first)
        is_moving = isinstance(member, Actor) and not np.array_equal(moves, np.broadcast_to(moves[first], moves.shape))
        poses += [moves] if is_moving else []
        floors += [floors_below(places, scene.water)] if is_moving else []
        items.append((member, float(times_s[first]), len(poses) if is_moving else 0))
    yield Progress(0.1, "Compressing the scene")
    dry, labels, water = _merged(scene, items, 0.0, mirror=mirror)
    order = sog_order(dry)
    sog = sog_bytes(dry)
    parts, mean_parts = finer_means(dry.take(order))
    wet = None
    if scene.has_wet_colors:
        yield Progress(0.5, "Compressing the wet colors")
        soaked = _merged(scene, items, 1.0, mirror=mirror).gaussians.sh
        wet = wet_files(dry.sh[order], soaked[order])
    moved = np.stack(poses) if poses else np.zeros((0, len(times_s), 3, 4), np.float32)
    below = np.stack(floors) if floors else np.zeros((0, len(times_s)), np.float32)
    actors = _label_image(labels[order]) if poses else None
    shares = None if water is None else lossless_image(water[order], COLUMNS)
    return PageScene(sog, parts, mean_parts, wet, actors, moved, below, shares, dry.antialiased)


def _moves(places: Sequence[DrawItem | None], first: int) -> Float32[np.ndarray, "steps 3 4"]:
    start = places[first]
    assert start is not None
    to_file, back = world_to_file(), np.linalg.inv(world_to_file() @ start.to_world)
    return np.stack(
        [
            _ABSENT if place is None else (to_file @ place.to_world @ back)[:3].astype(np.float32).round(6)
            for place in places
        ]
    )


def _merged(
    scene: Scene, items: Sequence[tuple[Layer | Actor, float, int]], wetness: float, *, mirror: bool
) -> _Merged:
    """All Gaussians in the frame of single-file scenes, the numbers of their actors, and the water on them."""
    parts: list[Gaussians] = []
    labels: list[Int64[np.ndarray, " n"]] = []
    water: list[UInt8[np.ndarray, "n 3"]] = []
    for member, time_s, label in items:
        item = scene.part(member, time_s, wetness=wetness)
        assert item is not None
        if mirror:
            (item,) = reflecting_items([item], scene)
            water.append(water_codes(item, scene))
        parts.append(transform_gaussians(bake_item(item), _to_file(item)))
        labels.append(np.full(len(parts[-1]), label))
    return _Merged(Gaussians.concatenate(parts), np.concatenate(labels), np.concatenate(water) if water else None)


def _to_file(item: DrawItem) -> Float64[np.ndarray, "4 4"]:
    return world_to_file() @ item.to_world


def sog_bytes(gaussians: Gaussians) -> bytes:
    """Gaussians as a SOG file."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "scene.sog"
        write_sog(gaussians, path, codes=CODES)
        return path.read_bytes()


def finer_means(gaussians: Gaussians) -> tuple[list[int], bytes]:
    """Parts of the steps of a SOG file's means per axis, and the image with the parts of Gaussians in its order.

    A step grows with the distance from the scene's origin, and its rounding changes the order in depth of Gaussians on
    one surface. Up to 16 parts a step, they are at most `_STEP` wide for the median Gaussian: the street's steps along
    the drive have 8.
    """
    exact, mins, maxs = mean_steps(gaussians.means)
    widths = np.sqrt(np.prod(np.sort(gaussians.scales, axis=1)[:, 1:], axis=1))
    steps = (maxs - mins) / 65535 * (1 + np.median(np.abs(gaussians.means), axis=0))
    least = steps / max(_STEP * float(np.median(widths)), 1e-30)
    parts = 2 ** np.ceil(np.log2(np.clip(least, 1, _MOST_PARTS))).astype(np.int64)
    rows = np.clip(np.floor((exact - np.rint(exact) + 0.5) * parts), 0, parts - 1).astype(np.uint8)
    return parts.tolist(), lossless_image(rows, image_columns(len(rows)))


def wet_files(dry: Float32[np.ndarray, "n k 3"], wet: Float32[np.ndarray, "n k 3"]) -> dict[str, bytes]:
    """Soaked colors of Gaussians as a description and lossless images, in the order of a SOG file with the dry ones.

    Base colors are differences of steps from the dry colors, as the SOG file has them, modulo 256; the rest are those
    of a SOG file, with a smaller palette.
    """
    codebook, codes = coded(dry[:, 0], CODES)
    steps_of_code = _wet_steps(np.array(codebook))
    differences = (_wet_steps(wet[:, 0]) - steps_of_code[codes]).astype(np.uint8)
    meta: dict[str, Any] = {
        "sh0": {
            "codebook": (((np.arange(256) / WET_STEPS - 1) - 0.5) / SH_C0).tolist(),
            "dry_steps": steps_of_code.tolist(),
            "files": ["sh0.webp"],
        }
    }
    files = {"sh0.webp": lossless_image(differences, image_columns(len(dry)))}
    if wet.shape[1] > 1:
        meta["shN"], harmonics = encode_harmonics(wet, _WET_PALETTE)
        files |= harmonics
    return {**files, "meta.json": json.dumps(meta).encode()}


def _wet_steps(base: Float[np.ndarray, "*n"]) -> Int64[np.ndarray, "*n"]:
    """Numbers of base colors, given as harmonics of degree 0."""
    return np.clip(np.rint((base * SH_C0 + 1.5) * WET_STEPS), 0, 255).astype(np.int64)


def _label_image(labels: Int64[np.ndarray, " n"]) -> bytes:
    pixels = np.zeros((-(-len(labels) // COLUMNS) * COLUMNS, 3), np.uint8)
    pixels[: len(labels), 0], pixels[: len(labels), 1] = labels & 255, labels >> 8
    file = io.BytesIO()
    Image.fromarray(pixels.reshape(-1, COLUMNS, 3)).save(file, "WEBP", lossless=True)
    return file.getvalue()
