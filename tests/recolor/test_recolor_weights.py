import numpy as np
import pytest

from gsrain_engine.recolor.weights import MIN_PIECE, STEP, LazyWeights, StoredWeights, weights_of
from gsrain_engine.render.cpu.compositing import color_operator
from gsrain_engine.scene.camera import Camera, look_at

from .test_recolor import around, ball


@pytest.fixture(scope="module")
def both() -> tuple[StoredWeights, LazyWeights]:
    view = color_operator([ball()], around(0.4))
    stored = weights_of(view)
    assert isinstance(stored, StoredWeights)
    return stored, LazyWeights(view)


def test_stored_weights_blend_as_compositing_does(both):
    stored, walked = both
    colors = np.random.default_rng(0).uniform(0, 1, (len(walked.rows), 3)).astype(np.float32)
    left_out = 60 * MIN_PIECE * STEP  # a few dozen splats of each pixel may each lose that much
    np.testing.assert_allclose(stored.blend(colors[stored.rows]), walked.blend(colors), atol=left_out)
    assert walked.blend(colors).max() > 0.5


def test_stored_weights_gather_as_accumulation_does(both):
    stored, walked = both
    image = np.random.default_rng(1).uniform(0, 1, (40, 48, 3)).astype(np.float32)
    expected = walked.accumulate(image)
    np.testing.assert_allclose(stored.accumulate(image), expected[stored.rows], rtol=2e-2, atol=0.05)
    missing = np.setdiff1d(walked.rows, stored.rows)
    assert np.abs(expected[missing]).max(initial=0) < 0.05


def test_forth_and_back_at_once_is_forth_then_back(both):
    stored, _ = both
    r = np.random.default_rng(2)
    colors, trust = r.normal(size=(len(stored.rows), 3)), r.uniform(0, 1, (40, 48))
    colors, trust = colors.astype(np.float32), trust.astype(np.float32)
    expected = stored.accumulate(stored.blend(colors) * trust[..., None])
    np.testing.assert_allclose(stored.normal(colors, trust), expected, rtol=1e-5, atol=1e-5)


def test_evidence_is_the_diagonal(both):
    stored, walked = both
    trust = np.random.default_rng(3).uniform(0, 1, (40, 48)).astype(np.float32)
    squares = stored.squared_sums(trust)
    for n in (0, 7, len(stored.rows) // 2):
        unit = np.zeros((len(stored.rows), 3), np.float32)
        unit[n] = 1
        assert squares[n] == pytest.approx(stored.normal(unit, trust)[n, 0], rel=1e-4)
    ones = np.ones_like(trust)
    np.testing.assert_allclose(stored.squared_sums(ones), walked.squared_sums(ones)[stored.rows], rtol=2e-2, atol=0.01)


def test_pictures_whose_size_is_no_multiple_of_a_tile():
    camera = Camera.from_fov(37, 21, 40, look_at(np.array([4.0, 0, 0]), np.zeros(3), np.array([0.0, 0, 1])))
    view = color_operator([ball()], camera)
    stored = weights_of(view)
    colors = np.ones((len(stored.rows), 3), np.float32)
    np.testing.assert_allclose(
        stored.blend(colors)[..., 0], view.blend(np.ones((len(view.splats), 3), np.float32))[..., 0], atol=0.01
    )
    assert stored.accumulate(stored.blend(colors)).shape == (len(stored.rows), 3)


def test_without_room_nothing_is_stored():
    view = color_operator([ball()], around(0.0))
    assert isinstance(weights_of(view, max_bytes=100), LazyWeights)
    stored = weights_of(view)
    assert stored.nbytes > 100
