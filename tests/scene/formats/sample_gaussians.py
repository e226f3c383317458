"""Random Gaussians that are worth writing to files."""

import numpy as np

from gsrain_engine.scene.gaussians import COEFFICIENTS_OF_DEGREE, Gaussians
from gsrain_engine.scene.geometry import normalized


def sample_gaussians(count: int = 300, sh_degree: int = 3, seed: int = 1) -> Gaussians:
    rng = np.random.default_rng(seed)
    return Gaussians(
        rng.normal(0, 5, (count, 3)).astype(np.float32),
        rng.uniform(0.005, 0.5, (count, 3)).astype(np.float32),
        normalized(rng.normal(size=(count, 4))).astype(np.float32),
        rng.uniform(0, 1, count).astype(np.float32),
        rng.normal(0, 0.3, (count, COEFFICIENTS_OF_DEGREE[sh_degree], 3)).astype(np.float32),
    )


def assert_equal(found: Gaussians, expected: Gaussians, rtol: float = 1e-5) -> None:
    np.testing.assert_array_equal(found.means, expected.means)
    np.testing.assert_array_equal(found.sh, expected.sh)
    np.testing.assert_allclose(found.scales, expected.scales, rtol=rtol)
    np.testing.assert_allclose(found.quaternions, expected.quaternions, atol=1e-6)
    np.testing.assert_allclose(found.opacities, expected.opacities, rtol=rtol, atol=1e-7)
