"""Photographs in rain: streaks before the picture, and a medium by the distances of what it shows."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import product
from typing import Any, NamedTuple

import lazy_loader
import msgspec
import numpy as np
from jaxtyping import Bool, Float32, UInt8

from ..rain.frame import RainFrame
from ..rain.medium import RainMedium
from ..scene.camera import Camera
from ..scene.geometry import linear_to_srgb, srgb_to_linear
from .guided_filter import color_guided_fit

cv2: Any = lazy_loader.load("cv2")  # only photographs need it

Colors = UInt8[np.ndarray, "h w 3"]
Plane = Float32[np.ndarray, "h w"]

_GUIDED_SHARE, _GUIDED_SPREAD = 1 / 16, 2e-3**0.5  # radius over the width; deviation of colors (0..1) that is an edge
_AROUND_PX, _ALIKE, _FADED = 3, 0.03, 0.2
"""Reach of a measured distance in pixels of the distances, deviation of colors (0..1) that are one thing, and weight
of nothing known."""
_BAND_ROWS = 32  # rows of a picture that are mixed at a time, in the processor's cache
_MIN_AHEAD = 0.1  # cosine of a ray to the axis: beyond 84 degrees, distances of the picture's edge go on


@dataclass(frozen=True, slots=True, eq=False)
class Distances:
    """Distances of what a photograph shows."""

    camera: Camera
    """Camera without lens distortion, of any size."""
    depth_m: Float32[np.ndarray, "_ _"]
    """Depth along the view axis; 0 in the sky."""
    measured: Bool[np.ndarray, "_ _"] | None = None
    """Pixels whose depth is measured; the others are completed. None for an assumed level road."""

    @property
    def are_assumed(self) -> bool:
        return self.measured is None

    def transmittance(self, medium: RainMedium, camera: Camera, photo: Colors) -> Plane:
        """Share of light that each pixel of a photograph and its camera keeps in the medium.

        It follows the edges of the photograph in place of those between measured distances, by the guided filter (He,
        Sun and Tang 2013) fitted in the size of the distances (He and Sun 2015), as haze is estimated from photographs;
        near measured distances it is theirs.
        """
        own, depth = self.camera, self.depth_m
        points = np.dstack([_tangents(own), np.ones_like(depth)]) * depth[..., None]
        near = medium.transmittance(np.maximum(points.reshape(-1, 3), -1e9)).reshape(depth.shape)
        found = np.ascontiguousarray(np.where(depth > 0, near, medium.sky_transmittance(own.rays)), np.float32)
        known = (depth > 0 if self.measured is None else self.measured).astype(np.uint8)
        small = _small_camera(camera, own)
        maps = maps_between(small, own)
        bent = cv2.remap(found, *maps, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        measured = cv2.remap(known, *maps, cv2.INTER_NEAREST, borderMode=cv2.BORDER_REPLICATE) > 0
        size = small.width, small.height
        guide = np.asarray(cv2.resize(photo, size, interpolation=cv2.INTER_AREA), np.float32) / np.float32(255)
        fit = color_guided_fit(bent, guide, max(round(_GUIDED_SHARE * small.width), 1), _GUIDED_SPREAD)
        # The filter lets the far into the near: what is measured to be nearer keeps more.
        error = _spread(np.maximum(bent - fit.at(_planes(guide)), 0), measured, guide)
        channels = [each.astype(np.float32) / np.float32(255) for each in _planes(photo)]
        smooth = fit.at(channels) + cv2.resize(error, (camera.width, camera.height))
        return np.clip(smooth, found.min(), found.max())


class PhotoLight(NamedTuple):
    """Light of a photograph as it is drawn: its own, or softened to that of an overcast day."""

    kept: str = "as it is"
    """Reason why it is the photograph's own; empty if it is softened."""
    sun: float = 0.0
    """Confidence that the sun shines, 0 to 1, by which it is softened."""

    @property
    def is_softened(self) -> bool:
        return not self.kept

    @property
    def kind(self) -> str:
        """Words for all photographs with which the same was done."""
        return f"kept ({self.kept})" if self.kept else "softened to overcast"

    @property
    def words(self) -> str:
        """Words for it."""
        return f"{self.kind} (sun {self.sun:.2f})" if self.is_softened else self.kind


AS_TAKEN = PhotoLight()


def light_words(counts: Mapping[str, int]) -> str:
    """Return what was done to the light of photographs, by the number of them for each kind of a `PhotoLight`."""
    if len(counts) == 1:
        return next(iter(counts))
    return ", ".join(f"{count} {kind}" for kind, count in sorted(counts.items(), key=lambda each: (-each[1], each[0])))


@dataclass(frozen=True, slots=True, eq=False)
class Photograph:
    """Photograph (sRGB) behind rain."""

    pixels: UInt8[np.ndarray, "h w 3"]
    """In the light in which it is drawn."""
    distances: Distances
    light: PhotoLight = AS_TAKEN

    def in_rain(self, falling: RainFrame, share: Float32[np.ndarray, "h w 1"]) -> UInt8[np.ndarray, "h w 3"]:
        """Return the photograph B behind drops that cover a share W of each pixel: (1 - W) (T B + (1 - T) A) + W S.

        T is the medium's transmittance up to each pixel, A its airlight and S the light of a drop; in linear light if
        that is how the rain adds its own.
        """
        encode, decode = (linear_to_srgb, srgb_to_linear) if falling.is_linear else (np.asarray, np.asarray)
        light, drop = decode(np.arange(256) / 255).astype(np.float32), decode(falling.color).astype(np.float32)
        air, kept = np.zeros(3, np.float32), None
        if falling.medium is not None:
            air = decode(falling.airlight).astype(np.float32)
            kept = self.distances.transmittance(falling.medium, falling.view.camera, self.pixels)[..., None]
        out = np.empty_like(self.pixels)
        for top in range(0, len(out), _BAND_ROWS):
            rows = slice(top, top + _BAND_ROWS)
            mixed = np.asarray(cv2.LUT(self.pixels[rows], light))
            if kept is not None:
                mixed = air + kept[rows] * (mixed - air)
            mixed += share[rows] * (drop - mixed)
            out[rows] = np.rint(np.clip(encode(mixed), 0, 1) * 255)
        return out


def without_medium(falling: RainFrame) -> RainFrame:
    """The drops and the haze Gaussians of a rain, without its medium."""
    far = "none" if falling.rain.haze == "medium" else falling.rain.haze
    return replace(
        falling, rain=msgspec.structs.replace(falling.rain, haze=far, visibility_m=None), fog_extinction_per_m=0.0
    )


def widened(picture: UInt8[np.ndarray, "h w 3"], camera: Camera, wide: Camera) -> UInt8[np.ndarray, "rows columns 3"]:
    """Return a picture as a wide camera of the same pose has it, mirrored at its edges: nothing is known beyond."""
    columns = (np.arange(wide.width, dtype=np.float32) + np.float32(0.5 - wide.cx)) / np.float32(wide.fx)
    rows = (np.arange(wide.height, dtype=np.float32) + np.float32(0.5 - wide.cy)) / np.float32(wide.fy)
    x, y = columns * np.float32(camera.fx) + camera.cx - 0.5, rows * np.float32(camera.fy) + camera.cy - 0.5
    # Averaged before it is sampled: a wide view has few pixels.
    step = max(round(camera.fx / wide.fx), 1)
    smooth = cv2.blur(picture, (step, step), borderType=cv2.BORDER_REFLECT) if step > 1 else picture
    maps = np.meshgrid(x.astype(np.float32), y.astype(np.float32))
    return cv2.remap(smooth, *maps, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT)


def _tangents(camera: Camera) -> Float32[np.ndarray, "h w 2"]:
    """Tangents x / z and y / z of the rays of a camera's pixels."""
    directions = camera.rays.directions
    return directions[..., :2] / np.maximum(directions[..., 2:], np.float32(_MIN_AHEAD))


def maps_between(camera: Camera, source: Camera) -> tuple[Plane, Plane]:
    """Column and row in the picture of a source, at the same place, of each pixel of a camera (first center at 0)."""
    tangents = _tangents(camera)
    ahead = np.dstack([tangents, np.ones(tangents.shape[:2], np.float32)]).reshape(-1, 3)
    places = np.nan_to_num(source.pixels(ahead), nan=-1e6).reshape(*tangents.shape) - 0.5
    return places[..., 0].astype(np.float32), places[..., 1].astype(np.float32)


def _small_camera(camera: Camera, source: Camera) -> Camera:
    """Camera with the picture of another one, at most as wide as that of a source."""
    share = min(source.width / camera.width, 1.0)
    width, height = (max(round(share * each), 1) for each in (camera.width, camera.height))
    x, y = width / camera.width, height / camera.height
    return replace(
        camera, width=width, height=height, fx=camera.fx * x, fy=camera.fy * y, cx=camera.cx * x, cy=camera.cy * y
    )


def _planes(image: np.ndarray) -> list[np.ndarray]:
    return [np.ascontiguousarray(image[..., i]) for i in range(3)]


def _spread(error: Plane, known: Bool[np.ndarray, "h w"], colors: Float32[np.ndarray, "h w 3"]) -> Plane:
    """Mean of the known errors around each pixel, of those with its color; it fades where none is known."""
    total, weights = np.zeros_like(error), np.full_like(error, _FADED)
    around = range(-_AROUND_PX, _AROUND_PX + 1)
    known_error = np.where(known, error, np.float32(0))
    for dy, dx in product(around, around):
        move = np.array([[1, 0, dx], [0, 1, dy]], np.float32)
        size = error.shape[1], error.shape[0]
        moved, there, other = (
            cv2.warpAffine(each, move, size, flags=cv2.INTER_NEAREST)
            for each in (known_error, known.astype(np.float32), colors)
        )
        red, green, blue = cv2.split((colors - other) ** 2)
        far = red + green + blue
        weight = there * np.exp(-far / (2 * _ALIKE**2) - (dx * dx + dy * dy) / (2 * (_AROUND_PX / 2) ** 2))
        total += weight * moved
        weights += weight
    return (total / weights).astype(np.float32)
