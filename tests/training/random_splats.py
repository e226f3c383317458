"""Random Gaussians for trainings."""

import numpy as np

from gsrain_engine.scene.gaussians import COEFFICIENTS_OF_DEGREE, Gaussians


def random_splats(n: int, degree: int = 0, seed: int = 0) -> Gaussians:
    random = np.random.default_rng(seed)
    turns = random.normal(size=(n, 4))
    turns /= np.linalg.norm(turns, axis=1, keepdims=True)
    f = np.float32
    return Gaussians(
        random.normal(size=(n, 3)).astype(f),
        np.exp(random.normal(-3, 0.7, (n, 3))).astype(f),
        turns.astype(f),
        random.uniform(0.02, 0.98, n).astype(f),
        random.normal(0, 0.3, (n, COEFFICIENTS_OF_DEGREE[degree], 3)).astype(f),
    )
