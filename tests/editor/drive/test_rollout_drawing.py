"""A moment of a roll-out as lines in the picture."""

import numpy as np
import pytest

from gsrain_engine.editor.drive import RolloutInScene
from gsrain_engine.editor.overlays_drive import planned_points_m, rollout_overlay
from gsrain_engine.scene.camera import Camera, look_at

from .driven import driven


@pytest.fixture
def shown():
    scene, rollout = driven()
    return RolloutInScene(rollout, scene)


def from_above(height_m=20.0):
    pose = look_at(np.array([5.0, 0, height_m]), np.array([5.0, 0.1, 0]), np.array([0, 1.0, 0]))
    return Camera.from_fov(600, 600, 60.0, pose)


def test_planned_points_lie_on_the_road_half_a_second_apart(shown):
    step = shown.played.rollout.steps[2]
    places = planned_points_m(shown, step, step.time_s)
    assert places[0, :2] == pytest.approx((step.ego.x_m, step.ego.y_m))
    assert np.diff(places[:, 0]) == pytest.approx(np.full(6, 1.0), abs=1e-2)  # 2 m/s
    assert places[:, 2] == pytest.approx(0.04, abs=0.01)
    later = planned_points_m(shown, step, step.time_s + 0.2)
    assert later[0, 0] == pytest.approx(step.ego.x_m + 0.4, abs=1e-2)
    assert later[1:] == pytest.approx(places[1:])  # the plan stays while it is followed


def test_who_is_hit_is_marked_when_it_is_hit(shown):
    camera = from_above()
    hit_s = shown.played.end_s
    early = {box.name: box for box in rollout_overlay(shown, 1.0, camera, from_inside=False).boxes}
    late = {box.name: box for box in rollout_overlay(shown, hit_s, camera, from_inside=False).boxes}
    assert [early[name].is_hit for name in ("lead", "ego")] == [False, False]
    assert [late[name].is_hit for name in ("lead", "ego")] == [True, True]
    assert late["lead"].lines_px.shape == (12, 2, 2)
    width = np.ptp(late["lead"].lines_px[..., 0])
    near = camera.fx / (20.0 - shown.played.rollout.users["lead"].size_lwh_m[2])
    assert width == pytest.approx(shown.played.rollout.users["lead"].size_lwh_m[0] * near, rel=0.05)
