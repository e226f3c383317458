"""Simulated cameras, the classes of what they show, and playback and video of a roll-out between its steps."""

from dataclasses import replace

import msgspec
import numpy as np
import pytest

from gsrain_engine.backends import open_renderer
from gsrain_engine.rain.settings import RainSettings
from gsrain_engine.render.draw import draw
from gsrain_engine.scene.open import load_built_in
from gsrain_engine.simulation import sensors
from gsrain_engine.simulation.agents.base import SensorRequirements
from gsrain_engine.simulation.playback import RolloutPlayback
from gsrain_engine.simulation.sensors import UNKNOWN, RigRenderer, semantic_ids
from gsrain_engine.simulation.simulation import Simulation
from gsrain_engine.simulation.vehicle import Control, VehicleState
from gsrain_engine.simulation.video import RolloutVideo, figure_slots, render_rollout_video
from simulation.small_drive import box_actor, driven, lead, scenario, scene_with_box
from small_scene import small_scene

AHEAD_M, LEFT_M = 1.7, 0.4


def test_a_drive_hands_speed_turn_and_time_to_its_cameras(monkeypatch):
    """The camera is ahead of the rear axle, and to the left: it swings out in a turn."""
    shots = []

    def drawn(renderer, frame):
        shots.append(frame.view)
        return draw(renderer, frame)

    monkeypatch.setattr(sensors, "draw", drawn)
    simulation = Simulation(scenario(turned_deg=30.0, start_s=1.5, speed_m_s=4.0, leave_m=50.0), small_scene())
    simulation.reset()
    simulation.advance(Control(0.0, 0.3))
    (front,) = simulation.rig.cameras
    front.camera_to_ego[:2, 3] = AHEAD_M, LEFT_M
    with open_renderer("cpu") as renderer:
        simulation.render_cameras(RigRenderer(renderer, RainSettings(), (front,), SensorRequirements(("front",))))
    ego = simulation.rollout("nobody").steps[-1].ego
    assert ego.yaw_rate_rad_s > 0.05 and ego.yaw_rad > np.radians(30.0)
    local = np.array([[ego.speed_m_s - ego.yaw_rate_rad_s * LEFT_M, ego.yaw_rate_rad_s * AHEAD_M]])
    np.testing.assert_allclose(shots[0].velocity_m_s, [*VehicleState(0, 0, ego.yaw_rad).to_world(local)[0], 0.0])
    assert shots[0].time_s == pytest.approx(1.5 + 0.25)


def test_cameras_of_a_drive_draw_the_cut_of_large_scenes_except_with_depth(monkeypatch):
    monkeypatch.setattr("gsrain_engine.scene.open._MIN_FOR_TREE", 100)
    scene = small_scene()
    counts, images = {}, {}
    with open_renderer("cpu") as renderer:
        for lod, depth in (("off", False), ("pixel", False), (None, False), ("pixel", True)):
            needs = SensorRequirements(("front",), depth=depth)
            simulation = Simulation(scenario(picture_width_px=64), scene, needs, renderer, lod=lod)
            (view,) = simulation.reset().views.values()
            counts[lod, depth], images[lod, depth] = renderer.statistics.gaussians, view.image
        assert counts["pixel", False] < counts["off", False] == counts[None, False] == counts["pixel", True]
        error = images["pixel", False].astype(float) - images["off", False]
        assert np.abs(error).max() > 0 and np.sqrt(np.mean(error**2)) < 5
        monkeypatch.setattr("gsrain_engine.render.level_of_detail.MIN_GAUSSIANS", 100)
        by_size = Simulation(scenario(picture_width_px=64), scene, SensorRequirements(("front",)), renderer)
        (view,) = by_size.reset().views.values()
        assert view.image.tobytes() == images["pixel", False].tobytes()


def test_every_layer_of_the_street_and_every_actor_has_a_class():
    street = load_built_in()
    ids = dict(zip(("nothing", *(each.name for each in street.members)), semantic_ids(street).tolist(), strict=True))
    assert UNKNOWN not in ids.values()
    named = {"nothing": 10, "road": 0, "pavements": 1, "houses": 2, "trees": 8, "sky": 10, "lead": 13}
    assert named.items() <= ids.items()
    actors = tuple(box_actor(name) for name in ("truck", "pedestrian", "dinosaur"))
    scene = replace(small_scene(), actors=tuple(replace(each, class_name=each.id) for each in actors))
    assert semantic_ids(scene).tolist() == [10, 0, UNKNOWN, 10, 14, 11, UNKNOWN]


# Playback

RIGHT, LEFT = -np.pi + 0.2, np.pi - 0.2
"""Headings on both sides of the cut."""


@pytest.fixture(scope="module")
def rollout():
    """A drive of a second at 4 m/s; its ego vehicle and its lead turn over the cut, and the lead goes at the end."""
    found = driven({"road_users": [lead(ahead_m=20.0)], "duration_s": 1.0, "start_s": 0.5}, scene_with_box())
    steps = list(found.steps)
    for place, yaw in enumerate((LEFT, RIGHT)):
        ego, user = (msgspec.structs.replace(each, yaw_rad=yaw) for each in (steps[place].ego, steps[0].road_users[0]))
        steps[place] = msgspec.structs.replace(steps[place], ego=ego, road_users=(user,))
    steps[-1] = msgspec.structs.replace(steps[-1], road_users=())
    return msgspec.structs.replace(found, steps=tuple(steps))


def test_at_a_step_everybody_is_as_recorded_and_between_two_halfway_the_shorter_turn(rollout):
    played = RolloutPlayback(rollout, scene_with_box())
    for step in rollout.steps:
        state = played.state(step.time_s)
        assert (state.x_m, state.y_m, state.speed_m_s) == (step.ego.x_m, step.ego.y_m, step.ego.speed_m_s)
        assert played.step(step.time_s) is step and played.step(step.time_s + 0.1) is step
        assert [user.x_m for user in played.users(step.time_s)] == [user.x_m for user in step.road_users]
    first, second = (step.ego for step in rollout.steps[:2])
    half = played.state(0.125)
    assert half.x_m == pytest.approx((first.x_m + second.x_m) / 2) and second.x_m > first.x_m
    assert np.cos(half.yaw_rad) == pytest.approx(-1.0) == np.cos(played.users(0.125)[0].yaw_rad)
    # A road user that goes is there until the step is over; before and after the drive all stands.
    assert [len(played.scene(time_s).actors) for time_s in (0.75, 0.99, 1.0, 5.0)] == [1, 1, 0, 0]
    assert played.state(-1.0) == played.state(0.0) and played.state(9.0) == played.state(1.0)
    assert (played.end_s, played.scene_time_s(0.25)) == (1.0, 0.75)
    odd = msgspec.structs.replace(rollout, scenario={**rollout.scenario, "speed_m_s": -1.0})
    with pytest.raises(ValueError, match=r"`\$.speed_m_s`"):
        RolloutPlayback(odd, scene_with_box())


# Video


def test_a_video_shows_the_camera_the_values_and_the_road_from_above(tmp_path):
    fields = {"road_users": [lead(ahead_m=8.0)], "picture_width_px": 320}
    played = RolloutPlayback(driven(fields, scene_with_box()), scene_with_box())
    with open_renderer("cpu") as renderer:
        video = RolloutVideo(played, renderer)
        picture, last = video.picture(0.0), video.picture(played.end_s)
        steps = list(render_rollout_video(tmp_path / "run.mp4", video, 2.0))
    assert len(steps) == len(video.times(2.0)) == 5 and steps[-1].fraction == 1.0
    assert (tmp_path / "run.mp4").stat().st_size > 1000
    top = round(320 * played.rig.cameras[0].height / played.rig.cameras[0].width)
    letters, before = ((picture[top : top + 23] != (18, 20, 24)).any(axis=(0, 2)), 0)
    for slot in figure_slots(320):
        if slot.line == 0:  # a long name ends in its slot
            left, right = round(slot.left_px), min(round(slot.left_px + slot.room_px), 320)
            assert letters[left : right - 1].any() and not letters[before:left].any()
            before = right - 1
    assert figure_slots(320)[-1].line == 1 and np.ptp(picture[top + 23 : top + 46]) > 100
    red = [((each[..., 0] > 200) & (each[..., 1] < 120) & (each[..., 2] < 120))[top + 46 :] for each in (picture, last)]
    assert red[1].any() and not red[0].any()  # the road user that was hit
