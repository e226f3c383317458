import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from gsrain_engine.editor.edits.gaussians import CropBox
from gsrain_engine.editor.selection.volume import Sphere, in_volume

from .selection_scenes import cloud, world_means

places = st.tuples(*[st.floats(-8, 8)] * 3)


@settings(max_examples=25)
@given(places, st.floats(0.1, 10))
def test_ball_takes_what_is_within_its_radius(center, radius):
    scene = cloud()
    for key, mask in in_volume(scene, 0.0, Sphere(center, radius)).items():
        distance = np.linalg.norm(world_means(scene, key) - center, axis=1)
        clear = np.abs(distance - radius) > 1e-4
        assert np.array_equal(mask.flags[clear], (distance <= radius)[clear])


@settings(max_examples=25)
@given(places, st.tuples(*[st.floats(0.1, 12)] * 3), st.floats(-180, 180))
def test_box_takes_what_is_between_its_faces(center, size, yaw):
    scene = cloud()
    c, s = np.cos(np.radians(yaw)), np.sin(np.radians(yaw))
    for key, mask in in_volume(scene, 0.0, CropBox(center, size, yaw)).items():
        x, y, z = (world_means(scene, key) - center).T
        beyond = np.abs([c * x + s * y, c * y - s * x, z]) - np.array(size)[:, None] / 2
        clear = np.abs(beyond).min(axis=0) > 1e-4
        assert np.array_equal(mask.flags[clear], (beyond <= 0).all(axis=0)[clear])


def test_a_ball_reaches_to_where_the_mouse_points():
    ball = Sphere((0.0, 10, 0), 1.0).reaching(np.zeros(3), np.array([3.0, 4, 0]) / 5)
    assert np.isclose(ball.radius_m, 6.0)
