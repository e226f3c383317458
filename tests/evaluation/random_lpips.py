"""LPIPS networks that have seen nothing, narrow or of full width: they run the code of the real ones."""

import itertools

import numpy as np

from gsrain_engine.evaluation.lpips import geometry
from gsrain_engine.evaluation.lpips_weights import CHANNELS, TAPS, LpipsWeights, Network


def random_weights(network: Network, seed: int = 0, divisor: int = 1) -> LpipsWeights:
    generator = np.random.default_rng(seed)
    widths = (3, *(width // divisor for width in CHANNELS[network][1:]))
    kernels: list[np.ndarray] = []
    for i, (inward, outward) in enumerate(itertools.pairwise(widths)):
        size = geometry(network, i)[0]
        kernels.append(generator.normal(0, (2 / (inward * size**2)) ** 0.5, (outward, inward, size, size)))
    return LpipsWeights(
        network,
        tuple(kernel.astype(np.float32) for kernel in kernels),
        tuple(np.zeros(len(kernel), np.float32) for kernel in kernels),
        tuple(generator.random(len(kernels[tap])).astype(np.float32) for tap in TAPS[network]),
    )
