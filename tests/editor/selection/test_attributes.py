from dataclasses import replace

import numpy as np
import pytest

from gsrain_engine.editor.selection import attributes
from gsrain_engine.editor.selection.attributes import (
    ATTRIBUTES,
    BINS,
    AttributeHistogram,
    attribute_inputs,
    layer_names,
    read_attribute,
    select_attribute_range,
)
from gsrain_engine.editor.selection.candidates import all_selected
from gsrain_engine.scene.flags import BitMask, SelectionFlags
from gsrain_engine.scene.scene import Actor, PoseTrack

from .selection_scenes import cloud, pixels_of, shot_at, world_means

KEY = "layers/turned"


@pytest.fixture
def values():
    scene, shot = cloud(), shot_at()
    read = attribute_inputs(scene, 0.0, shot.camera)[KEY]
    return scene, shot, {name: read_attribute(name, read) for name in ATTRIBUTES}


def test_places_and_sizes(values):
    scene, shot, read = values
    means = world_means(scene, KEY)
    assert read["height"] == pytest.approx(means[:, 2], abs=1e-4)
    assert read["distance"] == pytest.approx(np.linalg.norm(means - shot.camera.position, axis=1), rel=1e-4)
    assert read["depth"] == pytest.approx(pixels_of(means, shot.camera)[:, 2], abs=1e-4)
    scales = np.sort(scene.layers[1].gaussians.scales, axis=1)
    assert read["size"] == pytest.approx(3.0 * scales[:, 2], rel=1e-5)  # 1.5 of the layer, 2 m a unit
    assert read["elongation"] == pytest.approx(scales[:, 2] / scales[:, 1], rel=1e-5)
    assert np.array_equal(read["opacity"], scene.layers[1].gaussians.opacities)
    assert set(read["layer"]) == {2.0}
    assert layer_names(scene) == {1: "plain", 2: "turned"}


@pytest.mark.parametrize("name", ATTRIBUTES)
def test_a_range_takes_what_lies_in_it(values, name):
    scene, shot, read = values
    low, high = np.quantile(read[name], (0.2, 0.6)).tolist()
    mask = select_attribute_range(scene, 0.0, shot.camera, name, low, high)[KEY]
    assert np.array_equal(mask.flags, (read[name] >= low) & (read[name] <= high))
    assert mask.size > 0


@pytest.mark.parametrize("name", ATTRIBUTES)
def test_histogram_counts_what_is_shown_and_what_is_selected(name):
    shot = shot_at()
    hidden = BitMask.of(np.arange(300) < 40)
    scene = all_selected(cloud()).with_member("layers/plain", marks=SelectionFlags(hidden=hidden))
    histogram = AttributeHistogram().of(scene, shot, name)
    assert histogram.shown.sum() == 560
    assert histogram.selected.sum() == 300
    low, high = float(histogram.edges[BINS // 4]), float(histogram.edges[BINS // 2])
    found = select_attribute_range(scene, 0.0, shot.camera, name, low, high)
    expected = found[KEY].size + (found["layers/plain"] - hidden).size
    assert histogram.count_within(low, high) == pytest.approx(expected, abs=3)
    everything = select_attribute_range(
        scene, 0.0, shot.camera, name, *histogram.opened(histogram.edges[0], histogram.edges[-1])
    )
    assert everything[KEY].size == 300


def test_a_histogram_is_made_anew_only_where_something_that_it_depends_on_has_changed(monkeypatch):
    made = []
    monkeypatch.setattr(attributes, "attribute_inputs", lambda *each: (made.append(name), attribute_inputs(*each))[1])
    times = np.arange(3.0)
    track = PoseTrack(times, np.stack([times, 0 * times, times], axis=1), np.tile([1.0, 0, 0, 0], (3, 1)), times < 9)
    scene = replace(cloud(), actors=(Actor("car", "car", (4.0, 2.0, 1.5), cloud().layers[0].gaussians, track),))
    histogram = AttributeHistogram()
    for name in ("opacity", "height"):
        for time_s in (0.0, 0.5, 1.0):
            histogram.of(scene, replace(shot_at(), time_s=time_s), name)
    assert made == ["opacity", "height", "height", "height"]  # the actor climbs
