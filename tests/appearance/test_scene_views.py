from dataclasses import replace

import numpy as np
import pytest

from gsrain_engine.appearance.base import RainyView
from gsrain_engine.appearance.scene_views import (
    CACHED_VIEWS,
    CachedViews,
    PlacedCamera,
    ViewChoice,
    chosen_cameras,
    scene_view,
    scene_views,
)
from gsrain_engine.scene.camera import Camera, look_at
from gsrain_engine.scene.scene import ColorGrading, Scene
from rasterized import rasterize
from tests.training.small_street import small_street

UP = np.array([0.0, 0, 1])
AHEAD = PlacedCamera("a", Camera.from_fov(120, 80, 60, look_at(np.array([3.0, 0, 1.6]), np.array([9.0, 0, 1.4]), UP)))


def test_a_view_of_the_street_is_what_the_rasterizer_draws():
    scene = small_street()
    view = scene_view(scene, AHEAD)
    frame = rasterize(scene.parts(0.0), AHEAD.camera)
    opaque = frame.rgba[..., 3] > 0.999
    assert opaque.mean() > 0.5
    np.testing.assert_allclose(view.image[opaque], np.clip(frame.rgba[opaque][:, :3], 0, 1), atol=2e-3)


def test_road_sky_and_car_are_told_apart():
    view = scene_view(small_street(), AHEAD)
    assert view.sky[2:10, 40:80].min() > 0.95
    assert view.depth[2:10, 40:80].max() == 0
    road = view.depth[-3, 60]
    rows = (np.arange(80) + 0.5 - AHEAD.camera.cy) / AHEAD.camera.fy
    drop = -(AHEAD.camera.world_to_camera[1, 2] * rows[-3] + AHEAD.camera.world_to_camera[2, 2])
    assert road == pytest.approx(1.6 / drop, rel=0.25)  # its Gaussians are balls of half a metre
    assert road < view.depth[-10, 60] < view.depth[-20, 60]
    assert view.sky[-5:].max() < 0.05
    assert view.normals[-3, 60, 2] > 0.9  # up, towards the eye
    car = view.vehicles > 0.5
    assert 0.005 < car.mean() < 0.2
    inside = np.median(view.depth[car])
    assert inside == pytest.approx(13.8 - 3, abs=0.3)
    reds = view.image[car]
    assert (reds[:, 0] > reds[:, 1] + 0.2).mean() > 0.9


def test_what_lies_on_the_road_under_a_vehicle_is_its_shadow():
    scene = small_street()
    car = scene.actors[0]
    low = replace(car.gaussians, means=car.gaussians.means * np.float32([1, 1, 0.02]))
    view = scene_view(scene.with_member(car.key, gaussians=low), AHEAD)
    assert view.vehicles.max() == 0
    truck = replace(scene, actors=(replace(car, class_name="pedestrian"),))
    assert scene_view(truck, AHEAD).vehicles.max() == 0


def test_without_a_sky_layer_nothing_above_the_horizon_is_sky_and_nothing_below_is():
    scene = small_street()
    bare = replace(scene, layers=tuple(layer for layer in scene.layers if layer.kind != "sky"))
    view = scene_view(bare, AHEAD)
    assert view.sky[2:10, 40:80].min() > 0.95
    assert view.image[4, 60].min() > 0.6
    down = look_at(np.array([100.0, 0, 9]), np.array([120.0, 0, -9]), UP)  # past the end of the road
    below = scene_view(bare, PlacedCamera("b", Camera.from_fov(40, 30, 40, down)))
    assert below.sky.max() == 0
    assert below.depth.max() == 0


def test_grading_and_wet_colors_are_left_out():
    scene = small_street()
    plain = scene_view(scene, AHEAD)
    graded = scene.with_member("layers/street", grading=ColorGrading(exposure_ev=-2.0))
    wet = scene.with_member("layers/street", wet_sh=scene.layers[0].gaussians.sh * 0)
    for other in (graded, wet):
        np.testing.assert_array_equal(scene_view(other, AHEAD).image, plain.image)


def test_an_empty_scene_is_sky_over_nothing():
    view = scene_view(Scene("empty"), AHEAD)
    assert view.sky[0].min() == 1
    assert view.depth.max() == 0


def test_views_are_drawn_when_asked_for_and_kept_for_a_while():
    scene = small_street()
    made: list[int] = []

    def make(index: int):
        made.append(index)
        return scene_view(scene, replace(AHEAD, name=f"{index}"))

    views = CachedViews(CACHED_VIEWS + 2, make)
    assert made == []
    assert views[-1].name == f"{CACHED_VIEWS + 1}"
    assert views[0] is views[0]
    assert made == [CACHED_VIEWS + 1, 0]
    assert [view.name for view in views[1:3]] == ["1", "2"]
    for index in range(CACHED_VIEWS):
        _ = views[index]
    _ = views[CACHED_VIEWS + 1]
    assert made.count(CACHED_VIEWS + 1) == 2
    with pytest.raises(IndexError):
        views[CACHED_VIEWS + 2]


def test_views_have_the_width_that_is_asked_for():
    scene = small_street()
    views = scene_views(scene, chosen_cameras(scene, ViewChoice(count=2)), 60)
    assert [view.image.shape for view in views] == [(40, 60, 3)] * 2
    assert RainyView(views[0], views[0].image).film is None
