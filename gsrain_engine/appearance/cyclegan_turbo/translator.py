"""Transfer `cyclegan-turbo`: runs the network over views, with resizing, tiling and a time estimate."""

import logging
import math
import time
from collections.abc import Container, Iterator, Sequence
from contextlib import nullcontext
from importlib import import_module
from typing import Any

import cv2
import msgspec
import numpy as np
from jaxtyping import Float, Float32, UInt8
from PIL import Image as PillowImage

from ..base import ClearView, FramedView, NetworkInput, RainyView, TransferSettings, follow_training
from ..correspondence import correspondence
from ..normals import NormalEstimator, normals_to_gray, open_estimator
from . import cross_view_attention as attention
from .cross_view_attention import AttendingView, CrossViewExchange, TileWindow
from .model import CycleGanTurbo
from .pretrained import open_model
from .weight_paths import find_transfer_weights, read_record

torch: Any = import_module("torch")
Tensor = Any
_LEVELS = 8  # the UNet halves its latent three times; tiles must start at its coarsest tokens
_STRETCHED_PX = 512  # side of stretched pictures for weights without a record, as in the paper
_MIN_MATCHED = 0.02  # least share of a view's pixels that match another view for it to attend to that view
WITHOUT_POSE = "no attention between views: it is not known where their cameras stood"
NO_OVERLAP = "no attention between views: no other one is known to show the same place"
"""Notes on skipped attention, for views without neighbors."""

log = logging.getLogger(__name__)
Image = Float32[np.ndarray, "_ _ c"]


class CycleGanTurboTransfer:
    """The paper's transfer: one step of a fine-tuned SD-Turbo, guided by normals, with mutual self-attention."""

    name = "cyclegan-turbo"

    def __init__(
        self,
        model: CycleGanTurbo,
        settings: TransferSettings | None = None,
        estimator: NormalEstimator | None = None,
        px_per_token: Container[int] = attention.PX_PER_TOKEN,
    ) -> None:
        """Take a model with its weights, on its final device and in its final precision.

        The estimator is needed if `settings.normals` is neither "depth" nor "none"; `px_per_token` are widths of the
        tokens that attend to other views. Raises ValueError if the settings contradict the training of the weights.
        """
        self.model, self.estimator = model, estimator
        self.settings = follow_training(settings or TransferSettings(), model.record, "the weights")
        self._px_per_token = px_per_token
        weight = model.unet.conv_out.weight
        self._device, self._dtype = weight.device, weight.dtype
        self._has_warned = False

    def network_input(self, view: ClearView) -> NetworkInput:
        """Describe the network's input for a view."""
        windows, settings = self._windows(view), self.settings
        height, width = windows[0].frame
        guided = self.model.takes_guides and settings.normals != "none"
        return NetworkInput(
            network_px=(width, height), framing=settings.framing or "", tiles=len(windows),
            normals=settings.normals or "" if guided else "none",
            conditioning=settings.guide or "" if guided else "none",
        )  # fmt: skip

    def transferred(self, views: Sequence[ClearView]) -> Iterator[RainyView]:
        """Yield rainy views in the plan's order; see `Transfer`. Holds only views that later ones attend to."""
        neighbours = self.settings.neighbours if self.settings.mutual_attention else 0
        steps = attention.attention_plan(views, neighbours)
        last_use = attention.last_uses(steps)
        held: dict[int, ClearView] = {}
        unet, unchanged = self.model.unet, nullcontext(None)
        with attention.cross_view_attention(unet, self._px_per_token) if last_use else unchanged as exchange:
            for number, step in enumerate(steps):
                view = held[step.view] = views[step.view]
                if not number:
                    self._log_duration(view, len(views))
                found = [(source, correspondence(view, held[source])) for source in step.sources]
                sources = tuple(each for each in found if each[1].valid.mean() >= _MIN_MATCHED)
                attending = AttendingView(step.view, sources, step.view in last_use)
                left_out = ""
                if neighbours and len(views) > 1 and not sources and not attending.is_source:
                    left_out = NO_OVERLAP if view.has_pose else WITHOUT_POSE
                image, framed = self._image(view, attending, exchange)
                yield RainyView(view, image, left_out=left_out, framed=framed)
                over = {index for index in held if last_use.get(index, -1) <= number}
                for index in over:
                    del held[index]
                if exchange is not None:
                    exchange.maps.forget(over)

    def _log_duration(self, view: ClearView, count: int) -> None:
        if self.model.architecture.name == "tiny":
            return
        windows, mutual = self._windows(view), self.settings.mutual_attention
        one = estimated_seconds(windows[0].width, windows[0].height, str(self._device), self._dtype, mutual)
        seconds = count * len(windows) * one
        log.info("%s: %d views will take about %.0f s on %s", self.name, count, seconds, self._device)

    def _image(
        self, view: ClearView, attending: AttendingView, exchange: CrossViewExchange | None
    ) -> tuple[Image, FramedView]:
        """Translate a view, tile by tile; returns display color, 0..1, and the network's input."""
        windows = self._windows(view)
        picture, guide = self._resized(view.image, *windows[0].frame), self._guide(view, *windows[0].frame)
        parts: list[Image] = []
        for window in windows:
            pixels = self._tensor(2 * picture[window.slices] - 1)
            guides = None if guide is None else self._tensor(guide[window.slices])
            mutual = nullcontext() if exchange is None else exchange.during(attending, window)
            with mutual, torch.inference_mode():
                found = self.model.translate(pixels, guides, "a2b")[0].float().permute(1, 2, 0).cpu().numpy()
            parts.append(np.clip((found + 1) / 2, 0, 1).astype(np.float32))
        made = blend_tiles(parts, windows)
        gray = None if guide is None else _bytes((guide[..., 0] + 1) / 2)
        framed = FramedView(self.network_input(view), _bytes(picture), gray)
        if self.settings.framing == "stretch":
            return np.clip(stretched(made, *view.image.shape[:2]), 0, 1), framed
        return restore_size(made, picture, view.image), framed

    def _resized(self, image: Image, height: int, width: int) -> Image:
        return (stretched if self.settings.framing == "stretch" else resized)(image, height, width)

    def _windows(self, view: ClearView) -> tuple[TileWindow, ...]:
        """Windows of a clear image for the network: one piece or tiles."""
        settings, multiple = self.settings, self.model.architecture.side_multiple
        height, width = view.camera.height, view.camera.width
        if settings.framing == "stretch":
            record, side = self.model.record, settings.side_px or _STRETCHED_PX
            sides = (side, side) if record is None else (record.height_px, record.width_px)
            return (TileWindow.whole(*(max(round(each / multiple), 1) * multiple for each in sides)),)
        frame = frame_size(height, width, settings.side_px, multiple)
        if settings.tile_px is None or max(frame) <= settings.tile_px:
            return (TileWindow.whole(*frame),)
        multiple *= _LEVELS
        frame = frame_size(height, width, settings.side_px, multiple)
        return split_into_tiles(*frame, settings.tile_px, multiple)

    def _guide(self, view: ClearView, height: int, width: int) -> Float32[np.ndarray, "h w 1"] | None:
        if self.settings.normals == "none" or not self.model.takes_guides:
            return None
        normals = view.normals if self.estimator is None else self.estimator.normals(view.image, view.camera)
        if not normals.any() and not self._has_warned:
            log.warning("%s: nothing tells its normals; a network can (normals: dsine, marigold)", view.name)
            self._has_warned = True
        gray = normals_to_gray(normals, view.camera, self.settings.guide or "up")
        return np.clip(resized(gray[..., None], height, width), -1, 1)

    def _tensor(self, values: Image) -> Tensor:
        """Batch (1, c, h, w) of one image."""
        channels = torch.from_numpy(np.ascontiguousarray(values.transpose(2, 0, 1), np.float32))
        return channels[None].to(self._device, self._dtype)


def _bytes(values: Float32[np.ndarray, "h w ..."]) -> UInt8[np.ndarray, "h w ..."]:
    return np.rint(np.clip(values, 0, 1) * np.float32(255)).astype(np.uint8)


def open_cyclegan_turbo(settings: TransferSettings) -> CycleGanTurboTransfer:
    """Load SD-Turbo with transfer weights from disk, and the normal estimator if one is needed.

    Raises FileNotFoundError with download instructions, and ValueError for files and settings that don't fit each
    other.
    """
    weights = settings.weights or find_transfer_weights()
    if (record := read_record(weights)) is not None:  # a contradiction is told before anything large is read
        settings = follow_training(settings, record, weights)
    model = open_model(weights, settings.base, normals=settings.normals != "none", override=settings.override)
    settings = follow_training(settings, model.record, weights)
    uses_normals = settings.normals != "none"
    if uses_normals and model.guide == "mask":
        raise ValueError(f"{weights}: its fourth channel takes a mask of classes, not normals: run it without normals")
    if uses_normals and not model.guide:
        log.info("%s: trained without normals, which are left out", weights)
    device, estimator = chosen_device(settings.device), None
    if model.record is not None:
        log.info("%s: trained with %s", weights, model.record.words)
    if model.guide and settings.normals in ("dsine", "marigold"):
        estimator = open_estimator(settings.normals, settings.normals_weights, settings.normals_checkout, device)
    if not model.guide:
        settings = msgspec.structs.replace(settings, normals="none", override=True)
    return CycleGanTurboTransfer(model.to(device, getattr(torch, settings.precision)), settings, estimator)


def chosen_device(name: str) -> str:
    """Return "cpu" or "cuda"; "auto" prefers a GPU. Raises ValueError for "cuda" without a GPU."""
    if name == "auto":
        return "cuda" if torch.cuda.is_available() else "cpu"
    if name == "cuda" and not torch.cuda.is_available():
        raise ValueError("device cuda: torch finds no GPU here")
    return name


# Time estimate: known operation count over the measured speed

_LINEAR, _QUADRATIC = 4.278e12, 0.190e12
"""Floating-point operations of SD-Turbo at 512 x 512 px: the part linear in pixels (convolutions), and the quadratic
one (attention). Counted by torch's FlopCounterMode at 512 and 1024 px."""
_PROBE_CHANNELS, _PROBE_SIDE_PX = 128, 192  # size of the probe, a convolution like those that dominate the autoencoder
_SHARE_OF_PROBE = {"cpu": 0.75, "cuda": 0.6}  # speed of the whole network relative to the probe


def estimated_seconds(width: int, height: int, device: str = "cpu", dtype: Any = None, mutual: bool = False) -> float:
    """Seconds per image of this size in pixels, on this machine under its current load.

    Takes about 0.1 s. Accurate to a factor of 1.5, since memory and other processes matter too. Mutual attention
    doubles the keys, and so the quadratic part.
    """
    pictures = width * height / 512**2
    work = _LINEAR * pictures + _QUADRATIC * pictures**2 * (2 if mutual else 1)
    return work / (measured_speed(device, dtype) * _SHARE_OF_PROBE.get(torch.device(device).type, 0.6))


def measured_speed(device: str = "cpu", dtype: Any = None) -> float:
    """Floating-point operations per second of a 3x3 convolution, the best of three tries."""
    kind = torch.float32 if dtype is None else dtype
    channels, side = _PROBE_CHANNELS, _PROBE_SIDE_PX
    layer = torch.nn.Conv2d(channels, channels, 3, padding=1, device=device, dtype=kind)
    flow = torch.ones(1, channels, side, side, device=device, dtype=kind)
    times: list[float] = []
    with torch.inference_mode():
        for _ in range(4):
            started = time.perf_counter()
            float(layer(flow)[0, 0, 0, 0])  # reading a value waits for a GPU
            times.append(time.perf_counter() - started)
    return 2 * 9 * channels**2 * side**2 / min(times[1:])


def frame_size(height: int, width: int, side_px: int | None, multiple: int) -> tuple[int, int]:
    """Height and width in multiples of `multiple`, with the shorter side about `side_px`; never enlarged.

    Each side is rounded to the nearest multiple, which changes the aspect ratio by less than 1 % at 512 px with
    multiples of 8.
    """
    scale = 1.0 if side_px is None else min(side_px / min(height, width), 1.0)
    rows, columns = (max(round(side * scale / multiple), 1) for side in (height, width))
    return rows * multiple, columns * multiple


def resized(image: Image, height: int, width: int) -> Image:
    """Resize an image (h, w, c): by area if it shrinks, which avoids aliasing, cubic if it grows."""
    if image.shape[:2] == (height, width):
        return image
    shrinks = height <= image.shape[0] and width <= image.shape[1]
    found = cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA if shrinks else cv2.INTER_CUBIC)
    return found.reshape(height, width, image.shape[2]).astype(np.float32)


def stretched(image: Image, height: int, width: int) -> Image:
    """Resize an image (h, w, 3) as img2img-turbo and the training do: Lanczos, proportions changed."""
    if image.shape[:2] == (height, width):
        return image
    channels = [PillowImage.fromarray(image[..., k]).resize((width, height), PillowImage.Resampling.LANCZOS)
                for k in range(image.shape[2])]  # fmt: skip
    return np.stack([np.asarray(each, np.float32) for each in channels], axis=2)


def restore_size(made: Image, small: Image, clear: Image) -> Image:
    """Resize the network's output to the size of the clear image; `small` is the network's input; display, 0..1.

    The detail that `small` lacks is added from the clear image: the top band of a Laplacian pyramid (Burt and Adelson
    1983), since the transfer mostly changes low frequencies.
    """
    height, width = clear.shape[:2]
    large = resized(made, height, width)
    if made.shape != clear.shape:
        large = large + clear - resized(small, height, width)
    return np.clip(large, 0, 1)


OVERLAP_PX = 128  # minimum overlap of neighboring tiles


def split_into_tiles(height: int, width: int, tile_px: int, multiple: int) -> tuple[TileWindow, ...]:
    """Split an image into overlapping windows of at most `tile_px` a side that start at multiples of `multiple`."""
    tall, wide = min(tile_px, height), min(tile_px, width)
    rows, columns = _starts(height, tall, multiple), _starts(width, wide, multiple)
    return tuple(TileWindow(top, left, tall, wide, (height, width)) for top in rows for left in columns)


def blend_tiles(parts: Sequence[Image], windows: Sequence[TileWindow]) -> Image:
    """Blend tiles into one image; where they overlap, each fades out towards its own border."""
    if len(parts) == 1:
        return parts[0]
    frame = windows[0].frame
    total = np.zeros((*frame, parts[0].shape[2]))
    weights = np.zeros((*frame, 1))
    for part, window in zip(parts, windows, strict=True):
        weight = _fade(window.height)[:, None, None] * _fade(window.width)[None, :, None]
        total[window.slices] += weight * part
        weights[window.slices] += weight
    return (total / weights).astype(np.float32)


def _starts(side: int, tile: int, multiple: int) -> list[int]:
    """Start positions of tiles: as few as the overlap allows, spread evenly."""
    if tile >= side:
        return [0]
    # The step is a whole multiple, so starts rounded down to multiples are never farther apart than it.
    step = max((tile - OVERLAP_PX) // multiple, 1) * multiple
    count = math.ceil((side - tile) / step)
    return [(side - tile) * i // count // multiple * multiple for i in range(count)] + [side - tile]


def _fade(side: int) -> Float[np.ndarray, " n"]:
    """Raised cosine from nearly 0 at both ends to 1 within the overlap."""
    ramp = max(min(OVERLAP_PX, side // 2), 1)
    near_end = np.minimum(np.arange(side), np.arange(side)[::-1]) + 0.5
    return 0.5 - 0.5 * np.cos(np.pi * np.minimum(near_end / ramp, 1))
