"""Matching: true views of the street agree, walls hide, the sky only turns, vehicles move; and neighbors share most."""

from dataclasses import replace

import numpy as np
import pytest

from appearance.street_views import made_view, street_camera, street_views
from gsrain_engine.appearance.correspondence import MatchOutcome, correspondence, rank_neighbors, warped
from gsrain_engine.scene.camera import Camera


def _plane_camera(x=0.0, width=40, height=30, yaw=0.0):
    """Looks along +z of the world, from a place on the x axis."""
    turn = np.array([[np.cos(yaw), 0, -np.sin(yaw)], [0, 1, 0], [np.sin(yaw), 0, np.cos(yaw)]])
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = turn, -turn @ [x, 0, 0]
    return Camera(width, height, 20.0, 20.0, width / 2, height / 2, pose)


def _plain_place(of, to, u, v, depth):
    """Equations (13)-(15) for one pixel, in matrices."""
    k_of, k_to = (np.array([[c.fx, 0, c.cx], [0, c.fy, c.cy], [0, 0, 1.0]]) for c in (of, to))
    local = depth * np.linalg.inv(k_of) @ [u, v, 1.0]
    world = np.linalg.inv(of.world_to_camera[:3, :3]) @ (local - of.world_to_camera[:3, 3])
    x, y, z = k_to @ (to.world_to_camera[:3, :3] @ world + to.world_to_camera[:3, 3])
    return x / z, y / z


def centers(width: int, height: int) -> np.ndarray:
    return np.stack(np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5), axis=2)


def test_places_are_those_of_the_papers_equations():
    views = street_views()
    of, to = views["first"], views["left"]
    found = correspondence(of, to)
    rows, columns = np.nonzero(found.valid)
    chosen = np.random.default_rng(3).choice(len(rows), 50, replace=False)
    checked = 0
    for row, column in zip(rows[chosen], columns[chosen], strict=True):
        if of.depth[row, column] > 0:
            place = _plain_place(of.camera, to.camera, column + 0.5, row + 0.5, float(of.depth[row, column]))
            np.testing.assert_allclose(found.places[row, column], place, atol=1e-3)
            checked += 1
    assert checked > 20


@pytest.mark.parametrize(
    ("of", "to", "least"), [("first", "second", 0.45), ("second", "first", 0.7), ("left", "second", 0.3)]
)
def test_true_views_of_the_street_agree_where_they_match(of, to, least):
    views = street_views()
    found = correspondence(views[of], views[to])
    assert found.valid.mean() > least
    wrong = np.abs(warped(views[to].image, found) - views[of].image)[found.valid]
    assert np.median(wrong) < 1 / 255
    assert np.mean(wrong.max(axis=1) > 0.1) < 0.02  # thin things, and the shadow of the car that drives
    # Taken two pixels beside, nothing fits any more: the test can tell.
    beside = np.abs(warped(np.roll(views[to].image, 2, axis=1), found) - views[of].image)[found.valid]
    assert np.sqrt(np.mean(beside**2)) > 2 * np.sqrt(np.mean(wrong**2))


def test_there_and_back_leads_home_and_a_view_matches_itself_to_the_last_bit():
    views = street_views()
    there, back = correspondence(views["second"], views["first"]), correspondence(views["first"], views["second"])
    returns = warped(back.places, there)
    known = there.valid & (warped(back.valid[..., None].astype(np.float32), there)[..., 0] > 0.999)
    assert known.mean() > 0.4
    away = np.abs(returns - centers(360, 240)).max(axis=2)[known]
    assert np.mean(away > 0.1) < 0.005 and away.max() < 1.5
    view = views["first"]
    own = correspondence(view, view, skips_edges=False)
    assert own.valid.all()
    np.testing.assert_array_equal(warped(view.image, own), view.image)


def test_a_wall_hides_what_is_behind_it():
    here, beside = _plane_camera(0.0), _plane_camera(1.0)
    far = np.full((30, 40), 10.0)
    walled = far.copy()
    walled[:, 10:20] = 2.0  # before the other eye only
    found = correspondence(made_view(here, far), made_view(beside, walled))
    # 1 m to the right at 10 m with a focal length of 20 px is 2 px to the left.
    np.testing.assert_allclose(found.places[15, 25], (23.5, 15.5), atol=1e-5)
    assert found.outcome[15, 17] == MatchOutcome.HIDDEN
    assert found.outcome[15, 30] == MatchOutcome.MATCHED
    assert found.outcome[15, 0] == MatchOutcome.OUTSIDE
    assert found.outcome[15, 12] == MatchOutcome.EDGE  # the wall's side there is at column 10
    assert (found.outcome[:, 13:21] == MatchOutcome.HIDDEN).all()
    unknown = correspondence(made_view(here, far), made_view(beside, np.zeros((30, 40))))
    assert not unknown.valid.any()
    assert unknown.outcome[15, 25] == MatchOutcome.UNKNOWN


def test_the_sky_turns_and_does_not_shift():
    camera, away, turned = _plane_camera(), _plane_camera(3.0), _plane_camera(yaw=0.1)
    nothing, sky = np.zeros((30, 40)), np.ones((30, 40))
    here = made_view(camera, nothing, sky=sky)
    shifted = correspondence(here, made_view(away, nothing, sky=sky))
    assert shifted.valid.all()
    np.testing.assert_allclose(shifted.places, centers(40, 30), atol=1e-5)
    rotated = correspondence(here, made_view(turned, nothing, sky=sky))
    assert abs(rotated.places[15, 19:21, 0].mean() - 20) == pytest.approx(20 * np.tan(0.1), rel=0.01)
    wall = correspondence(here, made_view(away, np.full((30, 40), 1e4)))
    assert (wall.outcome == MatchOutcome.HIDDEN).all()


def test_vehicles_match_only_at_one_moment():
    camera, beside = _plane_camera(), _plane_camera(0.2)
    depth, car = np.full((30, 40), 10.0), np.zeros((30, 40))
    car[10:20, 10:20] = 1
    of = made_view(camera, depth, vehicles=car)
    at_once = correspondence(of, made_view(beside, depth))
    later = correspondence(of, made_view(beside, depth, time_s=0.1))
    assert at_once.outcome[15, 15] == MatchOutcome.MATCHED
    assert (later.outcome[10:20, 10:20] == MatchOutcome.MOVING).all()
    assert later.outcome[5, 5] == MatchOutcome.MATCHED
    drove_there = correspondence(made_view(camera, depth), made_view(beside, depth, vehicles=car, time_s=0.1))
    assert drove_there.outcome[15, 15] == MatchOutcome.MOVING


def test_lidar_alone_matches_where_it_measured_and_still_knows_what_hides():
    here, beside = _plane_camera(0.0, 80, 60), _plane_camera(0.5, 80, 60)
    measured = np.random.default_rng(5).random((60, 80)) < 0.06
    of = made_view(here, np.where(measured, 10.0, 0))
    found = correspondence(of, made_view(beside, np.where(np.roll(measured, 7), 10.0, 0)))
    inside = measured & (found.outcome != MatchOutcome.OUTSIDE)
    assert found.valid[inside].mean() > 0.95 and not found.valid[~measured].any()
    assert not correspondence(of, made_view(beside, np.where(np.roll(measured, 7), 5.0, 0))).valid.any()


def test_maps_of_features_are_warped_as_plain_averages_say():
    views = street_views()
    found = correspondence(views["second"], views["left"])
    height, width = 30, 45  # 8 x 8 pixels a cell
    grid, valid = found.at(height, width)
    shares = found.valid.reshape(height, 8, width, 8).mean(axis=(1, 3))
    np.testing.assert_array_equal(valid, shares >= 0.5)
    assert grid.shape == (height, width, 2) and 0.1 < valid.mean() < 0.9
    row, column = np.argwhere(valid)[len(np.argwhere(valid)) // 2]
    cell = np.s_[8 * row : 8 * row + 8, 8 * column : 8 * column + 8]
    way = ((found.places - centers(360, 240))[cell][found.valid[cell]]).mean(axis=0) / (360, 240)
    expected = 2 * ((np.array([column, row]) + 0.5) / (width, height) + way) - 1
    np.testing.assert_allclose(grid[row, column], expected, atol=1e-4)
    assert (grid[~valid] == -2).all()


# Neighbors


def test_the_nearest_on_the_way_come_first_and_another_camera_has_a_place():
    views = list(street_views().values())  # first, second, third, left
    assert rank_neighbors(views, 1)[:3] == [(1,), (0,), (1,)]
    assert rank_neighbors(views, 2)[1] == (0, 3) and rank_neighbors(views, 3)[0] == (1, 2, 3)
    assert rank_neighbors([replace(view, sensor="") for view in views], 2)[1] == (0, 2)  # all of one camera
    measured = np.random.default_rng(1).random((240, 360)) < 0.004  # a few lidar points are enough
    sparse = [replace(each, depth=np.where(measured, each.depth, 0), sky=np.zeros_like(each.sky)) for each in views]
    assert rank_neighbors(sparse, 1)[:3] == [(1,), (0,), (1,)]


def test_views_of_unknown_pose_and_pictures_of_other_places_have_no_neighbours():
    views = list(street_views().values())
    assert rank_neighbors([replace(view, has_pose=False) for view in views], 2) == [(), (), (), ()]
    some = rank_neighbors([views[0], replace(views[1], has_pose=False), *views[2:]], 2)
    assert some[1] == ()
    assert 2 in some[0] and not any(1 in others for others in some)
    at_rest = [views[0], replace(views[0], name="later", time_s=1.0, image=0.8 * views[0].image)]
    assert rank_neighbors(at_rest, 1) == [(1,), (0,)]
    noise = np.random.default_rng(3).random(views[0].image.shape).astype(np.float32)
    stand_in = [views[0], replace(views[0], name="elsewhere", image=noise)]  # the same pose, another street
    assert rank_neighbors(stand_in, 1) == [(), ()]


def test_a_sky_that_two_views_share_makes_no_neighbours():
    camera = street_camera(0.0, 0.0)
    depth = np.full((240, 360), 8.0)
    depth[:120] = 0
    view = made_view(camera, depth)
    view = replace(view, sky=(np.arange(240)[:, None] < 120).astype(np.float32).repeat(360, axis=1))
    below = replace(
        view, name="b", camera=street_camera(0.3, 0.0), depth=3 * view.depth
    )  # what stands there is another thing
    assert rank_neighbors([view, replace(view, name="c", camera=street_camera(0.3, 0.0))], 1) == [(1,), (0,)]
    assert rank_neighbors([view, below], 1) == [(), ()]
