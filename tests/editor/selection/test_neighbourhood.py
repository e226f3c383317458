import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from gsrain_engine.editor.selection.candidates import combine_selection, selected, selected_count
from gsrain_engine.editor.selection.volume import near_selection
from gsrain_engine.scene.flags import BitMask

from .selection_scenes import cloud, world_means

N = 120


def some(seed):
    chosen = np.random.default_rng(seed).random((2, N)) < 0.1
    return combine_selection(
        cloud(N), dict(zip(("layers/plain", "layers/turned"), map(BitMask.of, chosen), strict=True)), "set"
    )


def everything(scene):
    points = np.concatenate([world_means(scene, member.key) for member in scene.members])
    return points, np.concatenate([selected(member).flags for member in scene.members])


def flags_of(found):
    return np.concatenate([mask.flags for mask in found.values()])


@settings(max_examples=25)
@given(st.integers(0, 1000), st.floats(0.05, 8))
def test_both_as_all_distances_say(seed, distance_m):
    scene = some(seed)
    points, chosen = everything(scene)
    distances = np.linalg.norm(points[:, None] - points[None], axis=2)
    for inside, from_, to in ((False, chosen, ~chosen), (True, ~chosen, chosen)):
        nearest = np.where(from_, distances, np.inf).min(axis=1)
        clear = np.abs(nearest - distance_m) > 1e-4
        found = flags_of(near_selection(scene, 0.0, distance_m, inside=inside))
        assert np.array_equal(found[clear], ((nearest <= distance_m) & to)[clear])


@settings(max_examples=15)
@given(st.integers(0, 1000), st.floats(0.1, 3))
def test_what_has_grown_and_shrunk_holds_what_it_was(seed, distance_m):
    before = some(seed)
    larger = combine_selection(before, near_selection(before, 0.0, distance_m), "add")
    back = combine_selection(larger, near_selection(larger, 0.0, distance_m, inside=True), "remove")
    _, was = everything(before)
    _, now = everything(back)
    assert now[was].all()
    assert selected_count(larger) >= selected_count(back) >= selected_count(before)
