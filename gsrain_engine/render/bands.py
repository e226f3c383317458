"""Pictures of any size and number of samples, drawn in bands of rows that fit into memory and graphics cards."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from jaxtyping import Float32, UInt8

from ..choices import RenderMode
from ..rain.frame import RainFrame
from ..scene.camera import Camera
from ..scene.scene import DrawItem
from ..water.mirror import SCALES, LensMirror, Mirror
from .cpu.tiles import TILE
from .renderer import Color, Frame, PendingImage, Renderer

MAX_SAMPLES = 1 << 23
"""Samples that are drawn at once, a little more than a picture of 3840x2160 has: 128 MiB of floats."""


class PictureBands:
    """Draws pictures in bands, each of which is averaged to pixels before the next one is drawn.

    A band is projected as a part of the whole picture, so that no seam shows. Pictures through lenses and rolling
    shutters, which have tables of rays, are drawn at once.
    """

    def __init__(self, renderer: Renderer, supersampling: int = 1) -> None:
        """`supersampling` is the number of rows and of columns of samples in a pixel of `frame`."""
        self._renderer, self._side = renderer, supersampling
        self._frame: Frame | None = None

    def read(self) -> Frame:
        """Return the last picture."""
        assert self._frame is not None, "draw before reading the picture"
        return self._frame

    def read_uint8(self, background: Color = (0.0, 0.0, 0.0)) -> UInt8[np.ndarray, "h w 3"]:
        return self.read().to_uint8(background)

    def request_uint8(self, background: Color = (0.0, 0.0, 0.0)) -> PendingImage:
        return partial(self.read().to_uint8, background)

    def draw(
        self,
        parts: Sequence[DrawItem],
        camera: Camera,
        rain: RainFrame | None = None,
        *,
        with_depth: bool = False,
        mode: RenderMode = "splats",
        mirror: Mirror | LensMirror | None = None,
    ) -> None:
        """Draw and read a picture as `Renderer.draw` does; `camera` has all samples.

        Depth is that of samples: ask for it without supersampling. Raises `MemoryError` if a band has no room.
        """
        frames = list[Frame]()
        for top, rows in bands_of(camera, self._side):
            is_whole = rows == camera.height
            band = camera if is_whole else camera.band(top, rows)
            falling = rain if rain is None or is_whole else _in_band(rain, band)
            if isinstance(mirror, Mirror) and not is_whole:
                reflected = replace(mirror, first_row=mirror.first_row - round(SCALES[1] * top))
            else:
                reflected = mirror
            self._renderer.draw(parts, band, falling, with_depth=with_depth, mode=mode, mirror=reflected)
            frame = self._renderer.read()
            frames.append(replace(frame, rgba=_averaged(frame.rgba, self._side)))
        if len(frames) == 1:
            self._frame = frames[0]
            return
        depths = [each.depth for each in frames if each.depth is not None]
        rgba = np.concatenate([each.rgba for each in frames])
        self._frame = Frame(rgba, np.concatenate(depths) if depths else None)


def has_one_band(camera: Camera) -> bool:
    """Return whether a picture is small enough for one drawing."""
    return len(list(bands_of(camera))) == 1


def bands_of(camera: Camera, supersampling: int = 1) -> Iterator[tuple[int, int]]:
    """First row and number of rows of each band, in whole tiles and whole pixels of samples."""
    step = TILE * supersampling
    rows = max(MAX_SAMPLES // (camera.width * step), 1) * step if camera.is_pinhole else camera.height
    for top in range(0, camera.height, rows):
        yield top, min(rows, camera.height - top)


def _in_band(rain: RainFrame, band: Camera) -> RainFrame:
    """The same rain before a band of its camera's picture."""
    return replace(rain, view=replace(rain.view, camera=band), shutter=replace(rain.shutter, camera=band))


def _averaged(samples: Float32[np.ndarray, "h w 4"], side: int) -> Float32[np.ndarray, "rows columns 4"]:
    if side == 1:
        return samples
    height, width = samples.shape[:2]
    return samples.reshape(height // side, side, width // side, side, 4).mean(axis=(1, 3), dtype=np.float32)
