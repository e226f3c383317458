"""KID against its definition, the exact expectation for Gaussians, and torchmetrics."""

import numpy as np
import pytest

from gsrain_engine.evaluation import fid as module
from gsrain_engine.evaluation.fid import weighted_distances
from oracles.kernel_distance import kernel_distance


def _set(count, features, seed, shift=0.0, scale=1.0):
    return np.random.default_rng(seed).normal(shift, scale, (count, features))


def _by_pairs(real, fake):
    """The definition, pair by pair (Binkowski et al. 2018, eq. 4)."""

    def kernel(x, y):
        return (x @ y / len(x) + 1) ** 3

    def within(points):
        count = len(points)
        values = [kernel(points[i], points[j]) for i in range(count) for j in range(count) if i != j]
        return sum(values) / (count * (count - 1))

    across = [kernel(x, y) for x in real for y in fake]
    return within(real) + within(fake) - 2 * sum(across) / len(across)


def test_it_is_the_definition(monkeypatch):
    monkeypatch.setattr(module, "_BLOCK_ROWS", 4)  # several blocks
    real, fake = _set(11, 6, 0), _set(14, 6, 1, 0.3)
    assert kernel_distance(real, fake) == pytest.approx(_by_pairs(real, fake), rel=1e-12)


def test_known_gaussians_have_the_closed_form():
    """Of N(0, a^2 I) in d dimensions: z = x.y / d has E z = E z^3 = 0, E z^2 = a^2 b^2 / d, so E k = 1 + 3 E z^2."""
    features, first, second = 8, 1.0, 1.6
    expected = 3 / features * (first**4 + second**4 - 2 * first**2 * second**2)
    values = [kernel_distance(_set(60, features, 2 * k), _set(50, features, 2 * k + 1, 0, 1.6)) for k in range(400)]
    assert abs(np.mean(values) - expected) < 4 * np.std(values) / np.sqrt(len(values))
    assert expected > 8 * np.std(values) / np.sqrt(len(values))


def test_its_expectation_is_zero_for_one_distribution_at_few_pictures():
    values = [kernel_distance(_set(12, 16, 2 * k), _set(9, 16, 2 * k + 1)) for k in range(600)]
    assert abs(np.mean(values)) < 4 * np.std(values) / np.sqrt(len(values))
    assert min(values) < 0 < max(values)


def test_a_set_compared_with_itself_gives_zero_where_that_is_known():
    points = _set(20, 8, 0)
    assert kernel_distance(points, points, np.eye(20, dtype=bool)) == pytest.approx(0, abs=1e-12)
    assert kernel_distance(points, points) < -0.01  # a picture with itself counts as likeness of the sets


def test_weights_count_pictures_and_never_pair_one_with_itself():
    real, fake = _set(6, 5, 0), _set(7, 5, 1, 0.4)
    ones = np.ones((6, 2)), np.ones((7, 2))
    ones[0][3, 1] = 0
    values = weighted_distances(real, fake, *ones)
    assert values[0] == pytest.approx(kernel_distance(real, fake), rel=1e-12)
    assert values[1] == pytest.approx(kernel_distance(np.delete(real, 3, axis=0), fake), rel=1e-12)
    twice = np.full((6, 1), 2.0), np.full((7, 1), 2.0)
    assert weighted_distances(real, fake, *twice)[0] == pytest.approx(values[0], rel=1e-12)


def test_one_picture_is_too_few():
    with pytest.raises(ValueError, match="1 real and 5 fake pictures: KID takes at least two"):
        kernel_distance(_set(1, 3, 0), _set(5, 3, 1))


@pytest.mark.filterwarnings("ignore:Metric `Kernel Inception Distance` will save:UserWarning")
def test_torchmetrics_agrees():
    torch = pytest.importorskip("torch")
    kid = pytest.importorskip("torchmetrics.image.kid")

    class Features(torch.nn.Module):
        num_features = 48

        def forward(self, pictures):
            return pictures.double().reshape(len(pictures), -1) / 50

    random = np.random.default_rng(0)
    real, fake = (random.integers(0, top, (40, 3, 4, 4)).astype(np.uint8) for top in (256, 200))
    metric = kid.KernelInceptionDistance(feature=Features(), subsets=1, subset_size=40)
    metric.update(torch.from_numpy(real), real=True)
    metric.update(torch.from_numpy(fake), real=False)
    ours = kernel_distance(*(each.reshape(40, -1).astype(np.float64) / 50 for each in (real, fake)))
    assert float(metric.compute()[0]) == pytest.approx(ours, rel=1e-3)
