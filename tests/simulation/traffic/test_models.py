"""Models of road users: built-in vehicles in their paints, actors of the scene, files."""

from dataclasses import replace

import numpy as np
import pytest

from gsrain_engine.scene.formats.registry import write_gaussians
from gsrain_engine.scene.gaussians import SH_C0, Gaussians
from gsrain_engine.scene.scene import Actor, PoseTrack
from gsrain_engine.simulation.traffic.appearance import vehicle_model
from small_scene import patch, small_scene


@pytest.mark.parametrize("model", ["hatchback", "saloon/red", "estate", "van/white", "truck", "truck/green"])
def test_a_vehicle_fills_its_box_and_stands_on_the_ground(model):
    look = vehicle_model(model, small_scene())
    body = look.gaussians.take(np.flatnonzero(look.gaussians.means[:, 2] > 0.1))
    low, high = body.means.min(axis=0), body.means.max(axis=0)
    half = np.array([look.size_lwh_m[0] / 2, look.size_lwh_m[1] / 2])
    np.testing.assert_allclose(low[:2], -half, atol=0.2)
    np.testing.assert_allclose(high[:2], half, atol=0.2)
    assert high[2] == pytest.approx(look.size_lwh_m[2], abs=0.1)
    assert look.gaussians.means[:, 2].min() >= 0


def color(model):
    """Mean display color of the upper half."""
    look = vehicle_model(model, small_scene())
    upper = look.gaussians.means[:, 2] > 0.5
    return (SH_C0 * look.gaussians.sh[upper, 0] + 0.5).mean(axis=0)


def test_paint_paints():
    red, green = color("saloon/red"), color("saloon/green")
    assert red[0] > red[1] + 0.1
    assert green[1] > green[0]
    assert color("van/white").mean() > color("van/black").mean() + 0.2


def test_models_are_made_once():
    scene = small_scene()
    assert vehicle_model("saloon", scene) is vehicle_model("saloon", replace(scene))


@pytest.mark.parametrize(
    ("model", "words"),
    [
        (
            "tank",
            r"model tank: no such file, and none of hatchback, saloon, estate, van, truck \(a paint may follow: /",
        ),
        ("van/pink", "model van/pink: no paint is called 'pink', only blue, "),
        ("actor:bus", "model actor:bus: scene 'small' has no such actor"),
    ],
)
def test_what_there_is_not_is_said(model, words):
    with pytest.raises(ValueError, match=words):
        vehicle_model(model, small_scene())


def test_an_actor_of_the_scene_in_metres():
    gaussians = patch((-1, -0.5, 0), np.array([2.0, 0, 0]), np.array([0, 0, 1.0]), 5, (1, 0, 0))
    actor = Actor("van", "car", (2.0, 1.0, 1.0), gaussians, PoseTrack.standing(np.eye(4)))
    look = vehicle_model("actor:van", replace(small_scene(), actors=(actor,), metres_per_unit=2.0))
    assert look.size_lwh_m == (4.0, 2.0, 2.0)
    np.testing.assert_allclose(look.gaussians.means, 2 * gaussians.means)


def box(at, size, strays=0):
    """Gaussians all over a box, and strays far away."""
    rng = np.random.default_rng(5)
    means = rng.uniform(-0.5, 0.5, size=(4000, 3)) * size + at
    means[:strays] *= 40
    n = len(means)
    f = np.float32
    return Gaussians(means.astype(f), np.full((n, 3), 0.02, f), np.tile(np.array([1, 0, 0, 0], f), (n, 1)),
                     np.full(n, 0.9, f), np.zeros((n, 1, 3), f))  # fmt: skip


@pytest.mark.parametrize("ending", [".ply", ".splat", ".spz"])
def test_a_file_is_stood_on_the_ground_and_measured_without_its_strays(tmp_path, ending):
    path = tmp_path / f"car{ending}"
    write_gaussians(box((0.4, -0.1, 1.0), (4.0, 1.8, 1.4), strays=4), path)
    look = vehicle_model(str(path), small_scene())
    assert look.size_lwh_m == pytest.approx((4.0, 1.8, 1.4), abs=0.05)
    middle = np.median(look.gaussians.means[-4000:], axis=0)
    np.testing.assert_allclose(middle, (0, 0, 0.7), atol=0.1)


def test_a_file_gets_a_shadow_and_is_read_again_when_it_changes(tmp_path):
    path = tmp_path / "car.ply"
    write_gaussians(box((0, 0, 0.7), (4.0, 1.8, 1.4)), path)
    look = vehicle_model(str(path), small_scene())
    shadow = look.gaussians.take(slice(0, len(look.gaussians) - 4000))
    assert len(shadow) > 100
    assert shadow.means[:, 2].max() < 0.1
    assert (SH_C0 * shadow.sh[:, 0] + 0.5).max() < 0.3
    assert vehicle_model(str(path), small_scene()) is look
    write_gaussians(box((0, 0, 0.7), (5.0, 1.8, 1.4)).take(slice(0, 3000)), path)
    assert vehicle_model(str(path), small_scene()).size_lwh_m[0] > 4.8


@pytest.mark.parametrize(("size", "opacity", "words"), [
    ((400.0, 180.0, 140.0), 0.9, "is no road user's size; a model is in meters"),
    ((4.0, 1.8, 1.4), 0.01, "nothing in it can be seen"),
])  # fmt: skip
def test_a_file_that_can_be_no_road_user_is_refused(tmp_path, size, opacity, words):
    path = tmp_path / "car.ply"
    model = box((0, 0, 0), size)
    write_gaussians(replace(model, opacities=np.full(4000, opacity, np.float32)), path)
    with pytest.raises(ValueError, match=words):
        vehicle_model(str(path), small_scene())
