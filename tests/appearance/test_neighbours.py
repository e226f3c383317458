"""Neighbor views that see the same things: in time, across cameras, and by lidar alone."""

from dataclasses import replace

import numpy as np

from appearance.street_views import made_view, street_camera, street_views
from gsrain_engine.appearance.correspondence import rank_neighbors


def test_the_nearest_on_the_way_come_first_and_another_camera_has_a_place():
    views = list(street_views().values())  # first, second, third, left
    assert rank_neighbors(views, 1)[:3] == [(1,), (0,), (1,)]
    assert rank_neighbors(views, 2)[1] == (0, 3)
    assert rank_neighbors(views, 3)[0] == (1, 2, 3)
    assert rank_neighbors(views, 2) == rank_neighbors(views, 2)


def test_views_of_one_camera_are_not_held_back_for_another():
    views = [replace(view, sensor="") for view in street_views().values()]
    assert rank_neighbors(views, 2)[1] == (0, 2)


def test_opposite_views_and_views_without_depth_have_no_neighbours():
    views = street_views()
    camera = street_camera(0.0, np.pi)
    away = made_view(camera, np.full((240, 360), 5.0))
    blind = made_view(camera, np.zeros((240, 360)))
    found = rank_neighbors([views["first"], views["second"], away, blind], 3)
    assert found[0] == (1,)
    assert found[2] == found[3] == ()


def test_a_few_lidar_points_are_enough():
    measured = np.random.default_rng(1).random((240, 360)) < 0.004
    views = [
        replace(view, depth=np.where(measured, view.depth, 0), sky=np.zeros_like(view.sky))
        for view in street_views().values()
    ]
    assert rank_neighbors(views, 1)[:3] == [(1,), (0,), (1,)]


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
