"""Pictures that are warped to a later moment: as drawn at that moment, with road users; and when they are not."""

from dataclasses import replace

import numpy as np
import pytest

from gsrain_engine.rain.lamp_light import depth_of_share, share_of_depth
from gsrain_engine.render.cpu.renderer import CpuRenderer
from gsrain_engine.render.opengl.warp import PictureWarp, can_warp
from gsrain_engine.render.relief import Relief
from gsrain_engine.scene.camera import Camera, look_at
from gsrain_engine.scene.orthographic import orthographic
from gsrain_engine.scene.scene import Actor, Layer, PoseTrack, Scene, core_bounds
from small_scene import patch

WIDTH, HEIGHT = 192, 128
STILL = Scene("empty")


def camera_at(x, y=0.0, heading=0.0):
    eye = np.array([x, y, 1.5])
    ahead = np.array([np.cos(heading), np.sin(heading), 0.0])
    return Camera.from_fov(WIDTH, HEIGHT, 50.0, look_at(eye, eye + ahead, np.array([0.0, 0.0, 1.0])))


def speckled():
    """Two walls that face the camera, one before the other, with a color of its own for each Gaussian."""
    random = np.random.default_rng(0)
    far = patch((14, -12, -3), np.array([0, 24.0, 0]), np.array([0, 0, 9.0]), 30, (0.5, 0.5, 0.5))
    near = patch((7, -3, -1), np.array([0, 2.5, 0]), np.array([0, 0, 4.0]), 12, (0.5, 0.5, 0.5))
    walls = [each.with_sh(each.sh + random.normal(0, 0.5, each.sh.shape).astype(np.float32)) for each in (far, near)]
    return Scene("walls", tuple(Layer(f"wall {number}", each) for number, each in enumerate(walls)))


def crossing():
    """The walls with a red car between them, which drives 4 m a second to the left."""
    times = np.array([0.0, 2.0])
    track = PoseTrack(times, np.array([[10.0, -4, 0], [10, 4, 0]]), np.tile([1.0, 0, 0, 0], (2, 1)), np.ones(2, bool))
    front = patch((-0.5, -1, 0.1), np.array([0, 2.0, 0]), np.array([0, 0, 1.8]), 12, (0.9, 0.1, 0.1))
    car = Actor("car", "car", (1.0, 2.0, 2.0), front, track)
    return replace(speckled(), actors=(car,))


def drawn(scene, camera, time_s=0.0):
    """The picture as bytes, and its relief."""
    renderer = CpuRenderer()
    renderer.draw(scene.parts(time_s), camera)
    depth = renderer.read().rough_depth()
    return renderer.read_uint8(), Relief.of(depth, camera, scene, time_s)


def warped(context, picture, relief, camera, time_s=0.0):
    texture = context.texture((picture.shape[1], picture.shape[0]), 3, picture.tobytes(), alignment=1)
    shown = PictureWarp(context).show(texture, relief, camera, time_s)
    return np.frombuffer(shown.read(), np.uint8).reshape(shown.height, shown.width, 4)[..., :3]


def error(picture, other):
    """Root mean square difference in the middle, in levels."""
    y, x = HEIGHT // 6, WIDTH // 6
    return np.sqrt(np.mean((picture.astype(float) - other)[y:-y, x:-x] ** 2))


@pytest.mark.parametrize("to", [camera_at(1.0), camera_at(0.0, 0.4), camera_at(0.0, heading=0.1), camera_at(-0.5, 0.2)])
def test_a_warped_picture_is_that_of_the_present_camera(context, to):
    scene = speckled()
    before, relief = drawn(scene, camera_at(0.0))
    now, _ = drawn(scene, to)
    assert error(before, now) > 8
    assert error(warped(context, before, relief, to), now) < 0.4 * error(before, now)
    assert error(warped(context, before, relief, relief.camera), before) < 1.0


def test_a_warped_view_to_scale_is_that_of_the_present_camera(context):
    scene = speckled()
    core = core_bounds(scene.parts())

    def seen(aside_m, turned=0.0):
        return orthographic(camera_at(-20.0, aside_m, turned), 30.0, core)

    before, relief = drawn(scene, seen(0.0))
    for to in (seen(0.8), seen(0.0, 0.03)):
        now, _ = drawn(scene, to)
        assert can_warp(relief, to, 0.1) and error(before, now) > 8
        assert error(warped(context, before, relief, to), now) < 0.4 * error(before, now)


def test_road_users_are_where_they_are_at_the_time(context):
    scene, camera = crossing(), camera_at(0.0)
    before, relief = drawn(scene, camera, 1.2)
    assert [each.id for each in relief.movers] == ["car"] and can_warp(relief, camera, 1.4)
    now, shown = drawn(scene, camera, 1.4)[0], warped(context, before, relief, camera, 1.4)

    def place(picture):
        red = picture[..., 0].astype(int) - picture[..., 1].astype(int) > 90
        return np.nonzero(red)[1].mean()

    assert place(before) - place(now) > 5
    assert abs(place(shown) - place(now)) < 0.3 * (place(before) - place(now))
    assert error(shown, now) < 0.6 * error(before, now)


def test_a_picture_of_fewer_pixels_is_warped_to_more_of_them_but_not_to_all(context):
    picture, relief = drawn(speckled(), camera_at(0.0).resized(WIDTH // 4, HEIGHT // 4))
    shown = warped(context, picture, relief, camera_at(0.5))
    assert shown.shape[:2] == (round(1.5 * HEIGHT / 4), round(1.5 * WIDTH / 4))


def test_only_what_is_outdated_and_still_in_view_is_warped():
    _, relief = drawn(speckled(), camera_at(0.0))
    assert not can_warp(relief, camera_at(0.0), 5.0)  # nothing moves but time
    assert can_warp(relief, camera_at(0.2), 0.1)
    assert not can_warp(relief, camera_at(0.2), 5.0)
    assert not can_warp(relief, camera_at(0.0, heading=1.2), 0.1)
    assert not can_warp(relief, camera_at(300.0), 0.1)


def test_corners_are_as_near_as_the_nearest_surface_around_them():
    depth = np.full((40, 60), 20.0, np.float32)
    depth[:10] = 0.0  # sky
    depth[10, 30] = 4.0
    relief = Relief.of(depth, Camera(60, 40, 50.0, 50.0, 30.0, 20.0), STILL, 0.0)
    assert relief.step == 1 and relief.inverse_m.shape == (41, 61)
    assert np.all(relief.inverse_m[:10] == 0) and np.all(relief.inverse_m[12:] == np.float32(1 / 20))
    near = np.argwhere(relief.inverse_m == np.float32(1 / 4)).tolist()
    assert near == [[10, 30], [10, 31], [11, 30], [11, 31]]


def test_large_pictures_have_coarse_reliefs():
    relief = Relief.of(
        np.full((801, 1203), np.inf, np.float32), Camera(1203, 801, 900.0, 900.0, 600.0, 400.0), STILL, 0
    )
    assert 4000 < relief.inverse_m.size < 9000 and not relief.inverse_m.any()


def test_shares_of_depth_give_the_depth_back():
    depth = np.array([0.5, 3.0, 40.0, 900.0], np.float32)
    np.testing.assert_allclose(depth_of_share(share_of_depth(depth)), depth, rtol=1e-4)
