"""Deterministic sampler of unpaired images: pairs and random numbers follow from seed and iteration alone."""

import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import import_module
from typing import Any

import numpy as np

from .dataset import DatasetImage, UnpairedImages

torch: Any = import_module("torch")
Tensor = Any


@dataclass(frozen=True, slots=True, eq=False)
class UnpairedSample:
    """Clear and rainy image of different places: batches of one, (1, 3, h, w) in -1..1; guides (1, 1, h, w)."""

    clear: Tensor
    rainy: Tensor
    clear_guide: Tensor | None
    rainy_guide: Tensor | None


class PairSampler:
    """Endless pairs: each set is shuffled anew in every epoch, so that pairs change.

    It has no state, so a resumed training continues as if never interrupted.
    """

    def __init__(self, pictures: UnpairedImages, seed: int, guided: bool, device: str) -> None:
        self.pictures = pictures
        self._seed, self._guided, self._device = seed, guided, device

    def pair(self, iteration: int) -> UnpairedSample:
        clear, clear_guide = self.read(self._chosen(self.pictures.source, iteration, 0))
        rainy, rainy_guide = self.read(self._chosen(self.pictures.target, iteration, 1))
        return UnpairedSample(clear, rainy, clear_guide, rainy_guide)

    def generator(self, iteration: int) -> Any:
        """Random numbers of an iteration, drawn on the CPU."""
        return torch.Generator().manual_seed(self._seed * 1_000_003 + iteration)

    def read(self, picture: DatasetImage) -> tuple[Tensor, Tensor | None]:
        """Read one image and its guide, as batches of one.

        A missing guide becomes zeros, to which the encoder's new columns add nothing. If only one of the two looks has
        guides, a model can tell the looks apart by them, so better give both looks normals.
        """
        image, guide = picture.read()
        batch = torch.from_numpy(image).permute(2, 0, 1)[None].contiguous().to(self._device) * 2 - 1
        if not self._guided:
            return batch, None
        guide = np.zeros(image.shape[:2], np.float32) if guide is None else guide
        return batch, torch.from_numpy(guide.copy())[None, None].to(self._device)

    def _chosen(self, pictures: Sequence[DatasetImage], iteration: int, which: int) -> DatasetImage:
        turn, place = divmod(iteration, len(pictures))
        return pictures[int(np.random.default_rng((self._seed, which, turn)).permutation(len(pictures))[place])]


def fingerprint(pictures: UnpairedImages) -> str:
    """Identify sets of images by names and sizes, in a readable line."""
    names = "\n".join(f"{each.name} {each.width} {each.height}" for each in (*pictures.source, *pictures.target))
    return f"{len(pictures.source)} clear, {len(pictures.target)} rainy, {zlib.crc32(names.encode()):08x}"
