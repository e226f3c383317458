"""Floaters: by each rule, and never in a sky dome."""

from dataclasses import replace

import numpy as np
import pytest

from gsrain_engine.editor.edits.floaters import FloaterRules, search_floaters
from gsrain_engine.editor.edits.gaussians import box_around
from gsrain_engine.scene.flags import BitMask
from gsrain_engine.scene.gaussians import Gaussians
from gsrain_engine.scene.progress import run_to_end
from gsrain_engine.scene.scene import Layer, Scene


def cloud():
    """A grid with four odd ones: faint (0), large (1), far away (2), not a number (3)."""
    f = np.float32
    grid = np.stack(np.meshgrid(*[np.arange(10.0)] * 3), axis=-1).reshape(-1, 3).astype(f)
    grid[2], grid[3] = (100.0, 0, 0), (np.nan, 0, 0)
    opacities, scales = np.full(1000, 0.9, f), np.full((1000, 3), 0.1, f)
    opacities[0], scales[1, 2] = 0.01, 3.0
    quaternions = np.tile(np.array([1, 0, 0, 0], f), (1000, 1))
    return Gaussians(grid, scales, quaternions, opacities, np.zeros((1000, 1, 3), f))


SCENE = Scene("cloud", (Layer("cloud", cloud()), Layer("sky", cloud(), "sky")), metres_per_unit=0.5)


def found(scene, rules):
    fractions = []
    masks = run_to_end(search_floaters(scene, rules), lambda progress: fractions.append(progress.fraction))
    assert fractions == sorted(fractions) and set(fractions[-1:]) <= {1.0}
    return {key: mask.indices.tolist() for key, (_, mask) in masks.items()}


@pytest.mark.parametrize(
    ("rules", "floaters"),
    [
        ({}, []),
        ({"opacity_below": 0.05}, [0]),
        ({"size_above_m": 1.4}, [1]),  # 3 units are 1.5 m
        ({"size_above_m": 1.6}, []),
        ({"isolation_above": 8.0}, [2, 3]),
        ({"isolation_above": 8.0, "neighbors": 1}, [2, 3]),
        ({"opacity_below": 0.05, "size_above_m": 1.0, "isolation_above": 8.0}, [0, 1, 2, 3]),
    ],
)
def test_each_rule_finds_its_own(rules, floaters):
    given = FloaterRules(**({"opacity_below": 0, "size_above_m": 0, "isolation_above": 0} | rules))
    assert found(SCENE, given) == {"layers/cloud": floaters}


def test_locked_hidden_and_deleted_gaussians_are_no_floaters():
    assert found(SCENE.with_member("layers/cloud", locked=True), FloaterRules()) == {}
    first = np.arange(1000)
    marks = replace(SCENE.layers[0].marks, hidden=BitMask.of(first == 2), deleted=BitMask.of(first == 0))
    assert found(SCENE.with_member("layers/cloud", marks=marks), FloaterRules()) == {"layers/cloud": [3]}


@pytest.mark.parametrize(("opacity", "floaters"), [(0.04, [*range(1000, 1300)]), (0.9, [])])
def test_a_sky_dome_in_the_same_file_is_no_floater_unless_it_is_faint(opacity, floaters):
    f, rng = np.float32, np.random.default_rng(1)
    directions = rng.normal(size=(300, 3))
    directions[:, 2] = np.abs(directions[:, 2])
    means = (200 * directions / np.linalg.norm(directions, axis=1, keepdims=True)).astype(f)
    rest = cloud().take(np.arange(300))
    sky = Gaussians(means, np.full((300, 3), 20, f), rest.quaternions, np.full(300, opacity, f), rest.sh)
    both = Scene("cloud", (Layer("cloud", Gaussians.concatenate([cloud(), sky])),))
    rules = FloaterRules(opacity_below=0.03, size_above_m=5.0, isolation_above=8.0)
    assert found(both, rules) == {"layers/cloud": [0, 2, 3, *floaters]}
    assert opacity < 0.1 or max(box_around(both).size_m) < 15
