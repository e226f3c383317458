"""Sets of pictures compared, with features kept by what is in the pictures."""

import numpy as np
import pytest
from PIL import Image

from gsrain_engine.datasets.open_capture import open_capture
from gsrain_engine.evaluation.fid import (
    PLACE,
    FeatureCache,
    distribution_distance,
    extract_features,
    image_hash,
    open_extractor,
)
from gsrain_engine.evaluation.fid_features import Extractor, ExtractorChoice


def _pictures(folder, count, seed, darker=1.0):
    random = np.random.default_rng(seed)
    folder.mkdir()
    for k in range(count):
        values = random.integers(0, 256, (6, 8, 3)) * darker
        Image.fromarray(np.kron(values, np.ones((8, 8, 1))).astype(np.uint8)).save(folder / f"{k:03}.png")
    return folder


class _Means:
    """Counts how often it looks."""

    def __init__(self, key):
        self.looks = 0
        self.extractor = Extractor(metric="FD-means", described="means", features=3, key=key, function=self._look)

    def _look(self, image):
        self.looks += 1
        return image.mean(axis=(0, 1)).astype(np.float32)


def test_two_sets_are_compared_and_the_same_inputs_give_the_same_numbers(tmp_path):
    real, fake = (open_capture(_pictures(tmp_path / name, 14, k)) for k, name in enumerate("ab"))
    dark = open_capture(_pictures(tmp_path / "dark", 10, 2, 0.5))
    extractor = open_extractor(ExtractorChoice(name="pixels16"))
    steps: list[None] = []
    sets = [
        extract_features(each.name, each, extractor, None, lambda: steps.append(None)) for each in (real, fake, dark)
    ]
    assert len(steps) == 38
    alike = distribution_distance(extractor, sets[0], sets[1], resamples=40)
    other = distribution_distance(extractor, sets[0], sets[2], resamples=40)
    assert (alike.metric, alike.kernel_metric, alike.real, alike.fake) == ("FD-pixels16", "KD-pixels16", "a", "b")
    assert (other.real_pictures, other.fake_pictures, other.features) == (14, 10, 160)
    assert alike.kernel_interval.low <= 0 <= alike.kernel_interval.high
    assert other.kernel_interval.low > 0
    assert alike.frechet <= alike.same.interval.high < other.frechet
    assert other.frechet_interval.low < other.frechet < other.frechet_interval.high
    assert "tells no difference" in alike.warnings[0]
    assert distribution_distance(extractor, sets[0], sets[2], resamples=40) == other
    assert (
        distribution_distance(extractor, sets[0], sets[2], resamples=40, seed=1).kernel_interval
        != other.kernel_interval
    )


def test_a_set_compared_with_itself_is_zero_and_said_to_be_the_same(tmp_path):
    extractor = open_extractor(ExtractorChoice(name="pixels16"))
    looked = extract_features("a", open_capture(_pictures(tmp_path / "a", 8, 0)), extractor, None)
    found = distribution_distance(extractor, looked, looked, resamples=30)
    assert found.frechet == pytest.approx(0, abs=1e-9)
    assert found.kernel == pytest.approx(0, abs=1e-12)
    assert found.kernel_interval.low < 0 < found.kernel_interval.high
    assert found.shared_pictures == 8
    assert any("8 pictures are in both sets" in each for each in found.warnings)


def test_repeated_pictures_and_too_few_are_reported(tmp_path):
    folder = _pictures(tmp_path / "a", 5, 0)
    (folder / "copy.png").write_bytes((folder / "000.png").read_bytes())
    extractor = open_extractor(ExtractorChoice(name="pixels16"))
    looked = extract_features("a", open_capture(folder), extractor, None)
    other = extract_features("b", open_capture(_pictures(tmp_path / "b", 5, 1)), extractor, None)
    assert (
        "1 of the 6 real pictures repeat others of them"
        in distribution_distance(extractor, looked, other, resamples=20).warnings
    )
    with pytest.raises(ValueError, match="few: 3 pictures; a distribution takes at least 4"):
        extract_features("few", open_capture(_pictures(tmp_path / "few", 3, 1)), extractor, None)


def test_features_are_kept_by_content_and_extractor(tmp_path, monkeypatch):
    monkeypatch.setenv(PLACE, str(tmp_path / "kept"))
    folder = _pictures(tmp_path / "a", 5, 0)
    means = _Means("means")
    first = extract_features("a", open_capture(folder), means.extractor, FeatureCache())
    (folder / "000.png").rename(folder / "zebra.png")  # a name is no content
    again = extract_features("a", open_capture(folder), means.extractor, FeatureCache())
    assert means.looks == 5
    assert sorted(first.hashes) == sorted(again.hashes)
    np.testing.assert_array_equal(first.features[0], again.features[4])
    other = _Means("other")
    extract_features("a", open_capture(folder), other.extractor, FeatureCache())
    assert other.looks == 5
    Image.fromarray(np.zeros((9, 9, 3), np.uint8)).save(folder / "zebra.png")
    extract_features("a", open_capture(folder), means.extractor, FeatureCache())
    assert means.looks == 6
    for file in (tmp_path / "kept" / "means").rglob("*.npy"):
        file.write_bytes(b"torn")
    np.testing.assert_array_equal(
        extract_features("a", open_capture(folder), means.extractor, FeatureCache()).features[:4], again.features[:4]
    )
    assert means.looks == 11
    unkept = _Means(None)
    for _ in range(2):
        extract_features("a", open_capture(folder), unkept.extractor, FeatureCache())
    assert unkept.looks == 10


def test_the_hash_tells_shapes_apart():
    flat = np.arange(24, dtype=np.uint8)
    assert image_hash(flat.reshape(2, 4, 3)) != image_hash(flat.reshape(4, 2, 3))
    turned = np.arange(24, dtype=np.uint8).reshape(4, 2, 3).transpose(1, 0, 2)
    assert image_hash(turned) == image_hash(np.ascontiguousarray(turned))
