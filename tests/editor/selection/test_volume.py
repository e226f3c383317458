"""Selection in 3D: spheres, boxes, growing, shrinking and flood fill."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components

from gsrain_engine.editor.edits.gaussians import CropBox
from gsrain_engine.editor.selection.candidates import combine_selection
from gsrain_engine.editor.selection.volume import Sphere, connected_cells, flood_select, in_volume, near_selection
from gsrain_engine.scene.flags import BitMask
from gsrain_engine.scene.scene import Layer, Scene
from small_scene import patch

from .selection_scenes import cloud, world_means

places = st.tuples(*[st.floats(-8, 8)] * 3)


@settings(max_examples=25)
@given(places, st.floats(0.1, 10))
def test_ball_takes_what_is_within_its_radius(center, radius):
    scene = cloud()
    for key, mask in in_volume(scene, 0.0, Sphere(center, radius)).items():
        distance = np.linalg.norm(world_means(scene, key) - center, axis=1)
        clear = np.abs(distance - radius) > 1e-4
        assert np.array_equal(mask.flags[clear], (distance <= radius)[clear])


@settings(max_examples=25)
@given(places, st.tuples(*[st.floats(0.1, 12)] * 3), st.floats(-180, 180))
def test_box_takes_what_is_between_its_faces(center, size, yaw):
    scene = cloud()
    c, s = np.cos(np.radians(yaw)), np.sin(np.radians(yaw))
    for key, mask in in_volume(scene, 0.0, CropBox(center, size, yaw)).items():
        x, y, z = (world_means(scene, key) - center).T
        beyond = np.abs([c * x + s * y, c * y - s * x, z]) - np.array(size)[:, None] / 2
        clear = np.abs(beyond).min(axis=0) > 1e-4
        assert np.array_equal(mask.flags[clear], (beyond <= 0).all(axis=0)[clear])


N = 120


@settings(max_examples=25)
@given(st.integers(0, 1000), st.floats(0.05, 8))
def test_both_as_all_distances_say(seed, distance_m):
    scene, chosen = cloud(N), np.random.default_rng(seed).random(2 * N) < 0.1
    masks = {"layers/plain": BitMask.of(chosen[:N]), "layers/turned": BitMask.of(chosen[N:])}
    scene = combine_selection(scene, masks, "set")
    points = np.concatenate([world_means(scene, key) for key in masks])
    distances = np.linalg.norm(points[:, None] - points[None], axis=2)
    for inside, from_, to in ((False, chosen, ~chosen), (True, ~chosen, chosen)):
        nearest = np.where(from_, distances, np.inf).min(axis=1)
        clear = np.abs(nearest - distance_m) > 1e-4
        near = near_selection(scene, 0.0, distance_m, inside=inside)
        found = np.concatenate([mask.flags for mask in near.values()])
        assert np.array_equal(found[clear], ((nearest <= distance_m) & to)[clear])


@settings(max_examples=30)
@given(st.integers(0, 2**31), st.integers(1, 300), st.integers(1, 12))
def test_cells_that_are_connected_as_a_graph_says(seed, count, extent):
    cells = np.random.default_rng(seed).integers(-extent, extent + 1, (count, 3))
    near = np.abs(cells[:, None] - cells[None]).max(axis=2) <= 1
    _, labels = connected_components(csr_matrix(near), directed=False)
    assert np.array_equal(connected_cells(cells, count // 2), labels == labels[count // 2])


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
