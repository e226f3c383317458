from dataclasses import replace

import numpy as np
import pytest

from gsrain_engine.editor.editor import Editor
from gsrain_engine.editor.edits.floaters import FloaterRules, FloaterSearch
from gsrain_engine.editor.edits.gaussians import box_around
from gsrain_engine.scene.flags import BitMask
from gsrain_engine.scene.gaussians import Gaussians
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


def scene():
    return Scene("cloud", (Layer("cloud", cloud()), Layer("sky", cloud(), "sky")), metres_per_unit=0.5)


def found(scene, rules):
    search = FloaterSearch(scene, rules)
    fractions = [progress.fraction for progress in search.run()]
    assert fractions == sorted(fractions) and set(fractions[-1:]) <= {1.0}
    return {key: mask.indices.tolist() for key, (_, mask) in search.found.items()}


@pytest.mark.parametrize(
    ("rules", "floaters"),
    [
        ({}, []),
        ({"opacity_below": 0.05}, [0]),
        ({"size_above_m": 1.4}, [1]),  # 3 units are 1.5 m
        ({"size_above_m": 1.6}, []),
        ({"isolation_above": 8.0}, [2, 3]),
        ({"opacity_below": 0.05, "size_above_m": 1.0, "isolation_above": 8.0}, [0, 1, 2, 3]),
    ],
)
def test_each_rule_finds_its_own(rules, floaters):
    given = FloaterRules(**({"opacity_below": 0, "size_above_m": 0, "isolation_above": 0} | rules))
    assert found(scene(), given) == {"layers/cloud": floaters}


def test_what_is_locked_hidden_or_deleted_is_no_floater():
    rules = FloaterRules()
    assert found(scene().with_member("layers/cloud", locked=True), rules) == {}
    marks = replace(
        scene().layers[0].marks, hidden=BitMask.of(np.arange(1000) == 2), deleted=BitMask.of(np.arange(1000) == 0)
    )
    assert found(scene().with_member("layers/cloud", marks=marks), rules) == {"layers/cloud": [3]}


def test_a_sky_dome_in_the_same_file_is_no_floater_and_not_in_the_crop_box():
    f, rng = np.float32, np.random.default_rng(1)
    ways = rng.normal(size=(300, 3))
    ways[:, 2] = np.abs(ways[:, 2])
    sky = (200 * ways / np.linalg.norm(ways, axis=1, keepdims=True)).astype(f)
    sky = Gaussians(sky, np.full((300, 3), 20, f), cloud().quaternions[:300], np.full(300, 0.04, f), cloud().sh[:300])
    both = Scene("cloud", (Layer("cloud", Gaussians.concatenate([cloud(), sky])),))
    rules = FloaterRules(opacity_below=0.03, size_above_m=5.0, isolation_above=8.0)
    faint = found(both, rules)
    assert faint == {"layers/cloud": [0, 2, 3, *range(1000, 1300)]}  # so faint, the dome is none
    sky = replace(sky, opacities=np.full(300, 0.9, f))
    both = Scene("cloud", (Layer("cloud", Gaussians.concatenate([cloud(), sky])),))
    assert found(both, rules) == {"layers/cloud": [0, 2, 3]}
    assert max(box_around(both).size_m) < 15


def test_the_job_selects_as_one_step():
    editor = Editor(scene())
    job = editor.floaters.find(FloaterRules())
    job.wait(60)
    assert (editor.floaters.count, job.progress.message) == (3, "3 Gaussians look like floaters and are selected")
    assert editor.document.history.labels == ["Open", "Find floaters"]
    assert editor.document.scene.layers[0].marks.selected.indices.tolist() == [0, 2, 3]
    editor.document.undo()
    assert editor.document.scene.layers[0].marks.selected is None
    editor.close()
