"""The mirror's picture: its frame, what it takes from the view, and what stands in for what nobody saw."""

from dataclasses import replace

import numpy as np

from gsrain_engine.appearance.base import ClearView
from gsrain_engine.appearance.normals import view_rays
from gsrain_engine.appearance.wet_look.glossy import build_ripmap
from gsrain_engine.appearance.wet_look.ground_plane import GroundPlane
from gsrain_engine.appearance.wet_look.masks import VisibleGround
from gsrain_engine.appearance.wet_look.reflections import (
    PlanarReflection,
    fill_reflection_holes,
    mirror_camera,
    screen_space_reflection,
)
from gsrain_engine.scene.camera import Camera, look_at

LEVEL = GroundPlane(np.array([0.0, 0, 1]), 0.0)
EYE = Camera(160, 120, 120.0, 120.0, 80.0, 60.0, look_at(np.array([0, 0, 1.5]), np.array([10, 0, 1.0]), np.eye(3)[2]))
WALL_M = 12.0


def room(top_m=4.0):
    """A wall of the given height behind level ground, and sky above it; gray levels tell rows."""
    rays = view_rays(EYE)
    to_wall = WALL_M / rays[..., 0]
    to_ground = np.where(rays[..., 2] < 0, -1.5 / np.minimum(rays[..., 2], -1e-9), np.inf)
    is_ground = to_ground < to_wall
    is_sky = ~is_ground & (1.5 + to_wall * rays[..., 2] > top_m)
    depth = np.where(is_sky, 0, np.minimum(to_wall, to_ground)).astype(np.float32)
    normals = np.where(is_ground[..., None], [0, 0, 1.0], [-1.0, 0, 0]).astype(np.float32)
    image = np.repeat(np.linspace(0, 1, 120, dtype=np.float32)[:, None, None], 160, axis=1).repeat(3, axis=2)
    view = ClearView("room", EYE, 0.0, image, depth, normals, is_sky.astype(np.float32), np.zeros_like(depth))
    points = EYE.position + depth[..., None].astype(float) * rays
    share, nothing = is_ground.astype(np.float32), np.zeros_like(depth)
    return view, VisibleGround(LEVEL, share, nothing, points, normals, nothing)


def test_mirror_camera_covers_what_level_water_mirrors():
    camera = mirror_camera(EYE, LEVEL, 0.5)
    lowest = np.array([EYE.fx, EYE.fy, 1.0])  # of the eye's picture: the mirror shows its bottom row highest
    bottom = (EYE.height - EYE.cy) / lowest[1]
    assert camera.cy / camera.fy > bottom
    rays = view_rays(camera)
    rises = rays[..., 2] / np.linalg.norm(rays, axis=-1)
    assert rises[0].min() > 0.4
    assert -0.1 < rises[-1].max() < 0.02


def test_rays_find_what_the_view_shows_above_the_ground():
    """The mirrored camera sees the wall at the height at which the view has it."""
    view, ground = room()
    camera = mirror_camera(EYE, LEVEL, 1.0)
    again = screen_space_reflection(view, ground, camera)
    rays = view_rays(camera)
    height = camera.position[2] + rays[..., 2] * WALL_M / rays[..., 0]
    start = -camera.position[2] / np.maximum(rays[..., 2], 1e-9)
    is_wall = (height > 0.1) & (height < 3.8) & (start * rays[..., 0] < WALL_M - 0.5)
    point = np.stack([np.full(height.shape, WALL_M), rays[..., 1] * WALL_M / rays[..., 0], height], axis=-1)
    local = point @ EYE.world_to_camera[:3, :3].T + EYE.world_to_camera[:3, 3]
    expected = local[..., :2] / local[..., 2:] * 120 + [80, 60]
    inside = is_wall & (expected > 2).all(axis=-1) & (expected[..., 0] < 158)
    assert inside.sum() > 500
    assert again.found[inside].mean() > 0.99
    wrong = np.abs(again.places - expected).max(axis=-1)[inside & again.found]
    assert np.quantile(wrong, 0.99) < 1.5
    np.testing.assert_allclose(
        again.depth[inside & again.found], WALL_M / rays[..., 0][inside & again.found], rtol=0.02
    )


def test_rays_over_the_wall_find_the_sky_or_leave():
    view, ground = room(top_m=2.0)
    camera = mirror_camera(EYE, LEVEL, 1.0)
    again = screen_space_reflection(view, ground, camera)
    rays = view_rays(camera)
    height = camera.position[2] + rays[..., 2] * WALL_M / rays[..., 0]
    over = (height > 2.3) & (np.abs(rays[..., 1] / rays[..., 0]) < 0.4)
    assert (again.depth[over] == 0).all()
    assert (again.found | again.left)[over].all()
    assert again.found[over].any()
    assert again.left[over].any()
    assert not (again.found & again.left).any()


def test_what_is_hidden_looks_like_what_is_next_to_it():
    view, ground = room()
    again = screen_space_reflection(view, ground, mirror_camera(EYE, LEVEL, 0.5))
    hole = np.zeros_like(again.found)
    row, column = (int(np.median(each)) for each in np.nonzero(again.found))
    hole[row : row + 4, column : column + 10] = True
    assert again.found[hole].all()
    filled = again._replace(found=again.found & ~hole).with_hidden_filled()
    whole = again.with_hidden_filled()
    assert filled.found[hole].all()
    assert np.abs(filled.places - whole.places)[hole].max() < 12
    np.testing.assert_array_equal(filled.left, again.left)


def test_pictures_are_put_together_from_the_view_and_beyond():
    view, _ = room()
    camera = mirror_camera(EYE, LEVEL, 0.5)
    size = (camera.height, camera.width)
    beyond = empty_view(camera)
    places = np.full((*size, 2), 60.5, np.float32)
    known = np.zeros(size, np.float32)
    known[:, : size[1] // 2] = 1
    made = PlanarReflection(beyond, places, known, np.zeros(size, np.float32)).picture(
        view.image, np.full((*size, 3), 9, np.float32)
    )
    np.testing.assert_allclose(made[:, : size[1] // 2], view.image[60, 60, 0], atol=1e-6)
    assert (made[:, size[1] // 2 :] == 9).all()


def empty_view(camera):
    size = (camera.height, camera.width)
    nothing, color = np.zeros(size, np.float32), np.zeros((*size, 3), np.float32)
    return ClearView("beyond", camera, 0.0, color, nothing, color, nothing, nothing)


def test_gaps_at_the_horizon_are_closed_from_above_and_others_are_sky():
    camera = mirror_camera(EYE, LEVEL, 0.5)
    view = empty_view(camera)
    rays = view_rays(camera)
    rise = rays[..., 2] / np.linalg.norm(rays, axis=-1)
    depth = np.where((rise > 0.02) & (rise < 0.3), 20, 0).astype(np.float32)
    depth[:, :20] = 0
    image = np.where(depth[..., None] > 0, 0.5, 0).repeat(3, axis=2).astype(np.float32)
    closed = fill_reflection_holes(replace(view, image=image, depth=depth), LEVEL)
    low = rise < 0.02
    assert (closed.depth[low][:, None] == 20).mean() > 0.9 * (1 - 20 / camera.width)
    assert (closed.image[low & (closed.depth > 0)] == 0.5).all()
    assert (closed.sky[rise > 0.35] == 1).all()
    assert (closed.sky[:, :20] == 1).all()
    assert (closed.sky[closed.depth > 0] == 0).all()


def test_blurred_pictures_keep_their_mean():
    image = np.random.default_rng(0).random((64, 96, 3)).astype(np.float32)
    made = build_ripmap(image)
    for start, rows, columns in made.table.reshape(-1, 3):
        part = made.values[start : start + rows * columns * 3].reshape(rows, columns, 3)
        np.testing.assert_allclose(part.mean(axis=(0, 1)), image.mean(axis=(0, 1)), rtol=1e-4)
    down, across = made.table[3, 0], made.table[0, 3]
    assert tuple(down[1:]) == (8, 96)
    assert tuple(across[1:]) == (64, 12)
    halved = image.reshape(8, 8, 96, 3).mean(axis=1)
    np.testing.assert_allclose(made.values[down[0] : down[0] + halved.size].reshape(8, 96, 3), halved, atol=1e-5)
