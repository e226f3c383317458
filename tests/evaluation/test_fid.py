"""FID and KID against closed forms, scipy's matrix root, definitions pair by pair, new sets, and torchmetrics."""

import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image
from scipy import linalg

from gsrain_engine.datasets.open_capture import open_capture
from gsrain_engine.evaluation import fid as module
from gsrain_engine.evaluation.fid import (
    PLACE,
    FeatureCache,
    SameDistribution,
    distribution_distance,
    extract_features,
    frechet_distance,
    frechet_interval,
    image_hash,
    kernel_estimate,
    nuclear_norm,
    open_extractor,
    reduce_dimension,
    same_distribution,
    small_sample_warning,
    weighted_distances,
)
from gsrain_engine.evaluation.fid_features import Extractor, ExtractorChoice, cell_statistics, resized
from oracles.kernel_distance import kernel_distance
from repository import REPOSITORY
from tests.app.picture_sets import write_pictures


def points(count, features, seed, shift=0.0, scale=1.0):
    """Normal points whose axes spread less and less, as features do; `seed` may be a generator."""
    spread = np.arange(1, features + 1) ** -0.5
    return np.random.default_rng(seed).normal(0, 1, (count, features)) * spread * scale + shift


# Frechet distance


def whitened(count, features, seed):
    """Points with mean 0 and a covariance of exactly one."""
    found = np.random.default_rng(seed).normal(0, 1, (count, features))
    found -= found.mean(axis=0)
    return found @ np.linalg.inv(np.linalg.cholesky(np.cov(found.T))).T


def by_roots(real, fake):
    """The formula as it stands, by scipy's root of a matrix."""
    first, second = np.cov(real.T), np.cov(fake.T)
    root = linalg.sqrtm(first @ second).real
    return np.sum((real.mean(0) - fake.mean(0)) ** 2) + np.trace(first + second - 2 * root)


def test_known_gaussians_have_the_closed_form():
    """Of covariances that share their axes: sum of squares of the differences of means and of deviations."""
    turn = np.linalg.qr(np.random.default_rng(5).normal(0, 1, (6, 6)))[0]
    first, second = np.array([1.0, 2, 3, 0.5, 4, 1]), np.array([2.0, 2, 1, 0.7, 0.1, 3])
    mean = np.array([0.3, -1, 0, 2, 0, 0.5])
    real, fake = (whitened(40, 6, 1) * first) @ turn, (whitened(25, 6, 2) * second + mean) @ turn
    expected = np.sum(mean**2) + np.sum((first - second) ** 2)
    assert frechet_distance(real, fake) == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize(("n", "m"), [(200, 150), (200, 20), (20, 30)])
def test_it_is_the_formula_with_many_pictures_and_with_few(n, m):
    real, fake = points(n, 48, 0), points(m, 48, 1, 0.1, 1.3)
    assert frechet_distance(real, fake) == pytest.approx(by_roots(real, fake), rel=1e-5)


@given(st.integers(2, 40), st.integers(2, 40), st.integers(1, 30), st.integers(0, 1000), st.floats(0.1, 10))
def test_it_is_symmetric_and_never_negative_and_scales_with_the_square(n, m, features, seed, scale):
    real, fake = points(n, features, seed), points(m, features, seed + 1, 0.2)
    distance = frechet_distance(real, fake)
    assert distance >= 0
    assert frechet_distance(fake, real) == pytest.approx(distance, rel=1e-9, abs=1e-10)
    assert frechet_distance(scale * real, scale * fake) == pytest.approx(scale**2 * distance, rel=1e-9, abs=1e-9)
    assert frechet_distance(real, real) == pytest.approx(0, abs=1e-6)
    short = reduce_dimension(real, fake)
    assert short[0].shape[1] <= min(features, n + m)
    assert frechet_distance(*short) == pytest.approx(distance, rel=1e-9, abs=1e-9)


@pytest.mark.parametrize(("n", "m", "features"), [(700, 600, 300), (300, 320, 500), (400, 290, 350)])
def test_many_pictures_take_the_faster_way_to_the_same_distance(n, m, features, monkeypatch):
    real, fake = points(n, features, 0), points(m, features, 1, 0.1, 1.2)
    asked = []
    monkeypatch.setattr(np.linalg, "svd", lambda *given, **named: asked.append(1))
    fast = frechet_distance(real, fake)
    assert not asked
    monkeypatch.undo()
    monkeypatch.setattr(module, "MANY", 10_000)
    assert frechet_distance(real, fake) == pytest.approx(fast, rel=1e-9)


def test_where_rounding_would_tell_the_slower_way_is_taken():
    real = points(400, 300, 0)
    assert frechet_distance(real, real) == pytest.approx(0, abs=1e-9)
    flat = real * (np.arange(300) < 290)  # ten features that never change: a singular covariance
    assert frechet_distance(flat, real) == pytest.approx(np.var(real[:, 290:], axis=0, ddof=1).sum(), rel=0.2)
    total, uncertain = nuclear_norm(flat, flat)
    assert abs(total - np.linalg.svd(flat @ flat.T, compute_uv=False).sum()) <= uncertain
    total, uncertain = nuclear_norm(real[:100, :40], real[100:200, :40])
    assert 0 < uncertain < 1e-12 * total


@pytest.mark.parametrize(("n", "features"), [(12, 30), (40, 7), (400, 300)])
def test_counts_are_copies(n, features):
    sets = points(n, features, 0), points(n + 3, features, 1, 0.2)
    drawn = [np.random.default_rng(k).integers(0, len(each), len(each)) for k, each in enumerate(sets)]
    counts = tuple(np.bincount(own, minlength=len(each)) for own, each in zip(drawn, sets, strict=True))
    copied = frechet_distance(*(each[own] for own, each in zip(drawn, sets, strict=True)))
    assert frechet_distance(*sets, counts) == pytest.approx(copied, rel=1e-9)


def test_few_pictures_have_the_distances_that_the_guide_names():
    """FID of samples of one distribution is not 0 and hangs on their numbers; KID is, and does not."""
    guide = (REPOSITORY / "docs" / "guide" / "measuring.md").read_text(encoding="utf-8")
    named = [[float(word) for word in row] for row in re.findall(r"([\d.]+) for (\d+) and (\d+)\b", guide)]
    random = np.random.default_rng(1)
    for distance, real, fake in named:
        pairs = [[random.normal(size=(int(count), 64)) for count in (real, fake)] for _ in range(10)]
        assert np.mean([frechet_distance(*pair) for pair in pairs]) == pytest.approx(distance, rel=0.05)
        kernels = [kernel_distance(*pair) for pair in pairs]
        assert abs(np.mean(kernels)) < np.std(kernels)
    assert len(named) == 3


# Kernel distance


def by_pairs(real, fake):
    """The definition, pair by pair (Binkowski et al. 2018, eq. 4)."""

    def kernel(x, y):
        return (x @ y / len(x) + 1) ** 3

    def within(own):
        pairs = [(x, y) for i, x in enumerate(own) for j, y in enumerate(own) if i != j]
        return np.mean([kernel(*pair) for pair in pairs])

    return within(real) + within(fake) - 2 * np.mean([kernel(x, y) for x in real for y in fake])


def test_kid_is_the_definition(monkeypatch):
    monkeypatch.setattr(module, "BLOCK_ROWS", 4)  # several blocks
    real, fake = points(11, 6, 0), points(14, 6, 1, 0.3)
    assert kernel_distance(real, fake) == pytest.approx(by_pairs(real, fake), rel=1e-12)
    with pytest.raises(ValueError, match="1 real and 14 fake"):
        kernel_distance(real[:1], fake)


@pytest.mark.parametrize("scale", [1.0, 1.6])
def test_known_gaussians_have_the_closed_form_of_kid(scale):
    """Of N(0, a^2 I) in d dimensions: z = x.y / d has E z = E z^3 = 0, E z^2 = a^2 b^2 / d, so E k = 1 + 3 E z^2."""
    features, expected = 8, 3 / 8 * (1 + scale**4 - 2 * scale**2)
    random = np.random.default_rng(2)
    values = [
        kernel_distance(random.normal(0, 1, (30, features)), random.normal(0, scale, (25, features)))
        for _ in range(400)
    ]
    error = np.std(values) / np.sqrt(len(values))
    assert abs(np.mean(values) - expected) < 4 * error
    assert expected == 0 or expected > 8 * error


def test_weights_count_pictures_and_never_pair_one_with_itself():
    real, fake = points(6, 5, 0), points(7, 5, 1, 0.4)
    ones = np.ones((6, 2)), np.ones((7, 2))
    ones[0][3, 1] = 0
    values = weighted_distances(real, fake, *ones)
    assert values[0] == pytest.approx(kernel_distance(real, fake), rel=1e-12)
    assert values[1] == pytest.approx(kernel_distance(np.delete(real, 3, axis=0), fake), rel=1e-12)
    twice = np.full((6, 1), 2.0), np.full((7, 1), 2.0)
    assert weighted_distances(real, fake, *twice)[0] == pytest.approx(values[0], rel=1e-12)
    assert kernel_distance(real, real, np.eye(6, dtype=bool)) == pytest.approx(0, abs=1e-12)
    assert kernel_distance(real, real) < -0.01  # a picture with itself counts as likeness of the sets


@pytest.mark.filterwarnings("ignore:Metric `Kernel Inception Distance` will save:UserWarning")
@pytest.mark.parametrize("count", [24, 90])
def test_torchmetrics_agrees(count):
    torch = pytest.importorskip("torch")
    fid, kid = (pytest.importorskip(f"torchmetrics.image.{name}") for name in ("fid", "kid"))

    class Features(torch.nn.Module):
        num_features = 48

        def forward(self, pictures):
            return pictures.double().reshape(len(pictures), -1)[:, :48] / 50

    random = np.random.default_rng(0)
    sets = [random.integers(0, top, (count, 3, 4, 4)).astype(np.uint8) for top in (256, 200)]
    ours = [each.reshape(count, -1) / 50 for each in sets]
    frechet = fid.FrechetInceptionDistance(feature=Features(), input_img_size=(3, 4, 4)).set_dtype(torch.float64)
    kernel = kid.KernelInceptionDistance(feature=Features(), subsets=1, subset_size=count)
    for metric in (frechet, kernel):
        for pictures, is_real in zip(sets, (True, False), strict=True):
            metric.update(torch.from_numpy(pictures), real=is_real)
    assert float(frechet.compute()) == pytest.approx(frechet_distance(*ours), rel=1e-3)
    assert float(kernel.compute()[0]) == pytest.approx(kernel_distance(*ours), rel=1e-3)


# Intervals and small samples, held against drawing new sets

FEATURES = 24


@pytest.mark.parametrize(("shift", "scale"), [(0.0, 1.0), (0.2, 1.3)])
def test_the_frechet_interval_is_as_wide_as_new_sets_vary(shift, scale):
    random = np.random.default_rng(3)

    def sets():
        return points(60, FEATURES, random), points(50, FEATURES, random, shift, scale)

    true = np.array([frechet_distance(*sets()) for _ in range(200)])
    intervals = np.array([frechet_interval(*sets(), 60, seed) for seed in range(20)])
    assert np.count_nonzero((intervals[:, 0] <= true.mean()) & (true.mean() <= intervals[:, 1])) >= 17
    assert 0.8 < np.mean(np.ptp(intervals, axis=1)) / (3.92 * true.std()) < 1.7


@pytest.mark.parametrize(("shift", "scale"), [(0.0, 1.0), (0.3, 1.3)])
def test_the_kernel_interval_covers_what_many_pictures_give(shift, scale):
    random = np.random.default_rng(4)
    many = points(1500, FEATURES, random), points(1500, FEATURES, random, shift, scale)
    true = kernel_distance(*many) if shift else 0.0
    intervals = np.array([
        kernel_estimate(points(60, FEATURES, random), points(50, FEATURES, random, shift, scale), 200, seed)[1]
        for seed in range(20)
    ])  # fmt: skip
    assert np.count_nonzero((intervals[:, 0] <= true) & (true <= intervals[:, 1])) >= 17
    assert (intervals[-1, 0] > 0) == bool(shift)


@pytest.mark.parametrize(("n", "m"), [(16, 16), (12, 30), (80, 60)])
def test_the_same_distribution_value_is_that_of_new_sets(n, m):
    random = np.random.default_rng(7)
    true = [frechet_distance(points(n, FEATURES, random), points(m, FEATURES, random)) for _ in range(100)]
    estimates = [
        same_distribution(points(n, FEATURES, random), points(m, FEATURES, random, 0.5), 20, seed) for seed in range(12)
    ]
    assert np.mean([each.mean for each in estimates]) == pytest.approx(np.mean(true), rel=0.08)
    assert all(each.interval.low < each.mean < each.interval.high for each in estimates)


def test_what_few_pictures_do_to_fid_is_as_large_as_the_features_spread():
    """Of 2048 features whose variances fall as 1/k, two sets of 32 are 1.18 times the total variance apart."""
    sets, total = (points(32, 2048, 0), points(32, 2048, 1)), np.sum(1 / np.arange(1, 2049))
    assert same_distribution(*sets, 20, 0).mean / total == pytest.approx(1.18, abs=0.06)
    assert frechet_distance(*sets) / total == pytest.approx(1.18, abs=0.06)


def test_the_seed_decides_and_steps_are_reported():
    real, fake = points(20, FEATURES, 1), points(18, FEATURES, 2)
    steps: list[None] = []
    first = frechet_interval(real, fake, 30, 5, lambda: steps.append(None))
    assert len(steps) == 30 and first == frechet_interval(real, fake, 30, 5) != frechet_interval(real, fake, 30, 6)
    same = same_distribution(real, fake, 20, 5)
    assert same == same_distribution(real, fake, 20, 5) != same_distribution(real, fake, 20, 6)
    value, interval = kernel_estimate(real, fake, 50, 5)
    assert value == pytest.approx(kernel_distance(real, fake), rel=1e-12)
    assert interval == kernel_estimate(real, fake, 50, 5)[1] != kernel_estimate(real, fake, 50, 6)[1]
    assert np.isfinite(frechet_interval(real[:2], fake[:2], 20, 0)).all()


def test_the_warning_depends_on_what_few_pictures_do():
    extractor = Extractor(metric="FID", described="", features=FEATURES, key=None, function=np.asarray)
    few = points(12, FEATURES, 2), points(12, FEATURES, 3)
    value, same = frechet_distance(*few), same_distribution(*few, 40, 0)
    assert f"{value:.4g} tells no difference" in small_sample_warning(extractor, value, (12, 12), same)
    assert "take KID" in small_sample_warning(extractor, 3 * same.interval.high, (12, 12), same)
    assert small_sample_warning(extractor, 100 * same.mean, (12, 12), same) is None
    assert small_sample_warning(extractor, 1.0, (9, 9), SameDistribution(0.09, same.interval)) is None


@pytest.mark.parametrize(
    ("real", "fake", "names"),
    [
        (points(5, 4, 0), points(1, 4, 1), "1 fake"),
        (points(5, 4, 0) * np.nan, points(5, 4, 1), "real .* finite"),
        (points(5, 4, 0), points(5, 3, 1), "4 and 3"),
    ],
)
def test_bad_features_are_named(real, fake, names):
    with pytest.raises(ValueError, match=names):
        frechet_distance(real, fake)


# Sets of pictures


def looked(folder, count, seed, darker=1.0, advance=lambda: None):
    capture = open_capture(write_pictures(folder, count, seed, darker=darker))
    return extract_features(folder.name, capture, open_extractor(ExtractorChoice(name="pixels16")), None, advance)


def test_sets_are_compared_and_the_same_inputs_give_the_same_numbers(tmp_path):
    extractor, steps = open_extractor(ExtractorChoice(name="pixels16")), []
    real = looked(tmp_path / "a", 14, 0, advance=lambda: steps.append(None))
    fake, dark = looked(tmp_path / "b", 14, 1), looked(tmp_path / "dark", 10, 2, 0.5)
    alike, other = (distribution_distance(extractor, real, each, resamples=40) for each in (fake, dark))
    assert (alike.metric, alike.kernel_metric, alike.real, alike.fake) == ("FD-pixels16", "KD-pixels16", "a", "b")
    assert (other.real_pictures, other.fake_pictures, other.features, len(steps)) == (14, 10, 160, 14)
    assert alike.kernel_interval.low <= 0 <= alike.kernel_interval.high and other.kernel_interval.low > 0
    assert alike.frechet <= alike.same.interval.high < other.frechet
    assert other.frechet_interval.low < other.frechet < other.frechet_interval.high
    assert distribution_distance(extractor, real, dark, resamples=40) == other
    seeded = distribution_distance(extractor, real, dark, resamples=40, seed=1)
    assert seeded.kernel_interval != other.kernel_interval
    own = distribution_distance(extractor, real, real, resamples=30)
    assert (own.frechet, own.kernel) == pytest.approx((0, 0), abs=1e-9)
    assert own.kernel_interval.low < 0 < own.kernel_interval.high
    assert own.shared_pictures == 14 and any("14 pictures are in both sets" in each for each in own.warnings)


def test_repeated_pictures_and_too_few_are_reported(tmp_path):
    folder = write_pictures(tmp_path / "a", 5, 0)
    extractor = open_extractor(ExtractorChoice(name="pixels16"))
    (folder / "copy.png").write_bytes(sorted(folder.iterdir())[0].read_bytes())
    real = extract_features("a", open_capture(folder), extractor, None)
    found = distribution_distance(extractor, real, looked(tmp_path / "b", 5, 1), resamples=20)
    assert any(each.startswith("1 of the 6 real pictures") for each in found.warnings)
    with pytest.raises(ValueError, match="few: 3 pictures"):
        looked(tmp_path / "few", 3, 1)


class Means:
    """An extractor that counts how often it runs."""

    def __init__(self, key):
        self.runs = 0
        self.extractor = Extractor(metric="FD-means", described="means", features=3, key=key, function=self.features)

    def features(self, image):
        self.runs += 1
        return image.mean(axis=(0, 1)).astype(np.float32)


def test_features_are_kept_by_content_and_extractor(tmp_path, monkeypatch):
    monkeypatch.setenv(PLACE, str(tmp_path / "cache"))
    folder = write_pictures(tmp_path / "a", 5, 0)
    means, other, unkept = Means("means"), Means("other"), Means(None)

    def features(of=means):
        return extract_features("a", open_capture(folder), of.extractor, FeatureCache())

    first = features()
    sorted(folder.iterdir())[0].rename(folder / "zebra.png")  # a name is no content
    renamed = features()
    assert means.runs == 5 and sorted(first.hashes) == sorted(renamed.hashes)
    np.testing.assert_array_equal(first.features[0], renamed.features[4])
    for each in (other, unkept, unkept):
        features(each)
    assert (other.runs, unkept.runs) == (5, 10)
    Image.fromarray(np.zeros((9, 9, 3), np.uint8)).save(folder / "zebra.png")
    features()
    assert means.runs == 6
    for file in (tmp_path / "cache" / "means").rglob("*.npy"):
        file.write_bytes(b"torn")
    np.testing.assert_array_equal(features().features[:4], renamed.features[:4])
    assert means.runs == 11
    flat = np.arange(24, dtype=np.uint8)
    assert image_hash(flat.reshape(2, 4, 3)) != image_hash(flat.reshape(4, 2, 3))
    turned = flat.reshape(4, 2, 3).transpose(1, 0, 2)
    assert image_hash(turned) == image_hash(np.ascontiguousarray(turned))


# Resizing and features without weights


@pytest.fixture(scope="module")
def picture():
    return np.random.default_rng(0).integers(64, 192, (90, 120, 3)).astype(np.uint8)


def test_resizing_is_pillows_bicubic_but_for_its_rounding(picture):
    """Pillow rounds twice, between its two passes and after them: half a level each, the first through the filter."""
    ours = resized(picture, 61, 47)
    pillow = np.asarray(Image.fromarray(picture).resize((61, 47), Image.Resampling.BICUBIC), np.float32)
    assert ours.shape == (47, 61, 3) and (ours != np.rint(ours)).mean() > 0.9
    assert np.abs(ours - pillow).max() <= 1.2 and np.abs(ours - pillow).mean() < 0.4


def test_resizing_is_a_bicubic_sum_of_source_pixels(picture):
    """Keys' kernel with a = -0.5, stretched by the scale and normalized, at one pixel."""
    scale = 3.0

    def weights(at, count):
        t = np.abs((np.arange(count) + 0.5 - (at + 0.5) * scale) / scale)
        near, far = 1.5 * t**3 - 2.5 * t**2 + 1, -0.5 * t**3 + 2.5 * t**2 - 4 * t + 2
        values = np.where(t < 1, near, np.where(t < 2, far, 0))
        return values / values.sum()

    expected = np.einsum("y,x,yxc->c", weights(12, 90), weights(20, 120), picture.astype(np.float64))
    np.testing.assert_allclose(resized(picture, 40, 30)[12, 20], expected, atol=1e-3)


def test_fine_stripes_become_gray_and_nothing_leaves_the_range():
    stripes, edge = np.zeros((256, 256, 3), np.uint8), np.zeros((64, 64, 3), np.uint8)
    stripes[:, ::2] = edge[:, 32:] = 255
    assert np.abs(resized(stripes, 60, 60)[:, 3:-3] - 127.5).max() < 3
    larger = resized(edge, 299, 299)
    assert (larger.min(), larger.max()) == (0, 255)


def test_cell_statistics_are_of_color_and_direction(picture):
    flat = np.full((50, 70, 3), (51, 102, 204), np.uint8)
    cells = cell_statistics(flat).reshape(16, 10)
    np.testing.assert_allclose(cells[:, :3], np.tile([0.2, 0.4, 0.8], (16, 1)), atol=1e-6)
    np.testing.assert_allclose(cells[:, 3:], 0, atol=1e-3)
    upright = np.zeros((128, 128, 3), np.uint8)
    upright[:, ::16] = 255
    across, _, down, _ = cell_statistics(upright).reshape(16, 10)[:, 6:].mean(axis=0)
    assert across > 0.05 and down < 1e-6
    assert not np.array_equal(cell_statistics(picture), cell_statistics(picture[::-1]))
