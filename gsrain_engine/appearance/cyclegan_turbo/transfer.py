"""CycleGAN-Turbo as a transfer: clear views go through the network in an order in which neighbours can be looked at."""

import logging
from collections.abc import Container, Iterator, Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from importlib import import_module
from typing import Any

import numpy as np
from jaxtyping import Float32

from gsrain_engine.appearance.attention.exchange import Element, Exchange, exchanging
from gsrain_engine.appearance.attention.plan import Plan, Step, planned
from gsrain_engine.appearance.attention.window import Window
from gsrain_engine.appearance.clear_view import ClearView
from gsrain_engine.appearance.matching.correspondence import correspondence
from gsrain_engine.appearance.normals.estimators import NormalEstimator
from gsrain_engine.appearance.normals.grey_guide import grey_guide
from gsrain_engine.appearance.transfer import RainyView

from .duration import estimated_seconds
from .frames import Picture, blended, brought_back, frame_size, resized, tiles
from .model import CycleGanTurbo
from .settings import RunSettings

torch: Any = import_module("torch")

Tensor = Any

_LEVELS = 8
"""The UNet halves its latent three times: tiles begin where its coarsest tokens do."""

_LEAST_MATCHED = 0.02
"""Share of a view's pixels with a place in another one from which it attends to it."""

WITHOUT_POSE = "no attention between views: it is not known where their cameras stood"
NO_OVERLAP = "no attention between views: no other one is known to show the same place"
"""Notes on what was left out of views that stand by themselves."""

log = logging.getLogger(__name__)


class CycleGanTurboTransfer:
    """The paper's transfer: one step of a fine-tuned SD-Turbo, told surface normals, with mutual self-attention."""

    name = "cyclegan-turbo"

    def __init__(
        self, model: CycleGanTurbo, settings: RunSettings | None = None, estimator: NormalEstimator | None = None
    ) -> None:
        """Take a model with its weights.

        Args:
            model: On the device and in the precision in which it is to run.
            settings: Sizes, guides and neighbours.
            estimator: Tells normals where `settings.normals` is neither "depth" nor "none".
        """
        self.model, self.settings, self.estimator = model, settings or RunSettings(), estimator
        weight = model.unet.conv_out.weight
        self._device, self._dtype = weight.device, weight.dtype
        self._has_warned = False
        self._count = 0

    def transferred(self, views: Sequence[ClearView]) -> Iterator[RainyView]:
        """Make views rainy, in the order of the plan; see `Transfer`. Holds what later views look at, nothing else."""
        mutual, self._count = self.settings.mutual, len(views)
        plan = planned(views, mutual)
        if mutual is None or not plan.last_use():
            yield from self._steps(views, plan, None)
            return
        with exchanging(self.model.unet, mutual) as talk:
            yield from self._steps(views, plan, talk)

    def _steps(self, views: Sequence[ClearView], plan: Plan, talk: Exchange | None) -> Iterator[RainyView]:
        last_use = plan.last_use()
        held: dict[int, ClearView] = {}
        for number, step in enumerate(plan.steps):
            held.update({index: views[index] for index in step.views})
            if not number:
                self._tell_duration(held[step.views[0]], len(views))
            yield from self._step(held, step, last_use, talk)
            over = {index for index in held if last_use.get(index, -1) <= number}
            for index in over:
                del held[index]
            if talk is not None:
                talk.maps.forget(over)

    def seconds_per_view(self, width: int, height: int) -> float:
        """Estimate how long a clear picture of this size in pixels takes here; see `estimated_seconds`."""
        windows = self._windows(width, height)
        one = estimated_seconds(
            windows[0].width, windows[0].height, str(self._device), self._dtype, self.settings.mutual is not None
        )
        return len(windows) * one

    def _tell_duration(self, view: ClearView, count: int) -> None:
        if self.model.architecture.name != "tiny":
            seconds = count * self.seconds_per_view(view.camera.width, view.camera.height)
            log.info("%s: %d views will take about %.0f s on %s", self.name, count, seconds, self._device)

    def _step(
        self, held: dict[int, ClearView], step: Step, is_source: Container[int], talk: Exchange | None
    ) -> Iterator[RainyView]:
        frames = [self._frame(held[index]) for index in step.views]
        entries: list[_Entry] = []
        looks: dict[int, bool] = {}
        for index, sources, frame in zip(step.views, step.sources, frames, strict=True):
            found = ((source, correspondence(held[index], held[source])) for source in sources)
            places = tuple(each for each in found if each[1].valid.mean() >= _LEAST_MATCHED)
            looks[index] = bool(places) or index in is_source
            entries += [
                _Entry(frame, window, Element(index, window, places, index in is_source)) for window in frame.windows
            ]
        # Views of one step may look at each other in every layer; tiles of one view never do.
        size = len(entries) if len(step.views) > 1 else 1
        made: list[Picture] = []
        for start in range(0, len(entries), size):
            made += self._made(entries[start : start + size], talk)
        for index, frame in zip(step.views, frames, strict=True):
            parts, made = made[: len(frame.windows)], made[len(frame.windows) :]
            small = blended(parts, frame.windows, self.settings.overlap_px)
            clear = held[index]
            image = brought_back(small, frame.picture, clear.image, self.settings.detail)
            yield RainyView(clear, image, left_out="" if looks[index] else self._why_alone(clear))

    def _why_alone(self, view: ClearView) -> str:
        """Say why a view attends to no other one and none to it; nothing where that was not asked for."""
        mutual = self.settings.mutual
        if mutual is None or not mutual.neighbours or self._count < 2:
            return ""
        return NO_OVERLAP if view.has_pose else WITHOUT_POSE

    def _made(self, entries: Sequence["_Entry"], talk: Exchange | None) -> list[Picture]:
        """Run entries of one size through the network at once; display colour, 0..1."""
        pictures = torch.stack([self._tensor(2 * _part(e.frame.picture, e.window) - 1) for e in entries])
        guided = self.model.takes_guides and all(e.frame.guide is not None for e in entries)
        guides = torch.stack([self._tensor(_part(e.frame.guide, e.window)) for e in entries]) if guided else None
        announced = nullcontext() if talk is None else talk.batch([e.element for e in entries])
        with announced, torch.inference_mode():
            found = self.model.translate(pictures, guides, "a2b").float().permute(0, 2, 3, 1).cpu().numpy()
        return [np.clip((each + 1) / 2, 0, 1).astype(np.float32) for each in found]

    def _frame(self, view: ClearView) -> "_Frame":
        windows = self._windows(view.camera.width, view.camera.height)
        height, width = windows[0].frame
        guide = self._guide(view)
        return _Frame(
            resized(view.image, height, width),
            None if guide is None else np.clip(resized(guide[..., None], height, width), -1, 1),
            windows,
        )

    def _windows(self, width: int, height: int) -> tuple[Window, ...]:
        """A clear picture of this size as the network takes it: in one piece or in tiles."""
        settings, multiple = self.settings, self.model.architecture.side_multiple
        frame = frame_size(height, width, settings.side_px, multiple)
        if settings.tile_px is None or max(frame) <= settings.tile_px:
            return (Window.whole(*frame),)
        multiple *= _LEVELS
        frame = frame_size(height, width, settings.side_px, multiple)
        return tiles(*frame, settings.tile_px, settings.overlap_px, multiple)

    def _guide(self, view: ClearView) -> Float32[np.ndarray, "h w"] | None:
        if self.settings.normals == "none" or not self.model.takes_guides:
            return None
        normals = view.normals if self.estimator is None else self.estimator.normals(view.image, view.camera)
        if not normals.any() and not self._has_warned:
            log.warning("%s: nothing tells its normals; a network can (normals: dsine, marigold)", view.name)
            self._has_warned = True
        return grey_guide(normals, view.camera, self.settings.guide)

    def _tensor(self, values: Picture) -> Tensor:
        channels = torch.from_numpy(np.ascontiguousarray(values.transpose(2, 0, 1), np.float32))
        return channels.to(self._device, self._dtype)


@dataclass(frozen=True, slots=True, eq=False)
class _Frame:
    picture: Picture
    guide: Float32[np.ndarray, "h w 1"] | None
    windows: tuple[Window, ...]


@dataclass(frozen=True, slots=True, eq=False)
class _Entry:
    frame: _Frame
    window: Window
    element: Element


def _part(values: Picture | None, window: Window) -> Picture:
    assert values is not None
    return values[window.top : window.top + window.height, window.left : window.left + window.width]
