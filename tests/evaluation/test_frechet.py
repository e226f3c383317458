"""The Frechet distance against closed forms, scipy's matrix root and torchmetrics."""

import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import linalg

from gsrain_engine.evaluation import fid as module
from gsrain_engine.evaluation.fid import frechet_distance, nuclear_norm, reduce_dimension
from oracles.kernel_distance import kernel_distance
from repository import REPOSITORY


def _set(count, features, seed, shift=0.0, scale=1.0):
    spread = np.arange(1, features + 1) ** -0.5
    return np.random.default_rng(seed).normal(0, 1, (count, features)) * spread * scale + shift


def _whitened(count, features, seed):
    """Points with mean 0 and a covariance of exactly one."""
    points = np.random.default_rng(seed).normal(0, 1, (count, features))
    points -= points.mean(axis=0)
    return points @ np.linalg.inv(np.linalg.cholesky(np.cov(points.T))).T


def _by_roots(real, fake):
    """The formula as it stands, by scipy's root of a matrix."""
    first, second = np.cov(real.T), np.cov(fake.T)
    root = linalg.sqrtm(first @ second).real
    return np.sum((real.mean(0) - fake.mean(0)) ** 2) + np.trace(first + second - 2 * root)


def test_known_gaussians_have_the_closed_form():
    """Of covariances that share their axes: sum of squares of the differences of means and of deviations."""
    turn = np.linalg.qr(np.random.default_rng(5).normal(0, 1, (6, 6)))[0]
    first, second = np.array([1.0, 2, 3, 0.5, 4, 1]), np.array([2.0, 2, 1, 0.7, 0.1, 3])
    mean = np.array([0.3, -1, 0, 2, 0, 0.5])
    real, fake = (_whitened(40, 6, 1) * first) @ turn, (_whitened(25, 6, 2) * second + mean) @ turn
    expected = np.sum(mean**2) + np.sum((first - second) ** 2)
    assert frechet_distance(real, fake) == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize(("n", "m"), [(200, 150), (200, 20), (20, 30)])
def test_it_is_the_formula_with_many_pictures_and_with_few(n, m):
    real, fake = _set(n, 48, 0), _set(m, 48, 1, 0.1, 1.3)
    assert frechet_distance(real, fake) == pytest.approx(_by_roots(real, fake), rel=1e-5)


@given(st.integers(2, 40), st.integers(2, 40), st.integers(1, 30), st.integers(0, 1000))
def test_it_is_symmetric_never_negative_and_keeps_under_rotation(n, m, features, seed):
    real, fake = _set(n, features, seed), _set(m, features, seed + 1, 0.2)
    distance = frechet_distance(real, fake)
    assert distance >= 0
    assert frechet_distance(fake, real) == pytest.approx(distance, rel=1e-9, abs=1e-10)
    short = reduce_dimension(real, fake)
    assert short[0].shape[1] <= min(features, n + m)
    assert frechet_distance(*short) == pytest.approx(distance, rel=1e-9, abs=1e-9)


def test_of_a_set_and_itself_it_is_zero_and_scales_with_the_square():
    real, fake = _set(30, 64, 3).astype(np.float32), _set(30, 64, 4).astype(np.float32)
    assert frechet_distance(real, real) == pytest.approx(0, abs=1e-6)
    assert frechet_distance(4 * real, 4 * fake) == pytest.approx(16 * frechet_distance(real, fake), rel=1e-6)
    assert frechet_distance(real, fake + 1) == pytest.approx(
        frechet_distance(real, fake)
        + np.sum((real.mean(0) - fake.mean(0) - 1) ** 2)
        - np.sum((real.mean(0) - fake.mean(0)) ** 2),
        rel=1e-4,
    )


def test_bad_features_are_named():
    good = _set(5, 4, 0)
    with pytest.raises(ValueError, match="1 fake pictures: a covariance takes at least two"):
        frechet_distance(good, good[:1])
    with pytest.raises(ValueError, match="features of the real pictures are not all finite"):
        frechet_distance(np.where(good > 0, good, np.nan), good)
    with pytest.raises(ValueError, match="features of 4 and 3 numbers"):
        frechet_distance(good, good[:, :3])


@pytest.mark.parametrize("count", [24, 90])
def test_torchmetrics_agrees(count):
    torch = pytest.importorskip("torch")
    fid = pytest.importorskip("torchmetrics.image.fid")

    class Features(torch.nn.Module):
        num_features = 48

        def forward(self, pictures):
            return pictures.float().reshape(len(pictures), -1)[:, :48] / 50

    random = np.random.default_rng(0)
    real, fake = (random.integers(0, top, (count, 3, 4, 4)).astype(np.uint8) for top in (256, 200))
    metric = fid.FrechetInceptionDistance(feature=Features(), input_img_size=(3, 4, 4))
    metric.set_dtype(torch.float64)
    metric.update(torch.from_numpy(real), real=True)
    metric.update(torch.from_numpy(fake), real=False)
    ours = frechet_distance(*(each.reshape(count, -1) / np.float32(50) for each in (real, fake)))
    assert float(metric.compute()) == pytest.approx(ours, rel=1e-3)


@pytest.mark.parametrize(("n", "m", "features"), [(700, 600, 300), (300, 320, 500), (400, 290, 350)])
def test_many_pictures_take_the_faster_way_to_the_same_distance(n, m, features, monkeypatch):
    real, fake = _set(n, features, 0), _set(m, features, 1, 0.1, 1.2)
    asked = []
    monkeypatch.setattr(np.linalg, "svd", lambda *given, **named: asked.append(1))
    fast = frechet_distance(real, fake)
    assert not asked
    monkeypatch.undo()
    monkeypatch.setattr(module, "_MANY", 10_000)
    assert frechet_distance(real, fake) == pytest.approx(fast, rel=1e-9)


def test_where_rounding_would_tell_the_slower_way_is_taken():
    real = _set(400, 300, 0)
    assert frechet_distance(real, real) == pytest.approx(0, abs=1e-9)
    flat = real * (np.arange(300) < 290)  # ten features that never change: a singular covariance
    assert frechet_distance(flat, real) == pytest.approx(np.var(real[:, 290:], axis=0, ddof=1).sum(), rel=0.2)
    sum_, uncertain = nuclear_norm(flat, flat)
    exact = np.linalg.svd(flat @ flat.T, compute_uv=False).sum()
    assert abs(sum_ - exact) <= uncertain


@pytest.mark.parametrize(("n", "features"), [(12, 30), (40, 7), (400, 300)])
def test_counts_are_copies(n, features):
    real, fake = _set(n, features, 0), _set(n + 3, features, 1, 0.2)
    drawn = [np.random.default_rng(k).integers(0, len(each), len(each)) for k, each in enumerate((real, fake))]
    counts = tuple(np.bincount(own, minlength=len(each)) for own, each in zip(drawn, (real, fake), strict=True))
    copied = frechet_distance(real[drawn[0]], fake[drawn[1]])
    assert frechet_distance(real, fake, counts) == pytest.approx(copied, rel=1e-9)


def test_few_pictures_have_the_distances_that_the_guide_names():
    """FID of samples of one distribution is not 0 and hangs on their numbers; KID is, and does not."""
    guide = (REPOSITORY / "docs" / "guide" / "measuring.md").read_text(encoding="utf-8")
    named = [[float(word) for word in row] for row in re.findall(r"([\d.]+) for (\d+) and (\d+)\b", guide)]
    random = np.random.default_rng(1)
    for fid, real, fake in named:
        pairs = [[random.normal(size=(int(count), 64)) for count in (real, fake)] for _ in range(10)]
        assert np.mean([frechet_distance(*pair) for pair in pairs]) == pytest.approx(fid, rel=0.05)
        distances = [kernel_distance(*pair) for pair in pairs]
        assert abs(np.mean(distances)) < np.std(distances)
    assert len(named) == 3
