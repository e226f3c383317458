"""Water on the ground of a made scene: a pole on a road before a wall, seen by a camera."""

from functools import cache

import numpy as np
import pytest

from gsrain_engine.appearance.base import ClearView
from gsrain_engine.appearance.scene_views import PlacedCamera, scene_view
from gsrain_engine.appearance.wet_look.environment import ImageEnvironment, ReflectionEnvironment, SceneEnvironment
from gsrain_engine.appearance.wet_look.water import water_layer_of
from gsrain_engine.scene.camera import Camera, look_at
from gsrain_engine.scene.gaussians import Gaussians
from gsrain_engine.scene.geometry import srgb_to_linear
from gsrain_engine.scene.scene import Layer, Scene
from small_scene import patch

FOOT = np.array([9.0, 0.0, 0.0])
POLE_M = 1.6
EYE = np.array([0.0, 0.3, 1.5])


def camera(eye=EYE, target=(9.0, 0.0, 0.2)):
    return Camera(240, 160, 200.0, 200.0, 120.0, 80.0, look_at(np.array(eye), np.array(target), np.eye(3)[2]))


def scene():
    road = patch((-2, -8, 0), np.array([32.0, 0, 0]), np.array([0, 16.0, 0]), 160, (0.3, 0.3, 0.3))
    wall = patch((30, -16, 0), np.array([0, 32.0, 0]), np.array([0, 0, 10.0]), 40, (0.6, 0.6, 0.65))
    poles = [patch(FOOT + [0, y, 0], np.array([0, 0.05, 0]), np.array([0, 0, POLE_M]), 12, (0.95, 0.1, 0.1))
             for y in (-0.05, 0.0)]  # fmt: skip
    return Scene(
        "pole", (Layer("road", road), Layer("wall", wall), Layer("pole", Gaussians.concatenate(poles))), ground_m=0.0
    )


@cache
def seen():
    made = scene()
    return made, scene_view(made, PlacedCamera("eye", camera()))


def look(view: ClearView):
    return srgb_to_linear(view.image).astype(np.float32)


def water(wetness=1.0, surroundings=None):
    made, view = seen()
    found = water_layer_of(view, look(view), surroundings or SceneEnvironment(made), look, wetness, 0)
    return view, found


def pixel(point):
    local = camera().world_to_camera[:3] @ [*point, 1.0]
    return local[:2] / local[2] * 200 + [120, 80]


def redness(light):
    return light[..., 0] - 0.5 * (light[..., 1] + light[..., 2])


@pytest.mark.parametrize("kind", ["scene", "picture"])
def test_a_reflection_begins_at_the_foot_and_ends_where_the_mirrored_top_is(kind):
    surroundings = SceneEnvironment(seen()[0]) if kind == "scene" else ImageEnvironment()
    assert isinstance(surroundings, ReflectionEnvironment)
    _, found = water(surroundings=surroundings)
    assert found is not None
    red = redness(found.color / np.maximum(found.share, 1e-6)[..., None])
    u, foot = pixel(FOOT)
    _, top = pixel(FOOT * [1, 1, 0] - [0, 0, POLE_M])  # the mirror image of the top
    column = red[:, round(u) - 2 : round(u) + 3].max(axis=1)
    column = np.where(found.share[:, round(u)] > 0, column, 0)
    clearly = column > 0.15
    assert clearly[int(foot) + 4 : int(foot) + 12].all()
    last = np.flatnonzero(clearly).max()
    assert foot + 10 < last < top + 8
    beside = red[int(foot) + 4 : int(foot) + 12, [round(u) - 40, round(u) + 40]]
    assert np.abs(beside).max() < 0.08


def test_reflections_are_stretched_and_sharp_at_the_foot():
    """Near the foot of the pole the reflection is as wide as it; farther down it has grown paler, not much wider."""
    _, found = water()
    assert found is not None
    red = np.maximum(redness(found.color / np.maximum(found.share, 1e-6)[..., None]), 0)
    u, foot = (round(x) for x in pixel(FOOT))
    near, far = red[foot + 4, u - 12 : u + 13], red[foot + 16, u - 12 : u + 13]
    assert near.max() > far.max()
    assert np.count_nonzero(near > near.max() / 2) <= 7
    assert np.count_nonzero(far > far.max() / 2) <= 12


def test_water_is_on_the_ground_only():
    view, found = water()
    assert found is not None
    u, foot = (round(x) for x in pixel(FOOT))
    wall = slice(0, round(pixel((30.0, 0, 0.6))[1]))
    assert (view.depth[wall] > 0).mean() > 0.5
    assert found.share[wall].max() == 0
    assert found.share[foot - 30 : foot - 6, u].max() < 0.02  # the pole
    assert found.share[foot + 5 :].min() > 0.005
    assert (found.through[wall] == 1).all()


def test_flat_views_mirror_more_than_steep_ones():
    _, found = water()
    assert found is not None
    rows = found.share[:, 30:90].mean(axis=1)
    assert rows[90] > 1.5 * rows[155] > 0.02
    assert found.share.max() < 0.9


def test_no_wetness_is_no_water_and_more_is_more():
    assert water(0.0)[1] is None
    amounts = [float(made.share.mean()) for made in (water(w)[1] for w in (0.05, 0.5, 1.0)) if made is not None]
    assert len(amounts) == 3
    assert amounts == sorted(amounts)
    assert amounts[0] < 0.15 * amounts[-1]


def test_the_same_bytes_twice():
    one, two = (water()[1] for _ in range(2))
    assert one is not None
    assert two is not None
    for name in ("color", "share", "through"):
        assert getattr(one, name).tobytes() == getattr(two, name).tobytes()


def test_a_view_without_ground_has_no_water():
    made, _ = seen()
    up = scene_view(made, PlacedCamera("up", camera(target=(9.0, 0.0, 6.0))))
    for surroundings in (SceneEnvironment(made), ImageEnvironment()):
        assert water_layer_of(up, look(up), surroundings, look, 1.0, 0) is None


def test_what_is_beyond_the_world_is_mirrored_as_sky():
    """Without the wall and the pole the mirrored camera sees nothing: what it shows is sky, not black."""
    made = Scene("road", scene().layers[:1], ground_m=0.0)
    view = scene_view(made, PlacedCamera("eye", camera()))
    white = np.ones((160, 240, 3), np.float32)

    def sky_is_white(each: ClearView):
        return np.repeat(each.sky[..., None], 3, axis=2)

    found = water_layer_of(view, white, SceneEnvironment(made), sky_is_white, 1.0, 0)
    assert found is not None
    wet = found.share > 0.02
    np.testing.assert_allclose(found.color[wet][:, 1] / found.share[wet], 1, atol=0.02)
