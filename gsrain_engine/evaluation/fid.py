"""FID and KID: distances of two image sets as distributions, with confidence intervals and small-sample warnings."""

import hashlib
import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import platformdirs
from jaxtyping import Bool, Float, Float32, Float64, Int64, UInt8

from ..choices import EXTRACTORS
from ..datasets.capture import Capture
from ..report.interval import Interval, quantiles
from ..safe_io.files import whole_file
from ..safe_io.limits import open_file
from .fid_features import SIZE_PX, Extractor, ExtractorChoice, cell_statistics

MIN_IMAGES = 4  # smaller sets are meaningless, and their resamples are almost all alike
Features = Float[np.ndarray, "_ _"]  # one row per image
Weights = Float64[np.ndarray, "_ k"]  # of each image, in k resamples
Pairs = Bool[np.ndarray, "_ _"]
Advance = Callable[[], object]


@dataclass(frozen=True, slots=True, eq=False)
class ImageSetFeatures:
    """Features of a set of images, and hashes of their pixels."""

    name: str
    features: Float32[np.ndarray, "n d"]
    hashes: tuple[str, ...]

    def __len__(self) -> int:
        return len(self.hashes)


@dataclass(frozen=True, slots=True, kw_only=True)
class DistributionDistance:
    """Distance of two sets of images for one extractor."""

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
    """Images in both sets, with identical pixels."""
    frechet: Interval
    kernel: Interval
    same: Interval
    """Expected Frechet distance from small samples alone: of sets of these sizes of one distribution."""
    warnings: tuple[str, ...]

    @property
    def plain(self) -> dict[str, Any]:
        """Distances for JSON."""
        return {
            "frechet": self.frechet.value,
            "frechet_interval": [self.frechet.low, self.frechet.high],
            "same": {"mean": self.same.value, "interval": [self.same.low, self.same.high]},
            "kernel": self.kernel.value,
            "kernel_interval": [self.kernel.low, self.kernel.high],
        }


def distribution_distance(
    extractor: Extractor,
    real: ImageSetFeatures,
    fake: ImageSetFeatures,
    *,
    resamples: int = 200,
    seed: int = 0,
    advance: Advance = lambda: None,
) -> DistributionDistance:
    """Compare two sets, deterministically. `advance` is called 2 `resamples` times."""
    same = same_distribution(real.features, fake.features, resamples, seed, advance)
    in_both = len(set(real.hashes) & set(fake.hashes))
    pairs = np.array(real.hashes)[:, None] == np.array(fake.hashes)[None, :] if in_both else None
    kernel = kernel_estimate(real.features, fake.features, resamples, seed, pairs)
    frechet = frechet_interval(real.features, fake.features, resamples, seed, advance)
    warning = small_sample_warning(extractor, frechet.value, (len(real), len(fake)), same)
    warnings = [] if warning is None else [warning]
    if in_both:
        warnings.append(f"{in_both} pictures are in both sets: they make every distance smaller")
    for name, each in (("real", real), ("fake", fake)):
        repeated = len(each) - len(set(each.hashes))
        if repeated:
            warnings.append(f"{repeated} of the {len(each)} {name} pictures repeat others of them")
    return DistributionDistance(
        metric=extractor.metric, kernel_metric=extractor.kernel_metric, extractor=extractor.described,
        features=extractor.features, real=real.name, fake=fake.name, real_pictures=len(real), fake_pictures=len(fake),
        shared_pictures=in_both, frechet=frechet, kernel=kernel, same=same, warnings=tuple(warnings),
    )  # fmt: skip


def extract_features(
    name: str, capture: Capture, extractor: Extractor, cache: "FeatureCache | None", advance: Advance = lambda: None
) -> ImageSetFeatures:
    """Extract features of a capture's images; raises `CaptureError` for a broken image, and ValueError for too few."""
    if len(capture) < MIN_IMAGES:
        raise ValueError(f"{name}: {len(capture)} pictures; a distribution takes at least {MIN_IMAGES}")
    rows: list[Float32[np.ndarray, " d"]] = []
    hashes: list[str] = []
    for view in capture:
        image: UInt8[np.ndarray, "h w 3"] = view.image
        hashes.append(image_hash(image))
        rows.append(extractor(image) if cache is None else cache.features(extractor, image, hashes[-1]))
        advance()
    return ImageSetFeatures(name, np.stack(rows), tuple(hashes))


def image_hash(image: UInt8[np.ndarray, "h w 3"]) -> str:
    """Return a SHA-256 hash of the pixels, independent of file name and lossless format."""
    found = hashlib.sha256(np.array(image.shape, np.int64).tobytes())
    found.update(image.tobytes())
    return found.hexdigest()


# Extractors by their `--extractor` names


def open_extractor(choice: ExtractorChoice) -> Extractor:
    """Open an extractor.

    Raises ValueError for an unknown name or unsuitable weights, FileNotFoundError with download instructions if weights
    are missing, and ModuleNotFoundError if it needs torch and torch is missing.
    """
    if choice.name not in EXTRACTORS:
        raise ValueError(f"extractor {choice.name!r}: expected one of {', '.join(EXTRACTORS)}")
    if choice.name == "inception":
        from .fid_torch_features import open_inception  # torch is an extra

        return open_inception(choice)
    if choice.weights is not None:
        raise ValueError(f"{choice.weights}: the extractor pixels16 takes no weights")
    described = f"colour and edges of 4x4 cells, {SIZE_PX}x{SIZE_PX} px"
    return Extractor(metric="FD-pixels16", described=described, features=160, key=None, function=cell_statistics)


# Feature cache
# Keyed by image content and extractor.

PLACE = "GSRAIN_FEATURE_CACHE"  # environment variable with the folder of the feature cache


class FeatureCache:
    """A folder with one small file per image and extractor; it may be deleted at any time."""

    def __init__(self, folder: Path | None = None) -> None:
        own = os.environ.get(PLACE)
        default = platformdirs.user_cache_path("gsrain", appauthor=False) / "features"
        self._folder = folder or (Path(own) if own else default)

    def features(
        self, extractor: Extractor, image: UInt8[np.ndarray, "h w 3"], digest: str
    ) -> Float32[np.ndarray, " d"]:
        """Return an extractor's features of an image with that `image_hash`, from the cache if present."""
        if extractor.key is None:
            return extractor(image)
        file = self._folder / extractor.key / digest[:2] / f"{digest}.npy"
        found = _read(file, extractor.features)
        if found is None:
            found = extractor(image)
            file.parent.mkdir(parents=True, exist_ok=True)
            with whole_file(file) as temporary, temporary.open("wb") as opened:
                np.save(opened, found)
        return found


def _read(file: Path, features: int) -> Float32[np.ndarray, " d"] | None:
    """Read cached features; None if missing or damaged."""
    try:
        with open_file(file) as stream:
            found = np.load(stream, allow_pickle=False)
    except (OSError, ValueError, EOFError):
        return None
    return found if found.shape == (features,) and found.dtype == np.float32 else None


# Frechet distance

FeatureCounts = Int64[np.ndarray, " _"]
MANY = 256  # minimum number of images and features for the faster method
_TOLERANCE = 5e-7
_ROUNDING = float(np.finfo(np.float64).eps)


def frechet_distance(
    real: Features, fake: Features, counts: tuple[FeatureCounts, FeatureCounts] | None = None
) -> float:
    """Squared Frechet distance of Gaussians with the means and covariances of two sets of features.

    |m1 - m2|^2 + tr(S1 + S2 - 2 (S1^1/2 S2 S1^1/2)^1/2) (Dowson and Landau 1982; Heusel et al. 2017, eq. 6), with the
    covariances over n - 1; 0 (equal) to infinity, in squared units of the features. With Inception's features it is
    FID. Lower is better; for few images it is too high (see `same_distribution`). `counts` is the multiplicity of each
    image in each set, 1 by default.

    In float64 and without a matrix square root: with A and B the centered features over sqrt(n - 1), the trace of the
    root is the sum of the singular values of A B^T, whose squares are the eigenvalues of S1 S2. It stays exact if fewer
    images than features leave both covariances singular, unlike scipy's sqrtm. For many images the squared values are
    computed instead, several times faster, if that provably changes the distance by less than a millionth of itself.
    Raises ValueError for fewer than two images, different numbers of features, or values that are not finite.
    """
    _check(real, fake)
    real_counts, fake_counts = counts or (np.ones(len(real), np.int64), np.ones(len(fake), np.int64))
    (first, left), (second, right) = _moments(real, real_counts), _moments(fake, fake_counts)
    between = float(np.sum((first - second) ** 2))
    spreads = float(np.vdot(left, left) + np.vdot(right, right))
    if min(len(left), len(right), left.shape[1]) >= MANY:
        common, uncertain = nuclear_norm(left, right)
        distance = between + spreads - 2 * common
        if 2 * uncertain <= _TOLERANCE * distance:
            return distance
    common = float(np.linalg.svd(_small_root(left) @ _small_root(right).T, compute_uv=False).sum())
    return max(between + spreads - 2 * common, 0.0)


def nuclear_norm(left: Float64[np.ndarray, "n d"], right: Float64[np.ndarray, "m d"]) -> tuple[float, float]:
    """Return the sum of the singular values of left right^T, and its error estimate.

    They are the square roots of the eigenvalues of a symmetric matrix whose size is the smallest of n, m and d.
    Rounding shifts each eigenvalue by about 2^-52 times the norms of the factors, which affects the roots of small ones
    most; rounding errors are assumed independent. For steeply decaying covariances the true error is much smaller.
    """
    n, m, d = len(left), len(right), left.shape[1]
    if d < min(n, m):
        gram = left.T @ left
        try:
            root = np.linalg.cholesky(gram)
        except np.linalg.LinAlgError:  # singular: the roots are too imprecise
            return 0.0, np.inf
        other = right.T @ right
        squared, size = root.T @ other @ root, float(np.linalg.norm(gram) * np.linalg.norm(other))
    else:
        product = left @ right.T
        squared = product @ product.T if n <= m else product.T @ product
        size = float(np.linalg.norm(squared))
    values = np.maximum(np.linalg.eigvalsh(squared), 0.0)
    rounding = _ROUNDING * size
    roots = np.sqrt(values)
    uncertain = np.minimum(rounding / np.maximum(2 * roots, 1e-300), np.sqrt(rounding))
    return float(roots.sum()), float(np.linalg.norm(uncertain))


def reduce_dimension(real: Features, fake: Features) -> tuple[Float64[np.ndarray, "n r"], Float64[np.ndarray, "m r"]]:
    """Return the same points with unchanged distances in fewer coordinates, at most one per image, for speed."""
    points = np.concatenate((real, fake)).astype(np.float64)
    points -= points.mean(axis=0)
    if len(points) < points.shape[1]:
        points = np.ascontiguousarray(np.asarray(np.linalg.qr(points.T, mode="r")).T)
    return points[: len(real)], points[len(real) :]


def _moments(features: Features, counts: FeatureCounts) -> tuple[Float64[np.ndarray, " d"], Float64[np.ndarray, "k d"]]:
    """Mean, and a root of the covariance: weighted, centered rows with nonzero count."""
    counted = np.flatnonzero(counts)
    rows = features[counted].astype(np.float64)
    if (counts == 1).all():
        mean = rows.mean(axis=0)
        rows -= mean
        return mean, rows / np.sqrt(len(rows) - 1)
    weights, total = counts[counted].astype(np.float64), int(counts.sum())
    mean = weights @ rows / total
    rows -= mean
    rows *= np.sqrt(weights / (total - 1))[:, None]
    return mean, rows


def _small_root(root: Float64[np.ndarray, "n d"]) -> Float64[np.ndarray, "_ d"]:
    """Reduce a root with more images than features to as many rows as features, with the same covariance."""
    return root if len(root) <= root.shape[1] else np.asarray(np.linalg.qr(root, mode="r"))


def _check(real: Features, fake: Features) -> None:
    for name, each in (("real", real), ("fake", fake)):
        if len(each) < 2:
            raise ValueError(f"{len(each)} {name} pictures: a covariance takes at least two")
        if not np.isfinite(each).all():
            raise ValueError(f"the features of the {name} pictures are not all finite")
    if real.shape[1] != fake.shape[1]:
        raise ValueError(f"features of {real.shape[1]} and {fake.shape[1]} numbers can't be compared")


# Kernel distance

BLOCK_ROWS = 512


def weighted_distances(
    real: Features, fake: Features, real_weights: Weights, fake_weights: Weights, shared: Pairs | None = None
) -> Float64[np.ndarray, " k"]:
    """Unbiased squared maximum mean discrepancies of two sets of features, with the kernel (x.y / d + 1)^3.

    Each column of weights holds the multiplicities of the images. Binkowski et al. 2018 ("Demystifying MMD GANs", sec.
    4); unitless; the expectation is 0 for sets of one distribution at any number of images, and above 0 for others;
    single values may be negative. Lower is better. An image is never paired with itself, regardless of its
    multiplicity. `shared` marks pairs (real, fake) of the same image, which are excluded in the same way. Raises
    ValueError for fewer than two images.
    """
    if min(len(real), len(fake)) < 2:
        raise ValueError(f"{len(real)} real and {len(fake)} fake pictures: KID takes at least two of each")
    within = _within(real, real_weights) + _within(fake, fake_weights)
    return within - 2 * _across(real, fake, real_weights, fake_weights, shared)


def _kernel(rows: Float64[np.ndarray, "_ d"], columns: Float64[np.ndarray, "_ d"]) -> Float64[np.ndarray, "_ _"]:
    near = rows @ columns.T
    near /= rows.shape[1]
    near += 1
    cubed = near * near
    cubed *= near
    return cubed


def _within(features: Features, weights: Weights) -> Float64[np.ndarray, " k"]:
    """Mean over pairs of one set: pairs below the diagonal count twice, the diagonal is excluded."""
    total = np.zeros(weights.shape[1])
    points = features.astype(np.float64)
    for start in range(0, len(points), BLOCK_ROWS):
        block = slice(start, start + BLOCK_ROWS)
        kernel = _kernel(points[block], points[: start + BLOCK_ROWS])
        at = np.arange(len(kernel))
        kernel[at, start + at] = 0
        kernel[:, :start] *= 2
        total += np.sum((kernel @ weights[: start + BLOCK_ROWS]) * weights[block], axis=0)
    return _mean(total, np.sum(weights, axis=0) ** 2 - np.sum(weights**2, axis=0))


def _across(
    real: Features, fake: Features, real_weights: Weights, fake_weights: Weights, shared: Pairs | None
) -> Float64[np.ndarray, " k"]:
    total = np.zeros(real_weights.shape[1])
    pairs = np.sum(real_weights, axis=0) * np.sum(fake_weights, axis=0)
    first, second = real.astype(np.float64), fake.astype(np.float64)
    for start in range(0, len(first), BLOCK_ROWS):
        block = slice(start, start + BLOCK_ROWS)
        kernel = _kernel(first[block], second)
        if shared is not None:
            kernel[shared[block]] = 0
            pairs = pairs - np.sum((shared[block] @ fake_weights) * real_weights[block], axis=0)
        total += np.sum((kernel @ fake_weights) * real_weights[block], axis=0)
    return _mean(total, pairs)


def _mean(total: Float64[np.ndarray, " k"], pairs: Float64[np.ndarray, " k"]) -> Float64[np.ndarray, " k"]:
    return np.divide(total, pairs, out=np.full_like(total, np.nan), where=pairs > 0)


# Confidence intervals and small samples

NOTABLE_SHARE = 0.1  # share of a distance from which its small-sample bias triggers a warning


def frechet_interval(
    real: Features, fake: Features, resamples: int, seed: int, advance: Advance = lambda: None
) -> Interval:
    """Return the Frechet distance with its interval for image sets of these sizes.

    Bootstrap: images of each set are drawn with replacement (Efron 1979). Resamples contain fewer different images,
    which raises their distances; this shift is removed: the interval is the value plus the quantiles of the resampled
    distances around their mean. It does not cover the small-sample bias of the value itself, see `same_distribution`.
    For few images it is too wide (for 32 with 64 features by half); for similar images, such as neighboring frames of a
    drive, too narrow, since it assumes independence. `advance` is called after each resample.
    """
    value = frechet_distance(real, fake)
    points = reduce_dimension(real, fake)
    distances: list[float] = []
    for counts in _drawn_counts(len(real), len(fake), resamples, seed):
        distances.append(frechet_distance(*points, counts))
        advance()
    low, high = quantiles(np.array(distances) - np.mean(distances))
    return Interval(value, max(value + low, 0.0), value + high, *_BOTH, len(real) + len(fake))


_BOTH = "bootstrap, 95 %", "pictures of both sets"


def kernel_estimate(real: Features, fake: Features, resamples: int, seed: int, shared: Pairs | None = None) -> Interval:
    """Return KID with its interval for image sets of these sizes; kernels are computed once for both.

    KID is unbiased, so the bootstrapped values are not shifted. Images are assumed independent, as in
    `frechet_interval`; `shared` is that of `weighted_distances`.
    """
    weights = [np.ones((len(each), 1 + resamples)) for each in (real, fake)]
    for k, counts in enumerate(_drawn_counts(len(real), len(fake), resamples, seed)):
        weights[0][:, 1 + k], weights[1][:, 1 + k] = counts
    values = weighted_distances(real, fake, weights[0], weights[1], shared)
    return Interval(float(values[0]), *quantiles(values[1:]), *_BOTH, len(real) + len(fake))


def _drawn_counts(real: int, fake: int, resamples: int, seed: int) -> Iterator[tuple[FeatureCounts, FeatureCounts]]:
    """Yield the number of times that each image of both sets is drawn, with replacement."""
    random = np.random.default_rng(seed)
    for _ in range(resamples):
        yield _draw(random, real), _draw(random, fake)


def _draw(random: np.random.Generator, count: int) -> FeatureCounts:
    while True:
        drawn = random.integers(0, count, count)
        if (drawn != drawn[0]).any():  # distances require at least two different images
            return np.bincount(drawn, minlength=count)


def same_distribution(
    real: Features, fake: Features, splits: int, seed: int, advance: Advance = lambda: None
) -> Interval:
    """Estimate the Frechet distance of two sets of these sizes from one distribution.

    The mean of each set is removed (with a correction of the spread), all images are mixed, split at random into sets
    of the same sizes, and compared. For N images with d features the result is about the spread of the features until N
    is many times d: at N = 32 it dominates FID. It is exact if both sets have the same covariance, otherwise it applies
    to their mixture. `advance` is called after each split.
    """
    random = np.random.default_rng(seed)
    sets = [points - points.mean(axis=0) for points in reduce_dimension(real, fake)]
    points = np.concatenate([each * np.sqrt(len(each) / (len(each) - 1)) for each in sets])
    distances: list[float] = []
    for _ in range(splits):
        mixed = points[random.permutation(len(points))]
        distances.append(frechet_distance(mixed[: len(real)], mixed[len(real) :]))
        advance()
    values = np.array(distances)
    return Interval(float(values.mean()), *quantiles(values), "middle 95 %", "random splits", splits)


def small_sample_warning(extractor: Extractor, value: float, counts: tuple[int, int], same: Interval) -> str | None:
    """Return a one-sentence warning if the sample size dominates the distance, else None."""
    if same.value < NOTABLE_SHARE * value:
        return None
    bias = (
        f"for want of pictures ({counts[0]} and {counts[1]} for {extractor.features} features) the "
        f"{extractor.metric} of two such sets of one distribution would be about {same.value:.4g} "
        f"({same.low:.4g} to {same.high:.4g}): "
    )
    if value <= same.high:
        return f"{bias}{value:.4g} tells no difference"
    return f"{bias}compare {value:.4g} only with values of as many pictures, or take {extractor.kernel_metric}"
