"""Which two pictures an iteration learns from, and its random numbers: all from the seed and its number alone."""

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
    """A clear and a rainy picture of different places: batches of one, (1, 3, h, w) in -1..1; guides (1, 1, h, w)."""

    clear: Tensor
    rainy: Tensor
    clear_guide: Tensor | None
    rainy_guide: Tensor | None


class PairSampler:
    """Pairs of an endless training: each set goes round in ever new orders, so that no place always meets another.

    Nothing is remembered from one iteration to the next: a training that is taken up again goes on as it would have.
    """

    def __init__(self, pictures: UnpairedImages, seed: int, guided: bool, device: str) -> None:
        self.pictures = pictures
        self._seed, self._guided, self._device = seed, guided, device

    def pair(self, iteration: int) -> UnpairedSample:
        clear, clear_guide = self.read(self._chosen(self.pictures.source, iteration, 0))
        rainy, rainy_guide = self.read(self._chosen(self.pictures.target, iteration, 1))
        return UnpairedSample(clear, rainy, clear_guide, rainy_guide)

    def generator(self, iteration: int) -> Any:
        """Random numbers of an iteration, drawn on the processor."""
        return torch.Generator().manual_seed(self._seed * 1_000_003 + iteration)

    def read(self, picture: DatasetImage) -> tuple[Tensor, Tensor | None]:
        """Read one picture and its guide, as batches of one.

        A picture without a guide has one of zeros: the encoder's new columns add nothing then. Where only one of the
        two looks has guides, a model can tell them apart by that; better give normals to both.
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
    """Tell sets of pictures apart by their names and sizes, in a line that a person can read."""
    names = "\n".join(f"{each.name} {each.width} {each.height}" for each in (*pictures.source, *pictures.target))
    return f"{len(pictures.source)} clear, {len(pictures.target)} rainy, {zlib.crc32(names.encode()):08x}"
