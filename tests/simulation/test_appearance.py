"""Models of road users: built-in vehicles in their paints, actors of the scene, files."""

from dataclasses import replace

import numpy as np
import pytest

from gsrain_engine.scene.formats.registry import write_gaussians
from gsrain_engine.scene.gaussians import SH_C0, Gaussians
from gsrain_engine.simulation.traffic.appearance import vehicle_model
from simulation.small_drive import box_actor
from small_scene import small_scene

SCENE = replace(small_scene(), actors=(box_actor(),), metres_per_unit=2.0)


@pytest.mark.parametrize("model", ["saloon/red", "truck/green", "bus", "cyclist/red", "pedestrian", "actor:box"])
def test_a_vehicle_fills_its_box_and_stands_on_the_ground(model):
    look = vehicle_model(model, SCENE)
    size, means = np.array(look.size_lwh_m), look.gaussians.means[look.gaussians.means[:, 2] > 0.1]
    np.testing.assert_allclose([*means.min(axis=0)[:2], *means.max(axis=0)], [*-size[:2] / 2, *size * (0.5, 0.5, 1)],
                               atol=0.2)  # fmt: skip


def box(at, size, strays=0, opacity=0.9):
    """Gaussians all over a box, and strays far away."""
    means = np.random.default_rng(5).uniform(-0.5, 0.5, size=(4000, 3)) * size + at
    means[:strays] *= 40
    n, f = len(means), np.float32
    return Gaussians(means.astype(f), np.full((n, 3), 0.02, f), np.tile(np.array([1, 0, 0, 0], f), (n, 1)),
                     np.full(n, opacity, f), np.zeros((n, 1, 3), f))  # fmt: skip


@pytest.mark.street
def test_a_file_is_stood_on_the_ground_in_a_shadow_and_measured_without_its_strays(tmp_path):
    path = tmp_path / "car.ply"
    write_gaussians(box((0.4, -0.1, 1.0), (4.0, 1.8, 1.4), strays=4), path)
    look = vehicle_model(str(path), small_scene())
    assert look.size_lwh_m == pytest.approx((4.0, 1.8, 1.4), abs=0.05)
    np.testing.assert_allclose(np.median(look.gaussians.means[-4000:], axis=0), (0, 0, 0.7), atol=0.1)
    shadow = look.gaussians.take(slice(0, len(look.gaussians) - 4000))
    assert len(shadow) > 100 and shadow.means[:, 2].max() < 0.1 and (SH_C0 * shadow.sh[:, 0] + 0.5).max() < 0.3
    assert vehicle_model(str(path), small_scene()) is look
    write_gaussians(box((0, 0, 0.7), (5.0, 1.8, 1.4)).take(slice(0, 3000)), path)  # read anew when it changes
    assert vehicle_model(str(path), small_scene()).size_lwh_m[0] > 4.8


@pytest.mark.parametrize(
    ("model", "word"),
    [("tank", "saloon"), ("van/pink", "'pink'"), ("actor:bus", "'small'"),
     (box((0, 0, 0), (400.0, 180.0, 140.0)), "car.ply.*meters"),
     (box((0, 0, 0), (4.0, 1.8, 1.4), opacity=0.01), "car.ply")],
)  # fmt: skip
def test_other_models_are_refused(tmp_path, model, word):
    if not isinstance(model, str):
        write_gaussians(model, tmp_path / "car.ply")
        model = str(tmp_path / "car.ply")
    with pytest.raises(ValueError, match=word):
        vehicle_model(model, small_scene())
