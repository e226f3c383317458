"""The Frechet distance of two sets of features, exact for any number of pictures."""

import numpy as np
from jaxtyping import Float, Float64, Int64

Features = Float[np.ndarray, "_ _"]
"""One row a picture."""
Counts = Int64[np.ndarray, " _"]

_MANY = 256
"""From so many pictures and features on the faster way pays."""
_TOLERANCE = 5e-7
_ROUNDING = float(np.finfo(np.float64).eps)


def frechet_distance(real: Features, fake: Features, counts: tuple[Counts, Counts] | None = None) -> float:
    """Squared Frechet distance of Gaussians with the means and covariances of two sets of features.

    |m1 - m2|^2 + tr(S1 + S2 - 2 (S1^1/2 S2 S1^1/2)^1/2) (Dowson and Landau 1982; Heusel et al. 2017, eq. 6), with the
    covariances over n - 1; 0 (equal) to infinity, in squared units of the features. With Inception's features it is
    FID. Lower is better; of few pictures it is too high (see `small_samples`). `counts` says how often each picture
    of each set counts (as if it were there so often); without them once.

    In float64 and without the root of a matrix: with A and B the centred features over sqrt(n - 1), the trace of
    the root is the sum of the singular values of A B^T, whose eigenvalues with their transpose are those of S1 S2. It
    stays exact where fewer pictures than features leave both covariances singular; scipy's sqrtm then does not.
    Of many pictures the squares of these values are found instead, several times faster, where that is known to change
    the distance by less than a millionth of itself.
    Raises ValueError for fewer than two pictures, other numbers of features, or values that are not finite.
    """
    _check(real, fake)
    told = counts or (np.ones(len(real), np.int64), np.ones(len(fake), np.int64))
    (first, left), (second, right) = (_moments(each, own) for each, own in zip((real, fake), told, strict=True))
    between = float(np.sum((first - second) ** 2))
    spreads = float(np.vdot(left, left) + np.vdot(right, right))
    if min(len(left), len(right), left.shape[1]) >= _MANY:
        common, uncertain = nuclear_norm(left, right)
        distance = between + spreads - 2 * common
        if 2 * uncertain <= _TOLERANCE * distance:
            return distance
    common = float(np.linalg.svd(_small_root(left) @ _small_root(right).T, compute_uv=False).sum())
    return max(between + spreads - 2 * common, 0.0)


def nuclear_norm(left: Float64[np.ndarray, "n d"], right: Float64[np.ndarray, "m d"]) -> tuple[float, float]:
    """Return the sum of the singular values of left right^T, and how far it may be off.

    They are the roots of the eigenvalues of a symmetric matrix, as small as the least of n, m and d allows. Rounding
    moves each of these by about 2^-52 times the norms that went in, and so the root of a small one most; roundings are
    taken for independent of each other. Of covariances that fall off steeply the true error is smaller by far.
    """
    n, m, d = len(left), len(right), left.shape[1]
    if d < min(n, m):
        gram = left.T @ left
        try:
            root = np.linalg.cholesky(gram)
        except np.linalg.LinAlgError:  # singular: the roots of nothing are not known well enough
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


def rotated(real: Features, fake: Features) -> tuple[Float64[np.ndarray, "n r"], Float64[np.ndarray, "m r"]]:
    """Return the same points in fewer coordinates, which no distance notices: at most one a picture, not one a feature.

    What resamples pictures many times starts from here.
    """
    points = np.concatenate((real, fake)).astype(np.float64)
    points -= points.mean(axis=0)
    if len(points) < points.shape[1]:
        points = np.ascontiguousarray(np.asarray(np.linalg.qr(points.T, mode="r")).T)
    return points[: len(real)], points[len(real) :]


def _moments(features: Features, counts: Counts) -> tuple[Float64[np.ndarray, " d"], Float64[np.ndarray, "k d"]]:
    """Mean, and a root of the covariance: the centred rows of those that count at all, weighted."""
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
    """Of more pictures than features, as many rows as features with the same covariance."""
    if len(root) <= root.shape[1]:
        return root
    return np.asarray(np.linalg.qr(root, mode="r"))


def _check(real: Features, fake: Features) -> None:
    for name, each in (("real", real), ("fake", fake)):
        if len(each) < 2:
            raise ValueError(f"{len(each)} {name} pictures: a covariance takes at least two")
        if not np.isfinite(each).all():
            raise ValueError(f"the features of the {name} pictures are not all finite")
    if real.shape[1] != fake.shape[1]:
        raise ValueError(f"features of {real.shape[1]} and {fake.shape[1]} numbers can't be compared")
