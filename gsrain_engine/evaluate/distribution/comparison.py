"""Two sets of pictures compared as distributions: FID or its like, KID, how sure they are, and what few pictures do."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float32, UInt8

from gsrain_engine.datasets.capture import Capture

from .bootstrap import Interval, frechet_interval, kernel_estimate
from .extractor import Extractor
from .feature_cache import FeatureCache, picture_hash
from .frechet import frechet_distance
from .small_samples import SameDistribution, same_distribution, warning

LEAST_PICTURES = 4
"""Fewer of a set tell nothing, and resamples of them are all alike."""


@dataclass(frozen=True, slots=True, eq=False)
class SeenPictures:
    """Features of a set of pictures, and hashes of their pixels."""

    name: str
    features: Float32[np.ndarray, "n d"]
    hashes: tuple[str, ...]

    def __len__(self) -> int:
        return len(self.hashes)


@dataclass(frozen=True, slots=True, kw_only=True)
class DistributionDistance:
    """How far two sets of pictures are from each other, by one extractor."""

    metric: str
    """FID, or FD- and a name."""
    kernel_metric: str
    """KID, or KD- and a name."""
    extractor: str
    features: int
    real: str
    fake: str
    real_pictures: int
    fake_pictures: int
    shared_pictures: int
    """Pictures that are in both sets, pixel by pixel."""
    frechet: float
    frechet_interval: Interval
    kernel: float
    kernel_interval: Interval
    same: SameDistribution
    """What the Frechet distance would be for want of pictures alone."""
    warnings: tuple[str, ...]


def seen(
    name: str,
    capture: Capture,
    extractor: Extractor,
    cache: FeatureCache | None,
    advance: Callable[[], None] = lambda: None,
) -> SeenPictures:
    """Look at all pictures of a capture, which a person knows by `name`; without a cache, anew each time.

    Raises `CaptureError` for a broken picture, and ValueError for too few.
    """
    if len(capture) < LEAST_PICTURES:
        raise ValueError(f"{name}: {len(capture)} pictures; a distribution takes at least {LEAST_PICTURES}")
    rows: list[Float32[np.ndarray, " d"]] = []
    hashes: list[str] = []
    for view in capture:
        image: UInt8[np.ndarray, "h w 3"] = view.image
        hashes.append(picture_hash(image))
        rows.append(extractor(image) if cache is None else cache.features(extractor, image, hashes[-1]))
        advance()
    return SeenPictures(name, np.stack(rows), tuple(hashes))


def compared(
    extractor: Extractor,
    real: SeenPictures,
    fake: SeenPictures,
    *,
    resamples: int = 200,
    seed: int = 0,
    advance: Callable[[], None] = lambda: None,
) -> DistributionDistance:
    """Compare two sets; the same inputs give the same numbers. `advance` is called 2 `resamples` times."""
    pairs = _shared(real.hashes, fake.hashes)
    value = frechet_distance(real.features, fake.features)
    same = same_distribution(real.features, fake.features, resamples, seed, advance)
    counts = (len(real), len(fake))
    kernel, kernel_spread = kernel_estimate(real.features, fake.features, resamples, seed, pairs)
    told = warning(extractor, value, counts, same)
    in_both = len(set(real.hashes) & set(fake.hashes))
    warnings = [] if told is None else [told]
    if in_both:
        warnings.append(f"{in_both} pictures are in both sets: they make every distance smaller")
    for name, each in (("real", real), ("fake", fake)):
        repeated = len(each) - len(set(each.hashes))
        if repeated:
            warnings.append(f"{repeated} of the {len(each)} {name} pictures repeat others of them")
    return DistributionDistance(
        metric=extractor.metric,
        kernel_metric=extractor.kernel_metric,
        extractor=extractor.described,
        features=extractor.features,
        real=real.name,
        fake=fake.name,
        real_pictures=counts[0],
        fake_pictures=counts[1],
        shared_pictures=in_both,
        frechet=value,
        frechet_interval=frechet_interval(real.features, fake.features, resamples, seed, advance, value),
        kernel=kernel,
        kernel_interval=kernel_spread,
        same=same,
        warnings=tuple(warnings),
    )


def _shared(real: Sequence[str], fake: Sequence[str]) -> Bool[np.ndarray, "n m"] | None:
    if not set(real) & set(fake):
        return None
    return np.array(real)[:, None] == np.array(fake)[None, :]
