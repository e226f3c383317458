"""Edits of the whole scene: drives, tracks, scale, level and origin; and the cameras that follow them."""

from contextlib import closing
from dataclasses import replace

import numpy as np
import pytest

from gsrain_engine.editor.editor import Editor
from gsrain_engine.editor.edits.actors import (
    RIG,
    drive_along,
    drive_along_own_path,
    duration_of,
    retime_actor,
    set_ego_start,
    set_origin,
    start_of,
    turn_actor,
)
from gsrain_engine.editor.edits.level import (
    find_ground,
    guess_orientation,
    level_from_ground,
    level_from_points,
    oriented,
    set_camera_height,
    set_length,
)
from gsrain_engine.editor.viewport.camera import OrbitCamera
from gsrain_engine.editor.viewport.camera_follow import ActorFollower
from gsrain_engine.scene.camera import Camera, look_at
from gsrain_engine.scene.camera_path import CameraPath
from gsrain_engine.scene.camera_path_edit import WALKING_M_S
from gsrain_engine.scene.gaussians import Gaussians
from gsrain_engine.scene.scene import Layer, PoseTrack, Scene
from gsrain_engine.simulation.ground import recorded_route
from small_scene import small_scene

from .edited_scene import edited_scene, turned

UNIT_M = 0.25
LYING = Scene("lying", up=(0.0, -1.0, 0.0), metres_per_unit=UNIT_M)
"""As of photogrammetry: y down, and a unit of 25 cm."""


def flown(places_m, look=(0.0, 1.0, 0.0)):
    """A path of the scene that lies, whose camera was at places of the world."""
    to_scene = np.linalg.inv(LYING.scene_to_world)[:3, :3]
    poses = [look_at(to_scene @ place, to_scene @ (place + look), np.array([0.0, -1.0, 0.0])) for place in places_m]
    cameras = [Camera.from_fov(160, 90, 40.0, pose) for pose in poses]
    return CameraPath.through([0.5 * k for k in range(len(cameras))], cameras)


STRAIGHT_M = np.column_stack([np.zeros(21), np.arange(21.0), np.full(21, 1.6)])
"""20 m along y, 1.6 m above the origin."""


def test_the_ego_drives_where_the_camera_went_in_meters():
    driven = drive_along(LYING, flown(STRAIGHT_M, (0.0, 1.0, -0.1)))
    route = recorded_route(driven)
    assert route.length_m == pytest.approx(20, abs=0.01)
    assert len(driven.ego.times) == 34  # of 10 samples a second, those at least 0.5 m apart
    assert route.at(5.0) == pytest.approx((0, 5, np.pi / 2), abs=1e-3)
    expected = [[0, -1, 0, 0], [1, 0, 0, 10], [0, 0, 1, 1.6], [0, 0, 0, 1]]
    np.testing.assert_allclose(driven.ego_to_world(5.0), expected, atol=1e-3)
    ahead = driven.rigs[RIG][0].camera_to_ego[:3, 2]
    assert ahead == pytest.approx(np.array([1, 0, -0.1]) / np.hypot(1, 0.1), abs=1e-3)
    assert (driven.rigs[RIG][0].width, driven.rigs[RIG][0].height) == (1600, 900)
    sideways = drive_along(LYING, flown(STRAIGHT_M, (1.0, 0.0, 0.0)))
    assert sideways.rigs[RIG][0].camera_to_ego[:3, 2] == pytest.approx([1, 0, 0])


def test_own_cameras_stay_and_standing_still_is_no_drive():
    rigs = {"mine": drive_along(LYING, flown(STRAIGHT_M)).rigs[RIG]}
    assert drive_along_own_path(replace(LYING, path=flown(STRAIGHT_M), rigs=rigs)).rigs == rigs
    step = drive_along(LYING, flown(np.array([[0.0, 0, 1.6], [0, 0.6, 1.6]])))
    assert recorded_route(step).length_m == pytest.approx(0.6)
    with pytest.raises(ValueError, match="0.5 m"):
        drive_along(LYING, flown(STRAIGHT_M[[0, 0]]))
    with pytest.raises(ValueError, match="no camera path"):
        drive_along_own_path(LYING)


def test_the_ego_starts_where_it_is_put():
    scene, point = replace(edited_scene(), ego=None), np.array([1.0, 2.0, -0.5])
    c, s = np.cos(0.3), np.sin(0.3)
    standing = [[c, -s, 0, 1], [s, c, 0, 2], [0, 0, 1, -0.5 + 1.5], [0, 0, 0, 1]]  # at sensor height
    assert set_ego_start(scene, point, 0.3).ego_to_world(0.0) == pytest.approx(np.array(standing))
    driven = replace(scene, ego=edited_scene().actors[0].track.moved(turned(0, by=(3.0, 1.0, 2.0))))
    put = set_ego_start(driven, point, 0.3)
    assert put.ego_to_world(0.0)[:3, 3] == pytest.approx([1, 2, 1])
    change = put.ego_to_world(2.5) - driven.ego_to_world(2.5)
    assert change == pytest.approx(put.ego_to_world(0.0) - driven.ego_to_world(0.0))
    assert change[:3, :3] == pytest.approx(0)


def test_actors_turn_and_are_retimed():
    scene = edited_scene()
    track = scene.actors[0].track
    to_left = turn_actor(scene, "actors/car", 30.0).actors[0].track
    assert to_left.pose(2.0) == pytest.approx(track.pose(2.0) @ turned(30))
    quick = retime_actor(scene, "actors/car", 1.0, 0.5)
    assert quick.actors[0].track.times == pytest.approx(np.linspace(1, 1.5, 5))
    slow = retime_actor(quick, "actors/car", 1.0, 8.0).actors[0]
    assert slow.track.times.tolist() == [1, 3, 5, 7, 9]
    assert (start_of(slow), duration_of(slow)) == (1.0, 8.0)
    for count, times in ((0, []), (1, [2.5])):
        arrays = (each[:count] for each in (track.times, track.positions, track.quaternions_wxyz, track.valid))
        short = scene.with_member("actors/car", track=PoseTrack(*arrays))
        parked = retime_actor(short, "actors/car", 2.5, 3.0).actors[0]
        assert parked.track.times.tolist() == times
        assert (start_of(parked), duration_of(parked)) == (sum(times), 0.0)
    for key, start_s, duration_s in (
        ("actors/car", 0.0, 0.0), ("actors/car", np.nan, 1.0), ("actors/car", 0.0, np.inf), ("layers/house", 0.0, 1.0)
    ):  # fmt: skip
        with pytest.raises(ValueError, match=key.partition("/")[2]):
            retime_actor(scene, key, start_s, duration_s)


# Scale, level and origin


def test_a_known_length_sets_the_meter():
    scene = edited_scene()
    scaled = set_length(scene, 2.0, 5.0)
    assert (scaled.metres_per_unit, scaled.ground_m) == (1.25, -2.5)
    points = [each.part(each.layers[0]).to_world @ [1.0, 2, 3, 1] for each in (scene, scaled)]
    assert points[1][:3] == pytest.approx(2.5 * points[0][:3])
    for measured, true in ((0.0, 1.0), (1.0, 0.0), (1.0, np.inf)):
        with pytest.raises(ValueError, match="above 0"):
            set_length(scene, measured, true)


def test_up_and_unit_are_set_as_an_importer_needs_them():
    scene = edited_scene()
    assert oriented(scene) is oriented(scene, "-y") is scene
    for axis, up in (("x", (1, 0, 0)), ("y", (0, 1, 0)), ("-x", (-1, 0, 0)), ("-z", (0, 0, -1))):
        assert (oriented(scene, axis).up, oriented(scene, axis).ground_m) == (up, None)
    assert (oriented(scene, None, 1.0).metres_per_unit, oriented(scene, None, 1.0).ground_m) == (1.0, -2.0)
    for scale in (1e-6, 1e6):
        assert oriented(scene, None, scale).metres_per_unit == pytest.approx(scale)
    for wrong, name in ((("w",), "up 'w'"), ((None, 0.9e-6), "scale 9e-07"), ((None, 1.1e6), "scale 1.1e")):
        with pytest.raises(ValueError, match=name):
            oriented(scene, *wrong)


def test_the_mounting_height_of_a_camera_sets_the_meter():
    path = flown(STRAIGHT_M)
    path = replace(path, positions=path.positions + np.outer(path.times_s < 2, [0.0, -4.0, 0.0]))  # not the median
    scene = replace(LYING, ground_m=1.0, path=replace(path, is_timed=False), unit_is_assumed=True)
    scaled = set_camera_height(scene, 1.2)  # it was 0.6 m
    assert (scaled.metres_per_unit, scaled.ground_m) == (pytest.approx(2 * UNIT_M), pytest.approx(2.0))
    assert not scaled.unit_is_assumed
    length_m = 2 * UNIT_M * np.linalg.norm(np.diff(path.positions, axis=0), axis=1).sum()
    assert scaled.path.duration_s == pytest.approx(length_m / WALKING_M_S)
    assert set_camera_height(replace(scene, path=path), 1.2).path is path
    for changes, reason in (({"path": None}, "path"), ({"ground_m": None}, "ground"), ({"ground_m": 2.0}, "0.4 m b")):
        with pytest.raises(ValueError, match=reason):
            set_camera_height(replace(scene, **changes), 1.2)


def tilted():
    """The small scene 2 m up, of 10 cm a unit, as captured by a camera that was 12 degrees off; and its up."""
    scene, turn = small_scene(), turned(12, 0) @ turned(-7, 1) @ turned(0, by=(0.0, 0.0, 20.0))
    layers = tuple(replace(each, to_scene=turn) for each in scene.layers)
    return replace(scene, layers=layers, ego=None, rigs={}, metres_per_unit=0.1, ground_m=None), turn[:3, 2]


def test_three_points_or_the_ground_itself_level():
    scene, up = tilted()
    corners = np.array([[0.0, 0, 0, 1], [30, 0, 0, 1], [0, 5, 0, 1]])
    points = (corners @ scene.part(scene.layers[0]).to_world.T)[:, :3]
    levels = [level_from_points(scene, points[order]) for order in ([0, 1, 2], [0, 2, 1])]  # either way round
    for level in (*levels, level_from_ground(scene)):
        assert level.up == pytest.approx(up, abs=1e-4)
        assert level.ground_m == pytest.approx(2, abs=1e-4)
        assert find_ground(level).up == pytest.approx([0, 0, 1], abs=1e-4)
    with pytest.raises(ValueError, match="one line"):
        level_from_points(scene, np.outer([0.0, 1, 2], [1.0, 2, 3]))


def flat_and_round(*planes, lumps=0, rough_m=0.0):
    """Horizontal planes, of a height and a number of flat Gaussians each, and a ball of round ones 10 m above 0."""
    random, f = np.random.default_rng(0), np.float32
    squares = [np.column_stack([random.uniform(-8, 8, (count, 2)), np.full(count, height)]) for height, count in planes]
    ball = random.normal(size=(lumps, 3))
    ball = [0, 0, 10] + 5 * ball / np.linalg.norm(ball, axis=1, keepdims=True)
    means = np.concatenate([*squares, ball])
    n = len(means)
    means[: n - lumps, 2] += random.uniform(-rough_m, rough_m, n - lumps)
    scales = np.full((n, 3), 0.1)
    scales[: n - lumps, 2] = 0.01
    layer = Layer("all", Gaussians(means.astype(f), scales.astype(f), np.tile(f([1, 0, 0, 0]), (n, 1)), np.ones(n, f),
                                   np.zeros((n, 1, 3), f)))  # fmt: skip
    return Scene("planes", (layer,))


def test_a_plane_of_a_twentieth_is_ground():
    for rough_m in (0.0, 0.05):
        found = find_ground(flat_and_round((0.0, 55), lumps=945, rough_m=rough_m))
        assert found.share == pytest.approx(0.055)
        assert found.up == pytest.approx([0, 0, 1], abs=0.2 * rough_m + 1e-6)
        assert found.point_m[2] == pytest.approx(0, abs=0.2 * rough_m + 1e-6)
    assert find_ground(flat_and_round((0.0, 1000), rough_m=0.1)).share == 1
    for scene in (flat_and_round((0.0, 45), lumps=955), flat_and_round((0.0, 2))):
        with pytest.raises(ValueError, match="No ground"):
            find_ground(scene)


@pytest.mark.parametrize(("roof", "height_m"), [(280, 0.0), (320, 4.0)])
def test_a_roof_loses_two_votes_for_each_sample_below(roof, height_m):
    """The ground has 100 votes; the roof 280 - 2 * 100 or 320 - 2 * 100."""
    assert find_ground(flat_and_round((0.0, 100), (4.0, roof))).point_m[2] == pytest.approx(height_m)


def test_the_orientation_is_guessed_from_the_ground_and_the_scale_from_the_camera_path():
    right = flat_and_round((0.0, 600), lumps=300)
    for axis, to_scene in (("z", np.eye(4)), ("x", turned(0, 90)), ("-z", turned(180, 0))):
        # The file's z axis counts as up, though the ground lies below another one.
        lying = replace(right.with_member("layers/all", to_scene=to_scene), unit_is_assumed=True)
        leveled = guess_orientation(lying)
        assert leveled.up == pytest.approx(to_scene[:3, 2], abs=1e-6), axis
        assert leveled.ground_m == pytest.approx(0, abs=1e-6) and leveled.unit_is_assumed
        assert find_ground(leveled).up == pytest.approx([0, 0, 1], abs=1e-6)
    wall = flat_and_round((0.0, 400), lumps=500)
    both = replace(wall, layers=(*wall.layers, replace(wall.layers[0], name="wall", to_scene=turned(90, 0))))
    assert guess_orientation(both).up == pytest.approx([0, 0, 1], abs=1e-6)  # both are as large
    for nothing_below in (flat_and_round((0.0, 45), lumps=955), flat_and_round((10.0, 200), lumps=1000)):
        guessed = guess_orientation(replace(nothing_below, unit_is_assumed=True))  # the second is a shelf in a ball
        lowest_m = nothing_below.layers[0].gaussians.means[:, 2].min()
        assert (guessed.up, guessed.unit_is_assumed) == (nothing_below.up, True)
        assert lowest_m <= guessed.ground_m < lowest_m + 1.0
    faint = nothing_below.layers[0].gaussians
    faint = replace(nothing_below, layers=(Layer("all", replace(faint, opacities=0.1 * faint.opacities)),))
    assert guess_orientation(faint).ground_m < lowest_m + 1.0
    hidden = nothing_below.with_member("layers/all", visible=False)
    assert guess_orientation(hidden) is hidden
    high = replace(LYING, layers=tuple(replace(each, to_scene=turned(90, 0)) for each in right.layers))
    high = replace(high, path=flown(np.array([[0.0, 0, 3], [1, 0, 3], [2, 0, 3]])), unit_is_assumed=True)
    scaled = guess_orientation(high)
    assert not scaled.unit_is_assumed
    heights = scaled.path.positions @ scaled.scene_to_world[2, :3] + scaled.scene_to_world[2, 3]
    assert np.median(heights) - scaled.ground_m == pytest.approx(1.5)


def test_ground_slopes_by_less_than_60_degrees():
    slope = turned(57, 0)
    found = find_ground(flat_and_round((0.0, 1000), lumps=9).with_member("layers/all", to_scene=slope))
    assert found.up == pytest.approx(slope[:3, 2], abs=1e-6)
    rough_wall = flat_and_round((0.0, 500), (0.05, 500), lumps=9).with_member("layers/all", to_scene=turned(63, 0))
    with pytest.raises(ValueError, match="No ground"):
        find_ground(rough_wall)


def test_the_origin_moves_everything():
    scene = replace(edited_scene(), ego=small_scene().ego, path=flown(STRAIGHT_M))
    point = np.array([1.0, 2.0, 3.0])
    there = set_origin(scene, point)
    assert there.ground_m == -4.0
    to_world, shift = scene.scene_to_world[:3, :3], np.eye(4)
    shift[:3, 3] = -point
    assert there.path.positions @ to_world.T == pytest.approx(scene.path.positions @ to_world.T - point)
    for time_s in (0.0, 2.0):
        for before, after in zip(scene.parts(time_s), there.parts(time_s), strict=True):
            assert after.to_world == pytest.approx(shift @ before.to_world)
        assert there.ego_to_world(time_s) == pytest.approx(shift @ scene.ego_to_world(time_s))


# Cameras


def test_the_camera_sees_the_same_where_the_meter_and_up_change():
    with closing(Editor(edited_scene())) as editor:

        def picture():
            layer = editor.document.scene.layers[1]
            to_camera = (
                editor.viewport.shot(960, 640).camera.world_to_camera @ editor.document.scene.part(layer).to_world
            )
            x, y, z = to_camera[:3, :3] @ layer.gaussians.means.T + to_camera[:3, 3:]
            return np.stack([x / z, y / z])

        before = picture()
        editor.document.edit("Scale", set_length, 2.0, 5.0)
        assert picture() == pytest.approx(before)
        editor.document.undo()
        assert picture() == pytest.approx(before)
        editor.document.edit("Level", level_from_points, np.array([[0.0, 0, 0], [1, 0, 0.0], [0, 1, 0.05]]))
        assert picture() == pytest.approx(before, abs=0.2)  # roll is lost, so it turns about its line of sight


def test_the_camera_follows_an_actor_and_keeps_its_offset():
    scene = replace(edited_scene(), up=(0.0, 0.0, 1.0))
    eye, following = OrbitCamera(position=np.array([-5.0, 1.0, 2.0])), ActorFollower()
    following.follow("actors/car")
    following.ride(scene, 1.0, eye)
    assert eye.position == pytest.approx([-5, 1, 2])
    following.ride(scene, 3.0, eye)
    assert eye.position == pytest.approx([-4, 1, 2])  # two units of half a metre
    assert following.velocity_m_s == pytest.approx([0.5, 0, 0])
    following.ride(scene, 3.0, eye)
    assert following.velocity_m_s is None
    eye.position = eye.position + [0, 3, 0]
    following.ride(scene, 1.0, eye)
    assert eye.position == pytest.approx([-5, 4, 2])
    following.ride(replace(scene, actors=()), 2.0, eye)
    assert (following.key, eye.position[0]) == ("", pytest.approx(-5))
