"""Wet colors of a scene by a transfer of its views."""

from collections.abc import Iterator, Sequence

import numpy as np
import pytest

from gsrain_engine.appearance.base import ClearView, RainyView, Transfer
from gsrain_engine.appearance.scene_views import PlacedCamera, chosen_cameras, scene_views
from gsrain_engine.appearance.view_choice import ViewChoice
from gsrain_engine.recolor.problem import RecolorSettings
from gsrain_engine.recolor.recolor import rainy_scene
from gsrain_engine.scene.camera import Camera, look_at
from gsrain_engine.scene.flags import BitMask, SelectionFlags
from gsrain_engine.scene.gaussians import SH_C0
from gsrain_engine.scene.progress import run_to_end
from gsrain_engine.scene.scene import ColorGrading, Scene
from rasterized import rasterize
from training.small_street import small_street

QUICK = RecolorSettings(iterations=10, rounds=1, sh_degree=1, tikhonov=0.3, exposure=False, robust=False)


class Overcast:
    """Every view gets the same gray tint: what a transfer does, in one line."""

    name = "overcast"

    def transferred(self, views: Sequence[ClearView]) -> Iterator[RainyView]:
        for view in views:
            grey = view.image.mean(axis=2, keepdims=True)
            yield RainyView(view, (0.5 * grey + 0.2 * view.image).astype(np.float32))


def views_of(scene: Scene, count: int = 4) -> Sequence[ClearView]:
    return scene_views(scene, chosen_cameras(scene, ViewChoice(count=count)))


def overcast_scene(scene: Scene, views: Sequence[ClearView] | None = None) -> Scene:
    return run_to_end(rainy_scene(scene, views_of(scene) if views is None else views, Overcast(), QUICK))


@pytest.fixture(scope="module")
def overcast() -> Scene:
    assert isinstance(Overcast(), Transfer)
    return overcast_scene(small_street())


def drawn(scene: Scene, wetness: float) -> np.ndarray:
    """A view that was not used."""
    eye = np.array([3.2, -1.0, 1.7])
    camera = Camera.from_fov(96, 64, 60, look_at(eye, eye + np.array([1, 0.1, -0.08]), np.array([0.0, 0, 1])))
    return rasterize(scene.parts(0.0, wetness=wetness), camera).over()


def test_every_member_gets_the_same_wet_colors_each_time_and_keeps_its_clear_ones(overcast):
    members = zip(small_street().members, overcast.members, overcast_scene(small_street()).members, strict=True)
    for before, after, repeated in members:
        np.testing.assert_array_equal(before.gaussians.sh, after.gaussians.sh)
        assert after.wet_sh is not None and repeated.wet_sh is not None
        assert after.wet_sh.shape == before.gaussians.sh.shape and np.isfinite(after.wet_sh).all()
        assert after.wet_sh.tobytes() == repeated.wet_sh.tobytes()


def test_a_view_that_was_not_used_looks_as_the_transfer_would_have_made_it(overcast):
    clear, wet = drawn(overcast, 0.0), drawn(overcast, 1.0)
    expected = 0.5 * clear.mean(axis=2, keepdims=True) + 0.2 * clear
    assert np.abs(wet - expected).mean() < 0.012 < 0.15 < np.abs(clear - expected).mean()


def test_gaussians_that_no_view_sees_change_as_their_neighbours_do(overcast):
    street = overcast.member("layers/street")
    means, wet_sh = street.gaussians.means, street.wet_sh
    assert wet_sh is not None
    is_road = means[:, 2] < 0.01
    seen = 0.5 + SH_C0 * wet_sh[is_road & (np.abs(means[:, 0] - 12) < 8), 0].mean(axis=0)
    unseen = 0.5 + SH_C0 * wet_sh[is_road & (means[:, 0] < -40), 0].mean(axis=0)
    assert seen.mean() < 0.4  # it was 0.52
    np.testing.assert_allclose(unseen, seen, atol=0.03)


def test_views_are_needed_and_one_of_them_must_show_something():
    scene, blind = small_street(), Scene("void")
    cameras = chosen_cameras(scene, ViewChoice(count=2))
    with pytest.raises(ValueError, match="at least one view"):
        overcast_scene(scene, [])
    with pytest.raises(ValueError, match="void"):
        overcast_scene(blind, scene_views(blind, cameras))
    up = look_at(np.array([0.0, 0, 500]), np.array([0.0, 0, 600]), np.array([1.0, 0, 0]))
    cameras.append(PlacedCamera("up", Camera.from_fov(32, 32, 60, up)))
    assert overcast_scene(scene, scene_views(scene, cameras)).has_wet_colors


def test_deleted_gaussians_and_grading_stay_what_they_are():
    scene = small_street()
    road = scene.layers[0]
    deleted = BitMask.of(np.arange(len(road.gaussians)) % 3 == 0)
    scene = scene.with_member(road.key, marks=SelectionFlags(deleted=deleted))
    graded = scene.with_member(road.key, grading=ColorGrading(exposure_ev=-2.0))
    plain, same = (overcast_scene(each, views_of(each, 1)) for each in (scene, graded))
    for one, other in zip(plain.members, same.members, strict=True):
        np.testing.assert_array_equal(one.wet_sh, other.wet_sh)
    assert same.layers[0].grading == graded.layers[0].grading
    assert same.layers[0].marks.deleted is deleted
