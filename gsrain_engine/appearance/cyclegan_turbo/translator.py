"""Transfer `cyclegan-turbo`: runs the network over views, with resizing, tiling and a time estimate."""

import logging
import math
import time
from collections.abc import Container, Iterator, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, field
from importlib import import_module
from typing import Any, Literal, NamedTuple

import cv2
import numpy as np
from jaxtyping import Float, Float32

from ..base import ClearView, RainyView, TransferSettings
from ..correspondence import correspondence
from ..normals import GuideKind, NormalEstimator, normals_to_gray, open_estimator
from . import cross_view_attention as attention
from .cross_view_attention import AttentionStep, BatchElement, CrossViewAttention, CrossViewExchange, TileWindow
from .model import CycleGanTurbo
from .pretrained import open_model
from .weight_paths import find_transfer_weights

torch: Any = import_module("torch")
Tensor = Any
_LEVELS = 8  # the UNet halves its latent three times; tiles must start at its coarsest tokens
_MIN_MATCHED = 0.02  # least share of a view's pixels that match another view for it to attend to that view
WITHOUT_POSE = "no attention between views: it is not known where their cameras stood"
NO_OVERLAP = "no attention between views: no other one is known to show the same place"
"""Notes on skipped attention, for views without neighbors."""

log = logging.getLogger(__name__)
Image = Float32[np.ndarray, "_ _ c"]


@dataclass(frozen=True, slots=True, kw_only=True)
class RunSettings:
    """Sizes, guides and neighbors of an inference run."""

    side_px: int | None = 512
    """Shorter side of images for the network, none enlarged; None leaves them as they are. The paper trains at 512."""
    tile_px: int | None = None
    """Side of the overlapping tiles that larger images pass in; None passes them whole."""
    overlap_px: int = 128
    """Minimum overlap of neighboring tiles."""
    detail: bool = True
    """Add the fine detail of the clear image where the network's input is smaller."""
    normals: Literal["depth", "dsine", "marigold", "none"] = "depth"
    """Source of the surface normals: the views' depth, or a network."""
    guide: GuideKind = "up"
    mutual: CrossViewAttention | None = field(default_factory=CrossViewAttention)
    """None lets no view attend to others."""


class CycleGanTurboTransfer:
    """The paper's transfer: one step of a fine-tuned SD-Turbo, guided by normals, with mutual self-attention."""

    name = "cyclegan-turbo"

    def __init__(
        self, model: CycleGanTurbo, settings: RunSettings | None = None, estimator: NormalEstimator | None = None
    ) -> None:
        """Take a model with its weights, on its final device and in its final precision.

        The estimator is needed if `settings.normals` is neither "depth" nor "none".
        """
        self.model, self.settings, self.estimator = model, settings or RunSettings(), estimator
        weight = model.unet.conv_out.weight
        self._device, self._dtype = weight.device, weight.dtype
        self._has_warned = False
        self._count = 0

    def transferred(self, views: Sequence[ClearView]) -> Iterator[RainyView]:
        """Yield rainy views in the plan's order; see `Transfer`. Holds only views that later ones attend to."""
        mutual, self._count = self.settings.mutual, len(views)
        plan = attention.attention_plan(views, mutual)
        last_use = plan.last_use()
        held: dict[int, ClearView] = {}
        uses = mutual if last_use else None
        with nullcontext() if uses is None else attention.cross_view_attention(self.model.unet, uses) as exchange:
            for number, step in enumerate(plan.steps):
                held.update({index: views[index] for index in step.views})
                if not number:
                    self._log_duration(held[step.views[0]], len(views))
                yield from self._step(held, step, last_use, exchange)
                over = {index for index in held if last_use.get(index, -1) <= number}
                for index in over:
                    del held[index]
                if exchange is not None:
                    exchange.maps.forget(over)

    def _log_duration(self, view: ClearView, count: int) -> None:
        if self.model.architecture.name == "tiny":
            return
        windows, mutual = self._windows(view), self.settings.mutual is not None
        one = estimated_seconds(windows[0].width, windows[0].height, str(self._device), self._dtype, mutual)
        seconds = count * len(windows) * one
        log.info("%s: %d views will take about %.0f s on %s", self.name, count, seconds, self._device)

    def _step(
        self, held: dict[int, ClearView], step: AttentionStep, used: Container[int], exchange: CrossViewExchange | None
    ) -> Iterator[RainyView]:
        mutual = self.settings.mutual
        entries: list[_Entry] = []
        inputs: list[tuple[ClearView, Image, tuple[TileWindow, ...], str]] = []
        for index, sources in zip(step.views, step.sources, strict=True):
            view = held[index]
            windows = self._windows(view)
            picture, guide = resized(view.image, *windows[0].frame), self._guide(view, *windows[0].frame)
            found = ((source, correspondence(view, held[source])) for source in sources)
            places = tuple(each for each in found if each[1].valid.mean() >= _MIN_MATCHED)
            left_out = ""
            if mutual is not None and mutual.neighbours and self._count > 1 and not places and index not in used:
                left_out = NO_OVERLAP if view.has_pose else WITHOUT_POSE
            inputs.append((view, picture, windows, left_out))
            for window in windows:
                element = BatchElement(index, window, places, index in used)
                part = None if guide is None else guide[window.slices]
                entries.append(_Entry(picture[window.slices], part, element))
        # Views of one step may attend to each other in every layer; tiles of one view never do.
        size = len(entries) if len(step.views) > 1 else 1
        made: list[Image] = []
        for start in range(0, len(entries), size):
            made += self._made(entries[start : start + size], exchange)
        for view, picture, windows, left_out in inputs:
            parts, made = made[: len(windows)], made[len(windows) :]
            small = blend_tiles(parts, windows, self.settings.overlap_px)
            yield RainyView(view, restore_size(small, picture, view.image, self.settings.detail), left_out=left_out)

    def _made(self, entries: Sequence["_Entry"], exchange: CrossViewExchange | None) -> list[Image]:
        """Run entries of one size through the network as a batch; display color, 0..1."""
        pictures = torch.stack([self._tensor(2 * each.picture - 1) for each in entries])
        known = [each.guide for each in entries if each.guide is not None]
        guides = torch.stack([self._tensor(each) for each in known]) if len(known) == len(entries) else None
        announced = nullcontext() if exchange is None else exchange.batch([each.element for each in entries])
        with announced, torch.inference_mode():
            found = self.model.translate(pictures, guides, "a2b").float().permute(0, 2, 3, 1).cpu().numpy()
        return [np.clip((each + 1) / 2, 0, 1).astype(np.float32) for each in found]

    def _windows(self, view: ClearView) -> tuple[TileWindow, ...]:
        """Windows of a clear image for the network: one piece or tiles."""
        settings, multiple = self.settings, self.model.architecture.side_multiple
        height, width = view.camera.height, view.camera.width
        frame = frame_size(height, width, settings.side_px, multiple)
        if settings.tile_px is None or max(frame) <= settings.tile_px:
            return (TileWindow.whole(*frame),)
        multiple *= _LEVELS
        frame = frame_size(height, width, settings.side_px, multiple)
        return split_into_tiles(*frame, settings.tile_px, settings.overlap_px, multiple)

    def _guide(self, view: ClearView, height: int, width: int) -> Float32[np.ndarray, "h w 1"] | None:
        if self.settings.normals == "none" or not self.model.takes_guides:
            return None
        normals = view.normals if self.estimator is None else self.estimator.normals(view.image, view.camera)
        if not normals.any() and not self._has_warned:
            log.warning("%s: nothing tells its normals; a network can (normals: dsine, marigold)", view.name)
            self._has_warned = True
        gray = normals_to_gray(normals, view.camera, self.settings.guide)
        return np.clip(resized(gray[..., None], height, width), -1, 1)

    def _tensor(self, values: Image) -> Tensor:
        channels = torch.from_numpy(np.ascontiguousarray(values.transpose(2, 0, 1), np.float32))
        return channels.to(self._device, self._dtype)


class _Entry(NamedTuple):
    picture: Image
    guide: Image | None
    element: BatchElement


def open_cyclegan_turbo(settings: TransferSettings) -> CycleGanTurboTransfer:
    """Load SD-Turbo with transfer weights from disk, and the normal estimator if one is needed.

    Raises FileNotFoundError with download instructions, and ValueError for files and settings that don't fit each
    other.
    """
    weights = settings.weights or find_transfer_weights()
    uses_normals = settings.normals != "none"
    model = open_model(weights, settings.base, normals=uses_normals)
    if uses_normals and model.guide == "mask":
        raise ValueError(f"{weights}: its fourth channel takes a mask of classes, not normals: run it without normals")
    if uses_normals and not model.guide:
        log.info("%s: trained without normals, which are left out", weights)
    device, estimator = chosen_device(settings.device), None
    if model.guide and settings.normals in ("dsine", "marigold"):
        estimator = open_estimator(settings.normals, settings.normals_weights, settings.normals_checkout, device)
    run = RunSettings(
        side_px=settings.side_px, tile_px=settings.tile_px, guide=settings.guide,
        normals=settings.normals if model.guide else "none",
        mutual=CrossViewAttention(neighbours=settings.neighbours) if settings.mutual_attention else None,
    )  # fmt: skip
    model = model.to(device, getattr(torch, settings.precision))
    return CycleGanTurboTransfer(model, run, estimator)


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


def restore_size(made: Image, small: Image, clear: Image, detail: bool) -> Image:
    """Resize the network's output to the size of the clear image; `small` is the network's input; display, 0..1.

    With `detail`, the detail that `small` lacks is added from the clear image: the top band of a Laplacian pyramid
    (Burt and Adelson 1983), since the transfer mostly changes low frequencies.
    """
    height, width = clear.shape[:2]
    large = resized(made, height, width)
    if detail and made.shape != clear.shape:
        large = large + clear - resized(small, height, width)
    return np.clip(large, 0, 1)


def split_into_tiles(height: int, width: int, tile_px: int, overlap_px: int, multiple: int) -> tuple[TileWindow, ...]:
    """Split an image into overlapping windows of at most `tile_px` a side that start at multiples of `multiple`."""
    tall, wide = min(tile_px, height), min(tile_px, width)
    rows, columns = _starts(height, tall, overlap_px, multiple), _starts(width, wide, overlap_px, multiple)
    return tuple(TileWindow(top, left, tall, wide, (height, width)) for top in rows for left in columns)


def blend_tiles(parts: Sequence[Image], windows: Sequence[TileWindow], overlap_px: int) -> Image:
    """Blend tiles into one image; where they overlap, each fades out towards its own border."""
    if len(parts) == 1:
        return parts[0]
    frame = windows[0].frame
    total = np.zeros((*frame, parts[0].shape[2]))
    weights = np.zeros((*frame, 1))
    for part, window in zip(parts, windows, strict=True):
        weight = _fade(window.height, overlap_px)[:, None, None] * _fade(window.width, overlap_px)[None, :, None]
        total[window.slices] += weight * part
        weights[window.slices] += weight
    return (total / weights).astype(np.float32)


def _starts(side: int, tile: int, overlap: int, multiple: int) -> list[int]:
    """Start positions of tiles: as few as the overlap allows, spread evenly."""
    if tile >= side:
        return [0]
    # The step is a whole multiple, so starts rounded down to multiples are never farther apart than it.
    step = max((tile - overlap) // multiple, 1) * multiple
    count = math.ceil((side - tile) / step)
    return [(side - tile) * i // count // multiple * multiple for i in range(count)] + [side - tile]


def _fade(side: int, overlap: int) -> Float[np.ndarray, " n"]:
    """Raised cosine from nearly 0 at both ends to 1 within the overlap."""
    ramp = max(min(overlap, side // 2), 1)
    near_end = np.minimum(np.arange(side), np.arange(side)[::-1]) + 0.5
    return 0.5 - 0.5 * np.cos(np.pi * np.minimum(near_end / ramp, 1))
