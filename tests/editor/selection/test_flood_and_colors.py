import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components

from gsrain_engine.editor.selection.candidates import base_color, base_colors, select_similar_colors
from gsrain_engine.editor.selection.volume import _connected, flood_select
from gsrain_engine.scene.gaussians import SH_C0
from gsrain_engine.scene.scene import ColorGrading, Layer, Scene
from small_scene import patch

from .selection_scenes import cloud


def test_base_colors_are_graded_and_within_bounds():
    scene = cloud()
    part = scene.parts()[0]
    assert base_colors(part) == pytest.approx(np.clip(SH_C0 * part.gaussians.sh[:, 0] + 0.5, 0, 1), abs=1e-6)
    grey = scene.with_member("layers/plain", grading=ColorGrading(saturation=0.0)).parts()[0]
    assert np.ptp(base_colors(grey), axis=1).max() < 1e-5
    assert np.array_equal(base_color(grey, 7), base_colors(grey)[7])


def test_alike_means_each_channel():
    scene = cloud()
    color = base_color(scene.parts()[0], 5)
    for key, mask in select_similar_colors(scene, 0.0, color, 0.2).items():
        difference = np.abs(base_colors(scene.part(scene.member(key))) - color).max(axis=1)
        assert np.array_equal(mask.flags, difference <= np.float32(0.2))
    assert select_similar_colors(scene, 0.0, color, 0.0)["layers/plain"].indices.tolist() == [5]


@settings(max_examples=30)
@given(st.integers(0, 2**31), st.integers(1, 300), st.integers(1, 12))
def test_cells_that_are_connected_as_a_graph_says(seed, count, extent):
    cells = np.random.default_rng(seed).integers(-extent, extent + 1, (count, 3))
    near = np.abs(cells[:, None] - cells[None]).max(axis=2) <= 1
    _, labels = connected_components(csr_matrix(near), directed=False)
    assert np.array_equal(_connected(cells, count // 2), labels == labels[count // 2])


def three_patches():
    """Two red patches 5 m apart, and a green one that touches the first."""
    u, v = np.array([2.0, 0, 0]), np.array([0, 2.0, 0])
    colors = {"red": (0.8, 0.1, 0.1), "far": (0.8, 0.1, 0.1), "green": (0.1, 0.8, 0.1)}
    places = {"red": (0, 0, 0), "far": (7, 0, 0), "green": (-2.1, 0, 0)}
    layers = tuple(Layer(name, patch(places[name], u, v, 12, color)) for name, color in colors.items())
    return Scene("patches", layers)


def test_flood_stops_at_gaps_and_other_colors():
    scene = three_patches()

    def counts(tolerance, reach):
        found = flood_select(scene, 0.0, "layers/red", 30, tolerance, reach)
        return {key.split("/")[1]: mask.size for key, mask in found.items()}

    assert counts(0.1, 2.0) == {"red": 144, "far": 0, "green": 0}
    assert counts(1.0, 2.0) == {"red": 144, "far": 0, "green": 144}
    assert counts(0.1, 40.0) == {"red": 144, "far": 144, "green": 0}
