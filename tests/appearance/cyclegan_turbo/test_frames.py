"""Sizes, tiles and the way back."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gsrain_engine.appearance.cyclegan_turbo.translator import (
    blend_tiles,
    frame_size,
    resized,
    restore_size,
    split_into_tiles,
)


@pytest.mark.parametrize(
    ("size", "side", "expected"),
    [((640, 960), 512, (512, 768)), ((1280, 1920), 512, (512, 768)), ((900, 1600), 512, (512, 912)),
     ((270, 480), 512, (272, 480)), ((641, 959), None, (640, 960)), ((3, 5), 512, (8, 8))],
)  # fmt: skip
def test_sizes_keep_proportions(size, side, expected):
    assert frame_size(*size, side, 8) == expected


@settings(max_examples=25)
@given(
    st.integers(1, 8), st.integers(1, 8), st.sampled_from([64, 128, 192]), st.integers(0, 160), st.integers(0, 2**32)
)
def test_tiles_cover_everything_and_blend_to_the_same_picture(rows, columns, tile, overlap, seed):
    height, width = 64 * rows, 64 * columns
    windows = split_into_tiles(height, width, tile, overlap, 64)
    picture = np.random.default_rng(seed).random((height, width, 1), dtype=np.float32)
    parts = [picture[w.top : w.top + w.height, w.left : w.left + w.width] for w in windows]
    assert all(w.top % 64 == 0 and w.left % 64 == 0 and w.height <= tile and w.width <= tile for w in windows)
    np.testing.assert_allclose(blend_tiles(parts, windows, overlap), picture, atol=1e-6)


@given(st.integers(1, 30), st.sampled_from([128, 256, 512]), st.sampled_from([0, 64, 100]))
def test_tiles_overlap_as_much_as_asked(columns, tile, overlap):
    starts = [w.left for w in split_into_tiles(64, 64 * columns, tile, overlap, 64)]
    assert starts == sorted(set(starts))
    for before, after in pairwise(starts):
        assert before + tile - after >= min(overlap, tile - 64)


def test_what_the_network_did_not_see_comes_back():
    rng = np.random.default_rng(2)
    clear = resized(rng.random((40, 60, 3), dtype=np.float32), 80, 120) * 0.5 + 0.2
    fine = clear + 0.05 * (np.indices((80, 120)).sum(axis=0) % 2 * 2 - 1)[..., None].astype(np.float32)
    seen = resized(fine, 40, 60)
    darker = restore_size(seen * 0.8, seen, fine, detail=True)
    np.testing.assert_allclose(darker - resized(seen * 0.8, 80, 120), fine - resized(seen, 80, 120), atol=1e-5)
    blurred = restore_size(seen * 0.8, seen, fine, detail=False)
    assert np.abs(np.diff(darker, axis=1)).mean() > 2 * np.abs(np.diff(blurred, axis=1)).mean()
    assert np.array_equal(restore_size(fine, fine, fine, detail=True), fine)
