"""Cache of computed wet colors: found by content, replaced whole, and never believed when damaged."""

import logging
from dataclasses import replace

import numpy as np
import pytest

from gsrain_engine.appearance.wet_look.settings import WetSettings
from gsrain_engine.recolor import cached_colors
from gsrain_engine.recolor.cached_colors import cached_wet_scene, wet_color_key
from small_scene import small_scene


def ended(steps):
    while True:
        try:
            next(steps)
        except StopIteration as end:
            return end.value


@pytest.fixture
def computed(monkeypatch):
    """Names of the scenes whose wet colors were computed, in a stand-in for the slow computation."""
    done = []

    def wet_scene(scene, settings=None):
        done.append(scene.name)
        yield None
        for each in scene.members:
            scene = scene.with_member(each.key, wet_sh=each.gaussians.sh - np.float32(0.25))
        return scene

    monkeypatch.setattr(cached_colors, "wet_scene", wet_scene)
    return done


def test_the_second_time_reads_what_the_first_computed(tmp_path, computed):
    scene = small_scene()
    first = ended(cached_wet_scene(scene, folder=tmp_path))
    second = ended(cached_wet_scene(small_scene(), folder=tmp_path))
    assert len(computed) == 1 and second.has_rainy_light
    for one, other in zip(first.members, second.members, strict=True):
        np.testing.assert_array_equal(one.wet_sh, other.wet_sh)
    assert [file.suffix for file in tmp_path.iterdir()] == [".npz"]
    assert ended(cached_wet_scene(first, folder=tmp_path)) is first  # what a scene has is not computed again


def test_other_content_or_settings_are_other_colors(tmp_path, computed):
    scene = small_scene()
    layer = scene.layers[0]
    moved = scene.with_member(layer.key, gaussians=replace(layer.gaussians, means=layer.gaussians.means + 1))
    painted = scene.with_member(layer.key, gaussians=layer.gaussians.with_sh(layer.gaussians.sh * np.float32(0.9)))
    others = [moved, painted, replace(scene, metres_per_unit=2.0), scene.with_member(layer.key, opacity=0.5)]
    keys = [wet_color_key(each) for each in (scene, *others)] + [wet_color_key(scene, WetSettings(seed=1))]
    assert len(set(keys)) == 6
    assert wet_color_key(replace(small_scene(), name="other")) == keys[0]
    for each in (scene, moved):
        ended(cached_wet_scene(each, folder=tmp_path))
    assert len(computed) == 2


@pytest.mark.parametrize("damage", [b"", b"PK\x03\x04 not a whole archive"])
def test_a_damaged_file_is_reported_in_one_sentence_and_computed_again(tmp_path, computed, caplog, damage):
    ended(cached_wet_scene(small_scene(), folder=tmp_path))
    (file,) = tmp_path.iterdir()
    file.write_bytes(damage)
    with caplog.at_level(logging.WARNING, "gsrain"):
        found = ended(cached_wet_scene(small_scene(), folder=tmp_path))
    assert found.has_rainy_light and len(computed) == 2
    (message,) = caplog.messages
    assert str(file) in message and "computed again" in message and "\n" not in message
    ended(cached_wet_scene(small_scene(), folder=tmp_path))
    assert len(computed) == 2


def test_files_of_other_shapes_are_not_believed(tmp_path, computed):
    """A file under this name whose colors do not fit the scene's Gaussians."""
    scene = small_scene()
    ended(cached_wet_scene(scene, folder=tmp_path))
    (file,) = tmp_path.iterdir()
    cached_colors.write_recolored(file, {scene.layers[0].key: np.zeros((3, 1, 3), np.float32)})
    assert ended(cached_wet_scene(small_scene(), folder=tmp_path)).has_rainy_light
    assert len(computed) == 2


def test_old_files_leave_the_cache(tmp_path, computed, monkeypatch):
    monkeypatch.setattr(cached_colors, "_MAX_FILES", 2)
    for seed in range(4):
        ended(cached_wet_scene(small_scene(), WetSettings(seed=seed), folder=tmp_path))
    assert len(list(tmp_path.iterdir())) == 2


def test_a_folder_that_can_not_be_written_costs_the_cache_only(tmp_path, computed, caplog):
    (tmp_path / "file").write_text("")
    found = ended(cached_wet_scene(small_scene(), folder=tmp_path / "file" / "cache"))
    assert found.has_rainy_light and "can't be kept" in caplog.text
