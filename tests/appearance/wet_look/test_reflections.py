"""Water and its reflections: the mirror's picture of a made room, and a pole on a wet road before a wall."""

from functools import cache

import numpy as np
import pytest

from gsrain_engine.appearance.base import ClearView
from gsrain_engine.appearance.normals import view_rays, world_points
from gsrain_engine.appearance.scene_views import PlacedCamera, scene_view
from gsrain_engine.appearance.wet_look.environment import ImageEnvironment, SceneEnvironment
from gsrain_engine.appearance.wet_look.ground_plane import GroundPlane
from gsrain_engine.appearance.wet_look.masks import VisibleGround
from gsrain_engine.appearance.wet_look.reflections import mirror_camera, screen_space_reflection
from gsrain_engine.appearance.wet_look.water import water_layer_of
from gsrain_engine.scene.camera import Camera, look_at
from gsrain_engine.scene.gaussians import Gaussians
from gsrain_engine.scene.geometry import srgb_to_linear
from gsrain_engine.scene.scene import Layer, Scene
from small_scene import patch

LEVEL = GroundPlane(np.array([0.0, 0, 1]), 0.0)
EYE = Camera(160, 120, 120.0, 120.0, 80.0, 60.0, look_at(np.array([0, 0, 1.5]), np.array([10, 0, 1.0]), np.eye(3)[2]))
WALL_M, TOP_M = 12.0, 4.0


def test_rays_find_what_the_view_shows_above_the_ground():
    """The mirrored camera sees a wall behind level ground at the height at which the view has it."""
    rays = view_rays(EYE)
    to_wall = WALL_M / rays[..., 0]
    to_ground = np.where(rays[..., 2] < 0, -1.5 / np.minimum(rays[..., 2], -1e-9), np.inf)
    is_ground = to_ground < to_wall
    is_sky = ~is_ground & (1.5 + to_wall * rays[..., 2] > TOP_M)
    depth = np.where(is_sky, 0, np.minimum(to_wall, to_ground)).astype(np.float32)
    normals = np.where(is_ground[..., None], [0, 0, 1.0], [-1.0, 0, 0]).astype(np.float32)
    nothing, image = np.zeros_like(depth), np.zeros((*depth.shape, 3), np.float32)
    view = ClearView("room", EYE, 0.0, image, depth, normals, is_sky.astype(np.float32), nothing)
    share, points = is_ground.astype(np.float32), world_points(depth, EYE)
    camera = mirror_camera(EYE, LEVEL, 1.0)
    found = screen_space_reflection(view, VisibleGround(LEVEL, share, nothing, points, normals, nothing), camera)

    rays = view_rays(camera)
    height = camera.position[2] + rays[..., 2] * WALL_M / rays[..., 0]
    start = -camera.position[2] / np.maximum(rays[..., 2], 1e-9)
    is_wall = (height > 0.1) & (height < TOP_M - 0.2) & (start * rays[..., 0] < WALL_M - 0.5)
    point = np.stack([np.full(height.shape, WALL_M), rays[..., 1] * WALL_M / rays[..., 0], height], axis=-1)
    local = point @ EYE.world_to_camera[:3, :3].T + EYE.world_to_camera[:3, 3]
    expected = local[..., :2] / local[..., 2:] * 120 + [80, 60]
    inside = is_wall & (expected > 2).all(axis=-1) & (expected[..., 0] < 158)
    assert inside.sum() > 500 and found.found[inside].mean() > 0.99
    both = inside & found.found
    assert np.quantile(np.abs(found.places - expected).max(axis=-1)[both], 0.99) < 1.5
    np.testing.assert_allclose(found.depth[both], WALL_M / rays[..., 0][both], rtol=0.02)


# Water

FOOT, POLE_M = np.array([9.0, 0.0, 0.0]), 1.6
POLE_POSE = look_at(np.array([0.0, 0.3, 1.5]), np.array((9.0, 0.0, 0.2)), np.eye(3)[2])
POLE_CAMERA = PlacedCamera("eye", Camera(240, 160, 200.0, 200.0, 120.0, 80.0, POLE_POSE))


def pole_scene():
    road = patch((-2, -8, 0), np.array([32.0, 0, 0]), np.array([0, 16.0, 0]), 160, (0.3, 0.3, 0.3))
    wall = patch((30, -16, 0), np.array([0, 32.0, 0]), np.array([0, 0, 10.0]), 40, (0.6, 0.6, 0.65))
    poles = [patch(FOOT + [0, y, 0], np.array([0, 0.05, 0]), np.array([0, 0, POLE_M]), 12, (0.95, 0.1, 0.1))
             for y in (-0.05, 0.0)]  # fmt: skip
    layers = (Layer("road", road), Layer("wall", wall), Layer("pole", Gaussians.concatenate(poles)))
    return Scene("pole", layers, ground_m=0.0)


SCENE = pole_scene()


@cache
def visible():
    return scene_view(SCENE, POLE_CAMERA)


def look(view: ClearView):
    return srgb_to_linear(view.image).astype(np.float32)


def water(wetness=1.0, surroundings=None):
    return water_layer_of(visible(), look(visible()), surroundings or SceneEnvironment(SCENE), look, wetness, 0)


@cache
def wet():
    """The layer of a soaked road, reflecting the scene."""
    found = water()
    assert found is not None
    return found


def pixel(point):
    local = POLE_POSE[:3] @ [*point, 1.0]
    return local[:2] / local[2] * 200 + [120, 80]


@pytest.mark.parametrize("kind", ["scene", "picture"])
def test_a_reflection_begins_at_the_foot_and_ends_where_the_mirrored_top_is(kind):
    found = wet() if kind == "scene" else water(surroundings=ImageEnvironment())
    light = found.color / np.maximum(found.share, 1e-6)[..., None]
    red = light[..., 0] - 0.5 * (light[..., 1] + light[..., 2])  # of the mirrored light alone
    (u, foot), (_, top) = pixel(FOOT), pixel(FOOT - [0, 0, POLE_M])  # the mirror image of the top
    column = red[:, round(u) - 2 : round(u) + 3].max(axis=1)
    clearly = np.where(found.share[:, round(u)] > 0, column, 0) > 0.15
    assert clearly[int(foot) + 4 : int(foot) + 12].all()
    assert foot + 10 < np.flatnonzero(clearly).max() < top + 8
    assert np.abs(red[int(foot) + 4 : int(foot) + 12, [round(u) - 40, round(u) + 40]]).max() < 0.08


def test_water_is_on_the_ground_only_and_mirrors_more_at_flat_angles():
    found = wet()
    u, foot = (round(x) for x in pixel(FOOT))
    wall = slice(0, round(pixel((30.0, 0, 0.6))[1]))
    assert (visible().depth[wall] > 0).mean() > 0.5
    assert found.share[wall].max() == 0 and (found.through[wall] == 1).all()
    assert found.share[foot - 30 : foot - 6, u].max() < 0.02  # the pole
    assert found.share[foot + 5 :].min() > 0.005 and found.share.max() < 0.9
    rows = found.share[:, 30:90].mean(axis=1)
    assert rows[90] > 1.5 * rows[155] > 0.02


def test_no_wetness_is_no_water_more_is_more_and_the_bytes_are_the_same_twice():
    little, much, most = (float(each.share.mean()) for each in (water(0.05), water(0.5), wet()))
    assert little < much < most and little < 0.15 * most
    assert water(0.0) is None
    second = water()
    assert all(
        getattr(wet(), name).tobytes() == getattr(second, name).tobytes() for name in ("color", "share", "through")
    )


def test_what_is_beyond_the_world_is_mirrored_as_sky():
    """Without the wall and the pole the mirrored camera sees nothing: it shows sky, not black."""
    scene = Scene("road", SCENE.layers[:1], ground_m=0.0)
    view = scene_view(scene, POLE_CAMERA)

    def sky_is_white(each: ClearView):
        return np.repeat(each.sky[..., None], 3, axis=2)

    found = water_layer_of(view, np.ones((160, 240, 3), np.float32), SceneEnvironment(scene), sky_is_white, 1.0, 0)
    assert found is not None
    is_wet = found.share > 0.02
    np.testing.assert_allclose(found.color[is_wet][:, 1] / found.share[is_wet], 1, atol=0.02)
