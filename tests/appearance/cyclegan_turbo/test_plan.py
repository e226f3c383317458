"""Order of views, and which views each attends to."""

from dataclasses import replace

import numpy as np
import pytest

from gsrain_engine.appearance.base import ClearView
from gsrain_engine.appearance.cyclegan_turbo.cross_view_attention import (
    CrossViewAttention,
    attention_plan,
    plan_outward,
)
from gsrain_engine.scene.camera import Camera, look_at

ROW = [(1, 2), (0, 2), (1, 3), (2, 4), (3, 2)]
"""Five views in a row, each naming its neighbors."""


def sources(plan):
    return {view: sources for step in plan.steps for view, sources in zip(step.views, step.sources, strict=True)}


def test_outward_begins_in_the_middle_and_only_looks_back():
    plan = plan_outward(ROW, 2)
    order = [view for step in plan.steps for view in step.views]
    assert order[0] == 2
    assert sorted(order) == list(range(5))
    for view, looked_at in sources(plan).items():
        assert all(order.index(other) < order.index(view) for other in looked_at)
    assert sources(plan)[2] == ()
    assert all(looked_at for view, looked_at in sources(plan).items() if view != 2)


def test_a_view_looks_at_no_more_than_asked_and_at_the_best_first():
    everybody = [tuple(o for o in (0, 1, 2, 3) if o != view) for view in range(4)]
    assert max(len(looked_at) for looked_at in sources(plan_outward(everybody, 1)).values()) == 1
    assert sources(plan_outward(everybody, 3))[3] == (0, 1, 2)


def test_what_is_apart_gets_its_own_anchor():
    plan = plan_outward([(1,), (0,), (3,), (2,), ()], 2)
    assert [view for view, looked_at in sources(plan).items() if not looked_at] == [0, 2, 4]


def test_a_view_that_is_named_looks_at_who_named_it():
    assert sources(plan_outward([(1,), ()], 2)) == {1: (), 0: (1,)}


def test_features_go_after_their_last_use():
    plan = plan_outward(ROW, 1)
    numbers = {view: number for number, step in enumerate(plan.steps) for view in step.views}
    for view, last in plan.last_use().items():
        assert last == max(numbers[other] for other, looked_at in sources(plan).items() if view in looked_at)


def test_together_groups_look_both_ways():
    plan = plan_outward(ROW, 2, 3, ["s"] * 5)
    assert [len(step.views) for step in plan.steps] == [3, 2]
    first = plan.steps[0]
    both = [(a, b) for a, sa in zip(first.views, first.sources, strict=True) for b in sa if a in sources(plan)[b]]
    assert both
    assert {other for looked_at in first.sources for other in looked_at} <= set(first.views)


def test_together_never_mixes_sizes():
    sizes = ["s", "l", "s", "l", "s"]
    plan = plan_outward(ROW, 2, 3, sizes)
    assert all(len({sizes[view] for view in step.views}) == 1 for step in plan.steps)
    assert sorted(view for step in plan.steps for view in step.views) == list(range(5))


@pytest.fixture
def rig():
    """Two moments of three cameras, released one after the other, before a wall."""
    views = []
    for moment in range(2):
        for i, sensor in enumerate(("left", "front", "right")):
            eye = np.array([0.5 * moment, 0.3 * (1 - i), 1.5])
            camera = Camera.from_fov(48, 32, 60, look_at(eye, eye + np.array([1.0, 0, 0]), np.array([0.0, 0, 1])))
            plane = np.zeros((32, 48), np.float32)
            color = np.zeros((32, 48, 3), np.float32)
            time_s = 0.5 * moment + 0.02 * i
            views.append(ClearView(f"{sensor}{moment}", camera, time_s, color, plane + 9, color, plane, plane, sensor))
    return views


def test_neighbours_are_of_the_same_moment_the_same_camera_or_both(rig):
    def pairs(among):
        plan = attention_plan(rig, CrossViewAttention(among=among, neighbours=2))
        return {(rig[view].name, rig[other].name) for view, found in sources(plan).items() for other in found}

    cameras, time = pairs("cameras"), pairs("time")
    assert cameras and all(a[-1] == b[-1] for a, b in cameras)
    assert time and all(a[:-1] == b[:-1] for a, b in time)
    assert any(a[-1] != b[-1] for a, b in pairs("all"))


def test_views_without_depth_stay_alone(rig):
    blind = [replace(view, depth=np.zeros_like(view.depth)) for view in rig]
    assert not attention_plan(blind, CrossViewAttention()).last_use()
    assert not attention_plan(rig, None).last_use()
    assert not attention_plan(rig, CrossViewAttention(neighbours=0)).last_use()
    assert not attention_plan(rig[:1], CrossViewAttention()).last_use()
