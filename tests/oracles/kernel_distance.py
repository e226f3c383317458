"""KID of two sets, each picture once."""

import numpy as np
from jaxtyping import Bool

from gsrain_engine.evaluation.fid import Features, weighted_distances


def kernel_distance(real: Features, fake: Features, shared: Bool[np.ndarray, "_ _"] | None = None) -> float:
    """Unbiased squared maximum mean discrepancy of two sets of features, with the kernel (x.y / d + 1)^3.

    Binkowski et al. 2018 ("Demystifying MMD GANs", sec. 4); without a unit; its expectation is 0 for sets of one
    distribution at any number of pictures, and above 0 for others; single values may lie below 0. Lower is better.

    `shared` marks pairs (real, fake) that are one and the same picture: they count no more than a picture with itself
    does within a set, so that a set compared with itself gives 0. Raises ValueError for fewer than two pictures.
    """
    ones = [np.ones((len(each), 1)) for each in (real, fake)]
    return float(weighted_distances(real, fake, ones[0], ones[1], shared)[0])
