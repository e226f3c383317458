"""Edits of lamps, and lamps in edits of the members that carry them."""

from dataclasses import replace

import numpy as np
import pytest

from gsrain_engine.editor.edits.actors import set_origin
from gsrain_engine.editor.edits.lamps import add_lamp, change_lamp, lamp_at, remove_lamp
from gsrain_engine.editor.edits.layers import import_scene, rename
from gsrain_engine.editor.edits.level import set_length
from gsrain_engine.editor.edits.transform import move_member
from gsrain_engine.scene.lamps import Lamp
from gsrain_engine.scene.scene import Actor, PoseTrack, Scene
from small_scene import small_scene

HERE_M = np.array([4.0, -2.0, 3.0])


def lit_scene(**changes) -> Scene:
    """A car at (10, 0, 0) with a headlight, and a lamp at `HERE_M`."""
    scene, pose = replace(small_scene(), **changes), np.eye(4)
    pose[0, 3] = 10.0
    car = Actor("car", "car", (4.0, 2.0, 1.5), scene.layers[0].gaussians, PoseTrack.standing(pose))
    scene = replace(scene, actors=(car,))
    scene = add_lamp(scene, lamp_at(scene, HERE_M))
    return add_lamp(scene, Lamp(name="headlight", position=(2.0, 0.5, 0.6), direction=(1.0, 0.0, 0.0), mount="car"))


def test_a_lamp_is_added_at_a_point_of_the_world():
    lit = lit_scene(metres_per_unit=0.5, up=(0.0, -1.0, 0.0)).lamps_at(0.0)
    np.testing.assert_allclose(lit.positions_m[0], HERE_M, atol=1e-9)
    np.testing.assert_allclose(lit.directions[0], [0.0, 0.0, -1.0], atol=1e-9)


def test_changes_keep_the_cone_in_order_and_refuse_wrong_values():
    scene = change_lamp(lit_scene(), 0, outer_deg=30.0)
    assert (scene.lamps[0].inner_deg, scene.lamps[0].outer_deg) == (30.0, 30.0)
    scene = change_lamp(change_lamp(scene, 0, inner_deg=10.0), 0, inner_deg=50.0)
    assert (scene.lamps[0].inner_deg, scene.lamps[0].outer_deg) == (50.0, 50.0)
    assert scene.lamps[1] == lit_scene().lamps[1]
    for fields, words in (({"intensity_m2": -1.0}, "intensity_m2"), ({"direction": (0.0, 0.0, 0.0)}, "a direction")):
        with pytest.raises(ValueError, match=words):
            change_lamp(scene, 0, **fields)
    with pytest.raises(ValueError, match="There is no lamp 2; the scene has 2"):
        remove_lamp(scene, 2)
    assert [lamp.name for lamp in remove_lamp(scene, 0).lamps] == ["headlight"]


def test_lamps_follow_the_origin_and_the_scale():
    scene = lit_scene()
    moved = set_origin(scene, np.array([1.0, 2.0, 0.5])).lamps_at(0.0).positions_m
    np.testing.assert_allclose(moved, scene.lamps_at(0.0).positions_m - [1.0, 2.0, 0.5], atol=1e-9)
    doubled = set_length(scene, 1.0, 2.0).lamps_at(0.0).positions_m
    np.testing.assert_allclose(doubled, 2 * scene.lamps_at(0.0).positions_m, atol=1e-9)


def test_lamps_follow_their_actor_when_it_is_renamed_scaled_or_imported():
    scene = rename(lit_scene(), "actors/car", "taxi")
    assert [lamp.mount for lamp in scene.lamps] == ["scene", "taxi"]
    larger = move_member(lit_scene(), "actors/car", np.diag([2.0, 2.0, 2.0, 1.0])).lamps_at(0.0).positions_m
    np.testing.assert_allclose(larger, [HERE_M, [24.0, 1.0, 1.2]], atol=1e-9)
    both = import_scene(lit_scene(), lit_scene(metres_per_unit=2.0))
    assert [lamp.mount for lamp in both.lamps] == ["scene", "car", "scene", "car 2"]
    lit = both.lamps_at(0.0).positions_m
    np.testing.assert_allclose(lit[2], HERE_M, atol=1e-9)
    np.testing.assert_allclose(lit[3], [24.0, 1.0, 1.2], atol=1e-9)
