"""Edits of the whole scene: scale, level, origin, ego drive."""

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
TO_WORLD = Scene("lying", up=(0.0, -1.0, 0.0), metres_per_unit=UNIT_M).scene_to_world


def flown(places_m: np.ndarray, look: np.ndarray) -> tuple[Scene, CameraPath]:
    """A photogrammetry's scene, y down and of a unit of 25 cm, and a camera that was at places of the world."""
    scene = Scene("lying", up=(0.0, -1.0, 0.0), metres_per_unit=UNIT_M)
    to_scene = np.linalg.inv(TO_WORLD)
    cameras: list[Camera] = []
    for place in places_m:
        eye, target = (to_scene[:3, :3] @ each for each in (place, place + look))
        cameras.append(Camera.from_fov(160, 90, 40.0, look_at(eye, target, np.array([0.0, -1.0, 0.0]))))
    return scene, CameraPath.through([0.5 * k for k in range(len(cameras))], cameras)


STRAIGHT_M = np.column_stack([np.zeros(21), np.arange(21.0), np.full(21, 1.6)])
"""20 m along y, 1.6 m above the origin."""


def test_it_drives_where_the_camera_went_in_metres():
    scene, path = flown(STRAIGHT_M, np.array([0.0, 1.0, -0.1]))
    driven = drive_along(scene, path)
    route = recorded_route(driven)
    assert route.length_m == pytest.approx(20, abs=0.01)
    assert route.at(5.0) == pytest.approx((0, 5, np.pi / 2), abs=1e-3)
    pose = driven.ego_to_world(5.0)
    assert pose is not None
    np.testing.assert_allclose(pose, [[0, -1, 0, 0], [1, 0, 0, 10], [0, 0, 1, 1.6], [0, 0, 0, 1]], atol=1e-3)


def test_own_cameras_stay_and_standing_still_is_no_drive():
    scene, path = flown(STRAIGHT_M, np.array([0.0, 1.0, 0.0]))
    rigs = {"mine": drive_along(scene, path).rigs[RIG]}
    assert drive_along_own_path(replace(scene, path=path, rigs=rigs)).rigs == rigs
    step = flown(np.array([[0.0, 0, 1.6], [0, 0.6, 1.6]]), np.array([0.0, 1.0, 0.0]))
    assert recorded_route(drive_along(*step)).length_m == pytest.approx(0.6)
    still = flown(STRAIGHT_M[:1].repeat(2, axis=0), np.array([0.0, 1.0, 0.0]))
    with pytest.raises(ValueError, match="less than 0.5 m"):
        drive_along(*still)
    with pytest.raises(ValueError, match="no camera path to drive along"):
        drive_along_own_path(replace(edited_scene(), path=None))


def test_the_ego_starts_where_it_is_put():
    scene, point = replace(edited_scene(), ego=None), np.array([1.0, 2.0, -0.5])
    c, s = np.cos(0.3), np.sin(0.3)
    standing = [[c, -s, 0, 1], [s, c, 0, 2], [0, 0, 1, -0.5 + 1.5], [0, 0, 0, 1]]  # at sensor height
    assert set_ego_start(scene, point, 0.3).ego_to_world(0.0) == pytest.approx(np.array(standing))
    driven = replace(scene, ego=edited_scene().actors[0].track.moved(turned(0, by=(3.0, 1.0, 2.0))))
    put = set_ego_start(driven, point, 0.3)
    shift = put.ego_to_world(0.0)[:3, 3] - driven.ego_to_world(0.0)[:3, 3]
    assert put.ego_to_world(0.0)[:3, 3] == pytest.approx([1, 2, 1])
    assert put.ego_to_world(2.5)[:3, 3] == pytest.approx(driven.ego_to_world(2.5)[:3, 3] + shift)
    assert put.ego_to_world(2.5)[:3, :3] == pytest.approx(driven.ego_to_world(2.5)[:3, :3])


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
    short = [
        PoseTrack(track.times[:n], track.positions[:n], track.quaternions_wxyz[:n], track.valid[:n]) for n in (0, 1)
    ]
    empty, parked = (
        retime_actor(scene.with_member("actors/car", track=each), "actors/car", 2.5, 3.0) for each in short
    )
    assert parked.actors[0].track.times.tolist() == [2.5]
    assert (start_of(empty.actors[0]), duration_of(empty.actors[0])) == (0.0, 0.0)
    for start_s, duration_s in ((0.0, 0.0), (np.nan, 1.0), (0.0, np.inf)):
        with pytest.raises(ValueError, match="longer than 0 s"):
            retime_actor(scene, "actors/car", start_s, duration_s)
    with pytest.raises(ValueError, match="stands still"):
        retime_actor(scene, "layers/house", 0.0, 1.0)


def tilted():
    """The small scene as it would be captured by a camera that nobody levelled: 12 degrees off, a tenth of a metre."""
    scene, turn = small_scene(), turned(12, 0) @ turned(-7, 1)
    layers = tuple(replace(each, to_scene=turn) for each in scene.layers)
    return replace(scene, layers=layers, ego=None, rigs={}, metres_per_unit=0.1, ground_m=None), turn[:3, 2]


def test_a_known_length_sets_the_metre():
    scene = edited_scene()
    scaled = set_length(scene, 2.0, 5.0)
    assert (scaled.metres_per_unit, scaled.ground_m) == (1.25, -2.5)
    points = [each.part(each.layers[0]).to_world @ [1.0, 2, 3, 1] for each in (scene, scaled)]
    assert points[1][:3] == pytest.approx(2.5 * points[0][:3])
    for measured, true in ((0.0, 1.0), (1.0, -1.0), (1.0, np.inf)):
        with pytest.raises(ValueError, match="above 0"):
            set_length(scene, measured, true)


def test_three_points_level():
    scene, up = tilted()
    corners = np.array([[0.0, 0, 0, 1], [30, 0, 0, 1], [0, 5, 0, 1]])
    points = (corners @ scene.part(scene.layers[0]).to_world.T)[:, :3]
    for order in ([0, 1, 2], [0, 2, 1]):  # either way round
        level = level_from_points(scene, points[order])
        assert level.up == pytest.approx(up)
        assert level.ground_m == pytest.approx(0, abs=1e-9)
    with pytest.raises(ValueError, match="one line"):
        level_from_points(scene, np.outer([0.0, 1, 2], [1.0, 2, 3]))


def test_the_ground_itself_levels():
    scene, up = tilted()
    level = level_from_ground(scene)
    assert level.up == pytest.approx(up, abs=1e-4)
    assert level.ground_m == pytest.approx(0, abs=1e-4)
    assert find_ground(level).up == pytest.approx([0, 0, 1], abs=1e-4)


def test_up_and_unit_are_set_as_an_importer_needs_them():
    scene = edited_scene()
    assert oriented(scene) is scene
    assert oriented(scene, "-y") is scene
    for axis, up in (("x", (1, 0, 0)), ("y", (0, 1, 0)), ("-x", (-1, 0, 0)), ("-z", (0, 0, -1))):
        turned_up = oriented(scene, axis)
        assert (turned_up.up, turned_up.ground_m) == (up, None)
    assert (oriented(scene, None, 1.0).metres_per_unit, oriented(scene, None, 1.0).ground_m) == (1.0, -2.0)
    for scale in (1e-6, 1e6):
        assert oriented(scene, None, scale).metres_per_unit == pytest.approx(scale)
    for wrong, name in ((("w",), "up 'w'"), ((None, 0.9e-6), "scale 9e-07"), ((None, 1.1e6), "scale 1.1e")):
        with pytest.raises(ValueError, match=name):
            oriented(scene, *wrong)


def test_the_mounting_height_of_a_camera_sets_the_metre():
    scene, path = flown(STRAIGHT_M, np.array([0.0, 1.0, 0.0]))
    path = replace(path, positions=path.positions + np.outer(path.times_s < 2, [0.0, -4.0, 0.0]))  # not the median
    scene = replace(scene, ground_m=1.0, path=replace(path, is_timed=False), unit_is_assumed=True)
    scaled = set_camera_height(scene, 1.2)  # it was 0.6 m
    assert (scaled.metres_per_unit, scaled.ground_m) == (pytest.approx(2 * UNIT_M), pytest.approx(2.0))
    assert not scaled.unit_is_assumed
    length_m = 2 * UNIT_M * np.linalg.norm(np.diff(path.positions, axis=0), axis=1).sum()
    assert scaled.path.duration_s == pytest.approx(length_m / WALKING_M_S)
    assert set_camera_height(replace(scene, path=path), 1.2).path is path
    lacking = (
        ({"path": None}, "no camera path"),
        ({"ground_m": None}, "no known height"),
        ({"ground_m": 2.0}, "0.4 m b"),
    )
    for changes, reason in lacking:
        with pytest.raises(ValueError, match=reason):
            set_camera_height(replace(scene, **changes), 1.2)


def flat_and_round(*planes, lumps=0):
    """Horizontal planes, of a height and a number of flat Gaussians each, and a ball of round ones 10 m above 0."""
    random, f = np.random.default_rng(0), np.float32
    squares = [np.column_stack([random.uniform(-8, 8, (count, 2)), np.full(count, height)]) for height, count in planes]
    ball = random.normal(size=(lumps, 3))
    ball = [0, 0, 10] + 5 * ball / np.linalg.norm(ball, axis=1, keepdims=True)
    means = np.concatenate([*squares, ball])
    n = len(means)
    scales = np.full((n, 3), 0.1)
    scales[: n - lumps, 2] = 0.01
    layer = Layer("all", Gaussians(means.astype(f), scales.astype(f), np.tile(f([1, 0, 0, 0]), (n, 1)), np.ones(n, f),
                                   np.zeros((n, 1, 3), f)))  # fmt: skip
    return Scene("planes", (layer,))


def test_a_plane_of_a_twentieth_is_ground():
    found = find_ground(flat_and_round((0.0, 55), lumps=945))
    assert found.share == pytest.approx(0.055)
    assert (found.up, found.point_m[2]) == (pytest.approx([0, 0, 1]), pytest.approx(0))
    with pytest.raises(ValueError, match="no plane holds enough"):
        find_ground(flat_and_round((0.0, 45), lumps=955))
    with pytest.raises(ValueError, match="too little"):
        find_ground(flat_and_round((0.0, 2)))


@pytest.mark.parametrize(("roof", "height_m"), [(280, 0.0), (320, 4.0)])
def test_a_roof_loses_two_votes_for_each_sample_below(roof, height_m):
    """The ground has 100 votes; the roof 280 - 2 * 100 or 320 - 2 * 100."""
    assert find_ground(flat_and_round((0.0, 100), (4.0, roof))).point_m[2] == pytest.approx(height_m)


def test_ground_slopes_by_almost_60_degrees_at_most():
    slope = turned(57, 0)
    found = find_ground(flat_and_round((0.0, 1000), lumps=9).with_member("layers/all", to_scene=slope))
    assert found.up == pytest.approx(slope[:3, 2], abs=1e-6)
    rough_wall = flat_and_round((0.0, 500), (0.05, 500), lumps=9).with_member("layers/all", to_scene=turned(63, 0))
    with pytest.raises(ValueError, match="no plane holds enough"):
        find_ground(rough_wall)


def test_the_origin_moves_everything():
    scene = replace(edited_scene(), ego=small_scene().ego)
    point = np.array([1.0, 2.0, 3.0])
    there = set_origin(scene, point)
    assert there.ground_m == -4.0
    for time_s in (0.0, 2.0):
        for before, after in zip(scene.parts(time_s), there.parts(time_s), strict=True):
            assert after.to_world[:3, 3] == pytest.approx(before.to_world[:3, 3] - point)
            assert after.to_world[:3, :3] == pytest.approx(before.to_world[:3, :3])
        assert there.ego_to_world(time_s)[:3, 3] == pytest.approx(scene.ego_to_world(time_s)[:3, 3] - point)


def test_the_camera_sees_the_same_where_the_metre_and_up_change():
    editor = Editor(edited_scene())
    layer = editor.document.scene.layers[1]

    def picture():
        camera = editor.viewport.shot(960, 640).camera
        to_camera = camera.world_to_camera @ editor.document.scene.part(editor.document.scene.layers[1]).to_world
        x, y, z = to_camera[:3, :3] @ layer.gaussians.means.T + to_camera[:3, 3:]
        return np.stack([x / z, y / z])

    before = picture()
    editor.document.edit("Scale", set_length, 2.0, 5.0)
    assert picture() == pytest.approx(before)
    editor.document.undo()
    assert picture() == pytest.approx(before)
    editor.document.edit("Level", level_from_points, np.array([[0.0, 0, 0], [1, 0, 0.0], [0, 1, 0.05]]))
    shift = picture() - before
    assert np.abs(shift).max() < 0.2  # roll is lost, so it turns about its line of sight
    editor.close()


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
