"""Lamps of a scene: places and axes in the world, mounts, and the strongest at a place."""

import msgspec
import numpy as np
import pytest

from gsrain_engine.scene.lamps import Lamp, lit_lamps
from gsrain_engine.scene.scene import Actor, PoseTrack, Scene
from small_scene import small_scene

TURNED = np.array([[0.0, -1, 0, 5], [1, 0, 0, 6], [0, 0, 1, 0], [0, 0, 0, 1]])
"""A quarter turn to the left, and a step."""


def test_lamps_without_a_mount_follow_units_and_axes_of_the_scene() -> None:
    lamp = Lamp(position=(1.0, -2.0, 3.0), direction=(0.0, 2.0, 0.0), color=(1.0, 0.5, 0.0), intensity_m2=4.0)
    lit = Scene("", lamps=(lamp,), metres_per_unit=2.0, up=(0.0, -1.0, 0.0)).lamps_at(0.0)
    assert lit.positions_m[0, 2] == pytest.approx(4.0)  # 2 units upward
    np.testing.assert_allclose(lit.directions, [[0.0, 0.0, -1.0]], atol=1e-12)
    np.testing.assert_allclose(lit.intensities, [[4.0, 2.0, 0.0]])


def test_lamps_ride_on_their_vehicles_and_go_out_with_them() -> None:
    actor = Actor("car", "Car", (4.0, 2.0, 1.5), small_scene().layers[0].gaussians, PoseTrack.standing(TURNED))
    lamp = Lamp(position=(2.0, 0.0, 0.7), direction=(1.0, 0.0, 0.0), mount="car")
    ego = Lamp(position=(1.0, 0.0, 0.0), direction=(1.0, 0.0, 0.0), mount="ego")
    scene = Scene("", actors=(actor,), lamps=(lamp, ego))
    lit = scene.lamps_at(0.0)  # the scene has no ego
    np.testing.assert_allclose(lit.positions_m, [[5.0, 8.0, 0.7]])
    np.testing.assert_allclose(lit.directions, [[0.0, 1.0, 0.0]], atol=1e-12)
    assert len(scene.with_member("actors/car", visible=False).lamps_at(0.0).positions_m) == 0


def test_the_brightest_are_those_of_the_highest_irradiance() -> None:
    lamps = [Lamp(position=(float(x), 0.0, 0.0), intensity_m2=1.0 + 99 * (x == 9)) for x in range(2, 10)]
    lit = lit_lamps([(lamp, np.eye(4)) for lamp in lamps])
    np.testing.assert_array_equal(lit.brightest(np.zeros(3), 3).positions_m[:, 0], [2, 3, 9])


@pytest.mark.parametrize(
    ("values", "sentence"),
    [
        ({"direction": (0, 0, 0)}, "finite numbers and a direction"),
        ({"position": (float("nan"), 0, 0)}, "finite numbers and a direction"),
        ({"color": (1, -1, 0)}, "must not be negative"),
        ({"inner_deg": 50, "outer_deg": 40}, "inner_deg 50 is above outer_deg 40"),
    ],
)
def test_impossible_lamps_are_refused(values: dict[str, object], sentence: str) -> None:
    with pytest.raises(ValueError, match=sentence):
        msgspec.convert({"name": "a", "position": (0, 0, 0)} | values, Lamp)
