"""The Frechet distance of two sets of features, exact for any number of pictures."""

import numpy as np
from jaxtyping import Float, Float64

Features = Float[np.ndarray, "_ _"]
"""One row a picture."""


def frechet_distance(real: Features, fake: Features) -> float:
    """Squared Frechet distance of Gaussians with the means and covariances of two sets of features.

    |m1 - m2|^2 + tr(S1 + S2 - 2 (S1^1/2 S2 S1^1/2)^1/2) (Dowson and Landau 1982; Heusel et al. 2017, eq. 6), with the
    covariances over n - 1; 0 (equal) to infinity, in squared units of the features. With Inception's features it is
    FID. Lower is better; of few pictures it is too high (see `small_samples`).

    Exact in float64 and without the root of a matrix: with A and B the centred features over sqrt(n - 1), the trace of
    the root is the sum of the singular values of A B^T, whose eigenvalues with their transpose are those of S1 S2. It
    stays exact where fewer pictures than features leave both covariances singular; scipy's sqrtm then does not.
    Raises ValueError for fewer than two pictures, other numbers of features, or values that are not finite.
    """
    _check(real, fake)
    means = [each.mean(axis=0, dtype=np.float64) for each in (real, fake)]
    roots = [(each - mean) / np.sqrt(len(each) - 1) for each, mean in zip((real, fake), means, strict=True)]
    between = float(np.sum((means[0] - means[1]) ** 2))
    spreads = sum(float(np.vdot(root, root)) for root in roots)
    left, right = (_small_root(root) for root in roots)
    common = float(np.linalg.svd(left @ right.T, compute_uv=False).sum())
    return max(between + spreads - 2 * common, 0.0)


def rotated(real: Features, fake: Features) -> tuple[Float64[np.ndarray, "n r"], Float64[np.ndarray, "m r"]]:
    """Return the same points in fewer coordinates, which no distance notices: at most one a picture, not one a feature.

    What resamples pictures many times starts from here.
    """
    points = np.concatenate((real, fake)).astype(np.float64)
    points -= points.mean(axis=0)
    if len(points) < points.shape[1]:
        points = np.ascontiguousarray(np.asarray(np.linalg.qr(points.T, mode="r")).T)
    return points[: len(real)], points[len(real) :]


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
