"""Matching: true views of the street agree, walls hide, the sky only turns, vehicles move; and neighbors share most."""

from dataclasses import replace

import numpy as np
import pytest

from gsrain_engine.appearance.correspondence import MatchOutcome, correspondence, rank_neighbors, warped
from gsrain_engine.scene.camera import Camera

from .street_views import made_view, street_camera, street_views


def _plane_camera(x=0.0, width=40, height=30, yaw=0.0):
    """Looks along +z of the world, from a place on the x axis."""
    turn = np.array([[np.cos(yaw), 0, -np.sin(yaw)], [0, 1, 0], [np.sin(yaw), 0, np.cos(yaw)]])
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = turn, -turn @ [x, 0, 0]
    return Camera(width, height, 20.0, 20.0, width / 2, height / 2, pose)


def centers(width: int, height: int) -> np.ndarray:
    return np.stack(np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5), axis=2)


def test_places_are_those_of_the_papers_equations():
    of, to = street_views()["first"], street_views()["left"]
    found = correspondence(of, to)
    rows, columns = np.nonzero(found.valid & (of.depth > 0))
    assert len(rows) > 10_000
    k_of, k_to = (np.array([[c.fx, 0, c.cx], [0, c.fy, c.cy], [0, 0, 1.0]]) for c in (of.camera, to.camera))
    rotation, shift = of.camera.world_to_camera[:3, :3], of.camera.world_to_camera[:3, 3:]
    pixels = np.stack([columns + 0.5, rows + 0.5, np.ones(len(rows))])
    world = np.linalg.inv(rotation) @ (of.depth[rows, columns] * (np.linalg.inv(k_of) @ pixels) - shift)
    x, y, z = k_to @ (to.camera.world_to_camera[:3, :3] @ world + to.camera.world_to_camera[:3, 3:])
    np.testing.assert_allclose(found.places[rows, columns], np.stack([x / z, y / z], axis=1), atol=1e-3)


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
    # Two pixels away nothing fits any more: the test can tell.
    away = np.abs(warped(np.roll(views[to].image, 2, axis=1), found) - views[of].image)[found.valid]
    assert np.sqrt(np.mean(away**2)) > 2 * np.sqrt(np.mean(wrong**2))


def test_a_view_matches_itself_to_the_last_bit():
    view = street_views()["first"]
    own = correspondence(view, view, skips_edges=False)
    assert own.valid.all()
    np.testing.assert_array_equal(warped(view.image, own), view.image)


def test_a_wall_hides_what_is_behind_it():
    here, other = _plane_camera(0.0), _plane_camera(1.0)
    far = np.full((30, 40), 10.0)
    walled = far.copy()
    walled[:, 10:20] = 2.0  # before the other eye only
    found = correspondence(made_view(here, far), made_view(other, walled))
    # 1 m to the right at 10 m with a focal length of 20 px is 2 px to the left.
    np.testing.assert_allclose(found.places[15, 25], (23.5, 15.5), atol=1e-5)
    outcomes = {0: MatchOutcome.OUTSIDE, 12: MatchOutcome.EDGE, 17: MatchOutcome.HIDDEN, 30: MatchOutcome.MATCHED}
    assert {column: found.outcome[15, column] for column in outcomes} == outcomes
    assert (found.outcome[:, 13:21] == MatchOutcome.HIDDEN).all()
    unknown = correspondence(made_view(here, far), made_view(other, np.zeros((30, 40))))
    assert unknown.outcome[15, 25] == MatchOutcome.UNKNOWN and not unknown.valid.any()


@pytest.mark.parametrize(
    ("depth", "apart", "outcome"),
    [(30, 0.5, MatchOutcome.MATCHED), (30, 0.7, MatchOutcome.HIDDEN), (1, 0.04, MatchOutcome.MATCHED),
     (1, 0.06, MatchOutcome.HIDDEN)],
)  # fmt: skip
def test_depths_of_one_point_differ_by_two_percent_or_five_centimeters(depth, apart, outcome):
    here, there = (made_view(_plane_camera(), np.full((30, 40), each)) for each in (depth, depth + apart))
    assert (correspondence(here, there).outcome == outcome).all()


def test_the_sky_turns_and_does_not_shift():
    nothing, sky = np.zeros((30, 40)), np.ones((30, 40))
    here = made_view(_plane_camera(), nothing, sky=sky)
    shifted = correspondence(here, made_view(_plane_camera(3.0), nothing, sky=sky))
    assert shifted.valid.all()
    np.testing.assert_allclose(shifted.places, centers(40, 30), atol=1e-5)
    rotated = correspondence(here, made_view(_plane_camera(yaw=0.1), nothing, sky=sky))
    assert abs(rotated.places[15, 19:21, 0].mean() - 20) == pytest.approx(20 * np.tan(0.1), rel=0.01)
    wall = correspondence(here, made_view(_plane_camera(3.0), np.full((30, 40), 1e4)))
    assert (wall.outcome == MatchOutcome.HIDDEN).all()


def test_vehicles_match_only_at_one_moment():
    depth, car = np.full((30, 40), 10.0), np.zeros((30, 40))
    car[10:20, 10:20] = 1
    of, to = _plane_camera(), _plane_camera(0.2)
    for mine, theirs, time_s in ((car, None, 0.0), (car, None, 0.1), (None, car, 0.1)):
        here, there = made_view(of, depth, vehicles=mine), made_view(to, depth, vehicles=theirs, time_s=time_s)
        found = correspondence(here, there)
        expected = MatchOutcome.MOVING if time_s else MatchOutcome.MATCHED
        assert (found.outcome[11:19, 11:19] == expected).all() and found.outcome[5, 5] == MatchOutcome.MATCHED


def test_lidar_alone_matches_where_it_measured_and_hides_the_rest():
    here, other = _plane_camera(0.0, 80, 60), _plane_camera(0.5, 80, 60)
    measured = np.random.default_rng(5).random((60, 80)) < 0.06
    of = made_view(here, np.where(measured, 10.0, 0))
    found = correspondence(of, made_view(other, np.where(np.roll(measured, 7), 10.0, 0)))
    inside = measured & (found.outcome != MatchOutcome.OUTSIDE)
    assert found.valid[inside].mean() > 0.95 and not found.valid[~measured].any()
    # A nearer surface on the right hides what lies there, and nothing farther away than a few beams.
    near = correspondence(
        of, made_view(other, np.where(np.roll(measured, 7), np.where(np.arange(80) < 60, 10.0, 5.0), 0))
    )
    assert near.valid[:, :54][inside[:, :54]].mean() > 0.95 and not near.valid[:, 67:].any()


def test_maps_of_features_are_warped_by_the_means_of_their_cells():
    views = street_views()
    found = correspondence(views["second"], views["left"])
    height, width = 30, 45  # 8 x 8 pixels a cell
    grid, valid = found.at(height, width)
    counts = found.valid.reshape(height, 8, width, 8).sum(axis=(1, 3))
    np.testing.assert_array_equal(valid, counts >= 32)
    assert 0.1 < valid.mean() < 0.9
    way = np.where(found.valid[..., None], found.places - centers(360, 240), 0) / (360, 240)
    means = way.reshape(height, 8, width, 8, 2).sum(axis=(1, 3)) / np.maximum(counts, 1)[..., None]
    expected = 2 * (centers(width, height) / (width, height) + means) - 1
    np.testing.assert_allclose(grid, np.where(valid[..., None], expected, -2), atol=1e-4)


# Neighbors


def test_the_nearest_on_the_way_come_first_and_another_camera_has_a_place():
    views = list(street_views().values())  # first, second, third, left
    assert rank_neighbors(views, 1)[:3] == [(1,), (0,), (1,)]
    assert rank_neighbors(views, 2)[1] == (0, 3) and rank_neighbors(views, 3)[0] == (1, 2, 3)
    assert rank_neighbors([replace(view, sensor="") for view in views], 2)[1] == (0, 2)  # all of one camera
    measured = np.random.default_rng(1).random((240, 360)) < 0.004  # a few lidar points are enough
    sparse = [replace(each, depth=np.where(measured, each.depth, 0), sky=np.zeros_like(each.sky)) for each in views]
    assert rank_neighbors(sparse, 1)[:3] == [(1,), (0,), (1,)]


def test_views_of_unknown_pose_and_pictures_of_other_places_have_no_neighbors():
    views = list(street_views().values())
    some = rank_neighbors([views[0], replace(views[1], has_pose=False), *views[2:]], 2)
    assert some[1] == () and 2 in some[0] and not any(1 in others for others in some)
    at_rest = [
        replace(views[0], name=f"{t}", time_s=t, image=np.float32(1 - t / 5) * views[0].image) for t in (0, 1, 3)
    ]
    assert rank_neighbors(at_rest, 1) == [(1,), (0,), (1,)]
    noise = np.random.default_rng(3).random(views[0].image.shape).astype(np.float32)
    stand_in = [views[0], replace(views[0], name="elsewhere", image=noise)]  # the same pose, another street
    assert rank_neighbors(stand_in, 1) == [(), ()]


@pytest.mark.parametrize(("distance", "expected"), [(1, [(1,), (0,)]), (3, [(), ()])])
def test_a_sky_that_two_views_share_makes_no_neighbors(distance, expected):
    sky = np.repeat(np.arange(240)[:, None] < 120, 360, axis=1)
    depth = np.where(sky, 0, 8.0)
    here = made_view(street_camera(0.0, 0.0), depth, sky=sky)
    # Three times as far away is another thing.
    other = made_view(street_camera(0.3, 0.0), distance * depth, sky=sky, name="other")
    assert rank_neighbors([here, other], 1) == expected
