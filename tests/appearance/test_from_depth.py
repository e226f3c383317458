import numpy as np
import pytest
from scipy import ndimage

from gsrain_engine.appearance.normals import normals_from_depth, view_rays, world_points
from gsrain_engine.scene.camera import Camera, look_at

UP = np.array([0.0, 0.0, 1.0])


def street_camera(width: int = 96, height: int = 64, pitch: float = -0.15) -> Camera:
    """Stand 1.5 m above the origin and look along +x, a little down."""
    eye = np.array([0.0, 0.0, 1.5])
    return Camera.from_fov(width, height, 60, look_at(eye, eye + np.array([1.0, 0.2, pitch]), UP))


def plane_depth(camera: Camera, normal: np.ndarray, offset: float) -> np.ndarray:
    """View depth of the plane normal . x = offset; 0 where no ray hits it within 60 m."""
    with np.errstate(divide="ignore"):
        depth = (offset - normal @ camera.position) / (view_rays(camera) @ normal)
    return np.where((depth > 0) & (depth < 60), depth, 0).astype(np.float32)


def test_rays_go_through_pixel_centres():
    camera = street_camera()
    point = camera.position + 7 * view_rays(camera)[10, 20]
    x, y, z = camera.world_to_camera[:3, :3] @ point + camera.world_to_camera[:3, 3]
    assert z == pytest.approx(7)
    assert camera.fx * x / z + camera.cx == pytest.approx(20.5)
    assert camera.fy * y / z + camera.cy == pytest.approx(10.5)


@pytest.mark.parametrize("normal", [(0, 0, 1), (-1, 0, 0), (-0.8, 0.6, 0), (-0.6, 0, 0.8)])
def test_a_plane_has_its_own_normal(normal):
    camera = street_camera()
    normal = np.array(normal, float)
    depth = plane_depth(camera, normal, 0 if normal[2] else -8)
    near = (depth > 0) & (depth < 25)
    assert near.sum() > 500
    found = normals_from_depth(depth, camera)
    np.testing.assert_allclose(np.linalg.norm(found[near], axis=-1), 1, atol=1e-5)
    assert np.quantile(found[near] @ normal, 0.02) > 0.98


def test_where_there_is_no_depth_there_is_no_normal():
    camera = street_camera()
    depth = plane_depth(camera, UP, 0)
    assert (depth == 0).any()
    assert not normals_from_depth(depth, camera)[depth == 0].any()


def test_a_wall_before_a_road_does_not_bend_it():
    camera = street_camera()
    road, wall = plane_depth(camera, UP, 0), plane_depth(camera, np.array([-1.0, 0, 0]), -6)
    is_wall = (np.abs(world_points(wall, camera)[..., 1]) < 1) & (wall > 0) & ((wall < road) | (road == 0))
    upness = normals_from_depth(np.where(is_wall, wall, road), camera)[..., 2]
    assert is_wall.sum() > 100
    is_near_road = ~is_wall & (road > 0) & (road < 20)
    assert np.mean(upness[is_near_road] > 0.9) > 0.93
    inside = ndimage.binary_erosion(is_wall, iterations=2)
    assert np.mean(np.abs(upness[inside]) < 0.3) > 0.9
