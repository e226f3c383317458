"""FID and KID against torchmetrics, definitions pair by pair, and new sets."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec import structs
from PIL import Image

from gsrain_engine.datasets.open_capture import open_capture
from gsrain_engine.evaluation import fid as module
from gsrain_engine.evaluation.fid import (
    PLACE,
    FeatureCache,
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
from tests.app.picture_sets import write_pictures


def points(count, features, seed, shift=0.0, scale=1.0):
    """Normal points whose axes spread less and less, as features do; `seed` may be a generator."""
    spread = np.arange(1, features + 1) ** -0.5
    return np.random.default_rng(seed).normal(0, 1, (count, features)) * spread * scale + shift


def kernel_distance(real, fake, shared=None):
    """KID with each image once."""
    return float(weighted_distances(real, fake, np.ones((len(real), 1)), np.ones((len(fake), 1)), shared)[0])


# Frechet distance


@given(st.integers(2, 40), st.integers(2, 40), st.integers(1, 30), st.integers(0, 1000), st.floats(0.1, 10))
def test_frechet_distance_is_symmetric_and_scales_with_the_square(n, m, features, seed, scale):
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
def test_large_sets_need_no_singular_values(n, m, features, monkeypatch):
    real, fake = points(n, features, 0), points(m, features, 1, 0.1, 1.2)
    with monkeypatch.context() as patch:
        patch.setattr(np.linalg, "svd", None)
        fast = frechet_distance(real, fake)
    monkeypatch.setattr(module, "MANY", 10_000)
    assert frechet_distance(real, fake) == pytest.approx(fast, rel=1e-9)


def test_singular_values_decide_where_rounding_matters():
    real = points(400, 300, 0)
    assert frechet_distance(real, real) == pytest.approx(0, abs=1e-9)
    flat = real * (np.arange(300) < 290)  # ten constant features: a singular covariance
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


@pytest.mark.parametrize(
    ("measure", "real", "fake", "names"),
    [
        (frechet_distance, points(5, 4, 0), points(1, 4, 1), "1 fake"),
        (frechet_distance, points(5, 4, 0) * np.nan, points(5, 4, 1), "real"),
        (frechet_distance, points(5, 4, 0), points(5, 3, 1), "4 and 3"),
        (kernel_distance, points(1, 4, 0), points(5, 4, 1), "1 real and 5 fake"),
    ],
)
def test_unusable_features_are_refused(measure, real, fake, names):
    with pytest.raises(ValueError, match=names):
        measure(real, fake)


# Kernel distance


def by_pairs(real, fake):
    """The definition, pair by pair (Binkowski et al. 2018, eq. 4)."""

    def kernel(x, y):
        return (x @ y / len(x) + 1) ** 3

    def within(own):
        pairs = [(x, y) for i, x in enumerate(own) for j, y in enumerate(own) if i != j]
        return np.mean([kernel(*pair) for pair in pairs])

    return within(real) + within(fake) - 2 * np.mean([kernel(x, y) for x in real for y in fake])


@pytest.mark.filterwarnings("ignore:Metric `Kernel Inception Distance` will save:UserWarning")
def test_torchmetrics_agrees():
    count = 24
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


def test_kernel_distance_equals_the_definition_for_any_weights(monkeypatch):
    monkeypatch.setattr(module, "BLOCK_ROWS", 4)  # several blocks
    real, fake = points(11, 6, 0), points(14, 6, 1, 0.3)
    weights = np.ones((11, 3)), np.ones((14, 3))
    weights[0][3, 1] = 0
    weights[0][:, 2] = weights[1][:, 2] = 2.0  # an image is no pair with its copy
    whole = by_pairs(real, fake)
    expected = [whole, by_pairs(np.delete(real, 3, axis=0), fake), whole]
    np.testing.assert_allclose(weighted_distances(real, fake, *weights), expected, rtol=1e-12)
    assert kernel_distance(real, real, np.eye(11, dtype=bool)) == pytest.approx(0, abs=1e-12)
    assert kernel_distance(real, real) < -0.01


# Intervals and small samples, compared with new sets

FEATURES = 24


@pytest.mark.parametrize(("shift", "scale"), [(0.0, 1.0), (0.2, 1.3)])
def test_frechet_interval_has_the_width_of_new_sets(shift, scale):
    random = np.random.default_rng(3)

    def sets():
        return points(60, FEATURES, random), points(50, FEATURES, random, shift, scale)

    true = np.array([frechet_distance(*sets()) for _ in range(200)])
    found = [frechet_interval(*sets(), 60, seed) for seed in range(20)]
    intervals = np.array([(each.low, each.high) for each in found])
    assert np.count_nonzero((intervals[:, 0] <= true.mean()) & (true.mean() <= intervals[:, 1])) >= 17
    assert 0.8 < np.mean(np.ptp(intervals, axis=1)) / (3.92 * true.std()) < 1.7


@pytest.mark.parametrize(("n", "m"), [(16, 16), (12, 30), (80, 60)])
def test_same_distribution_is_that_of_new_sets(n, m):
    random = np.random.default_rng(7)
    true = [frechet_distance(points(n, FEATURES, random), points(m, FEATURES, random)) for _ in range(100)]
    estimates = [
        same_distribution(points(n, FEATURES, random), points(m, FEATURES, random, 0.5), 20, seed) for seed in range(12)
    ]
    assert np.mean([each.value for each in estimates]) == pytest.approx(np.mean(true), rel=0.08)
    assert all(each.low < each.value < each.high for each in estimates)


def test_seed_determines_the_intervals():
    real, fake = points(20, FEATURES, 1), points(18, FEATURES, 2)
    for estimate in (frechet_interval, same_distribution, kernel_estimate):
        assert estimate(real, fake, 30, 5) == estimate(real, fake, 30, 5) != estimate(real, fake, 30, 6)
    steps: list[None] = []
    frechet_interval(real, fake, 30, 5, lambda: steps.append(None))
    assert len(steps) == 30
    assert np.isfinite(frechet_interval(real[:2], fake[:2], 20, 0).half_width)


def test_warning_depends_on_the_bias_of_small_samples():
    extractor = Extractor(metric="FID", described="", features=FEATURES, key=None, function=np.asarray)
    few = points(12, FEATURES, 2), points(12, FEATURES, 3)
    value, same = frechet_distance(*few), same_distribution(*few, 40, 0)
    assert f"{value:.4g} tells no difference" in small_sample_warning(extractor, value, (12, 12), same)
    assert "take KID" in small_sample_warning(extractor, 3 * same.high, (12, 12), same)
    assert small_sample_warning(extractor, 100 * same.value, (12, 12), same) is None
    assert small_sample_warning(extractor, 1.0, (9, 9), structs.replace(same, value=0.09)) is None


# Sets of images

PIXELS = open_extractor(ExtractorChoice(name="pixels16"))


def features_of(folder, advance=lambda: None):
    return extract_features(folder.name, open_capture(folder), PIXELS, None, advance)


def test_sets_are_compared(tmp_path):
    steps: list[None] = []
    real = features_of(write_pictures(tmp_path / "a", 14, 0), lambda: steps.append(None))
    fake = features_of(write_pictures(tmp_path / "b", 14, 1))
    dark = features_of(write_pictures(tmp_path / "dark", 10, 2, darker=0.5))
    alike, other = (distribution_distance(PIXELS, real, each, resamples=40) for each in (fake, dark))
    assert (alike.metric, alike.kernel_metric, alike.real, alike.fake) == ("FD-pixels16", "KD-pixels16", "a", "b")
    assert (other.real_pictures, other.fake_pictures, other.features, len(steps)) == (14, 10, 160, 14)
    assert alike.kernel.low <= 0 <= alike.kernel.high and other.kernel.low > 0
    assert alike.frechet.value <= alike.same.high < other.frechet.value
    assert other.frechet.low < other.frechet.value < other.frechet.high
    assert distribution_distance(PIXELS, real, dark, resamples=40) == other
    assert distribution_distance(PIXELS, real, dark, resamples=40, seed=1).kernel != other.kernel
    (tmp_path / "a" / "copy.png").write_bytes(sorted((tmp_path / "a").iterdir())[0].read_bytes())
    own = distribution_distance(PIXELS, features_of(tmp_path / "a"), real, resamples=30)
    assert own.shared_pictures == 14 and any("14 pictures are in both sets" in each for each in own.warnings)
    assert any(each.startswith("1 of the 15 real pictures") for each in own.warnings)
    own = distribution_distance(PIXELS, real, real, resamples=30)
    assert (own.frechet.value, own.kernel.value) == pytest.approx((0, 0), abs=1e-9)


def test_features_are_cached_by_content_and_extractor(tmp_path, monkeypatch):
    monkeypatch.setenv(PLACE, str(tmp_path / "cache"))
    folder = write_pictures(tmp_path / "a", 5, 0)
    runs = dict.fromkeys(("means", "other", None), 0)

    def features(key="means"):
        def means(image):
            runs[key] += 1
            return image.mean(axis=(0, 1)).astype(np.float32)

        extractor = Extractor(metric="FD-means", described="means", features=3, key=key, function=means)
        return extract_features("a", open_capture(folder), extractor, FeatureCache())

    first = features()
    sorted(folder.iterdir())[0].rename(folder / "zebra.png")  # a name is no content
    renamed = features()
    assert sorted(first.hashes) == sorted(renamed.hashes)
    np.testing.assert_array_equal(first.features[0], renamed.features[4])
    for key in ("other", None, None):
        features(key)
    assert runs == {"means": 5, "other": 5, None: 10}
    Image.fromarray(np.zeros((9, 9, 3), np.uint8)).save(folder / "zebra.png")
    features()
    assert runs["means"] == 6
    for file in (tmp_path / "cache" / "means").rglob("*.npy"):
        file.write_bytes(b"torn")
    np.testing.assert_array_equal(features().features[:4], renamed.features[:4])
    assert runs["means"] == 11
    flat = np.arange(24, dtype=np.uint8)
    assert image_hash(flat.reshape(2, 4, 3)) != image_hash(flat.reshape(4, 2, 3))


# Resizing and features without weights


def test_resizing_is_a_bicubic_sum_of_pixels_clipped_to_their_range():
    """Keys' kernel with a = -0.5, stretched by the scale and normalized, at one pixel."""
    picture = np.random.default_rng(0).integers(64, 192, (90, 120, 3)).astype(np.uint8)
    scale = 3.0

    def weights(at, count):
        t = np.abs((np.arange(count) + 0.5 - (at + 0.5) * scale) / scale)
        near, far = 1.5 * t**3 - 2.5 * t**2 + 1, -0.5 * t**3 + 2.5 * t**2 - 4 * t + 2
        values = np.where(t < 1, near, np.where(t < 2, far, 0))
        return values / values.sum()

    expected = np.einsum("y,x,yxc->c", weights(12, 90), weights(20, 120), picture.astype(np.float64))
    np.testing.assert_allclose(resized(picture, 40, 30)[12, 20], expected, atol=1e-3)
    edge = np.zeros((64, 64, 3), np.uint8)
    edge[:, 32:] = 255
    larger = resized(edge, 299, 299)
    assert (larger.shape, larger.min(), larger.max()) == ((299, 299, 3), 0, 255)


def test_cell_statistics_are_color_and_edges_by_direction():
    cells = cell_statistics(np.full((50, 70, 3), (51, 102, 204), np.uint8)).reshape(16, 10)
    np.testing.assert_allclose(cells[:, :3], np.tile([0.2, 0.4, 0.8], (16, 1)), atol=1e-6)
    np.testing.assert_allclose(cells[:, 3:], 0, atol=1e-3)
    upright = np.zeros((128, 128, 3), np.uint8)
    upright[:, ::16] = 255
    cells = cell_statistics(upright).reshape(16, 10)  # a sixteenth of the columns is white
    np.testing.assert_allclose(cells[:, :6], np.tile(np.repeat([1 / 16, 15**0.5 / 16], 3), (16, 1)), atol=1e-6)
    across, _, down, _ = cells[:, 6:].mean(axis=0)
    assert across > 0.05 and down < 1e-6
