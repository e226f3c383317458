from collections.abc import Iterator, Sequence
from functools import cache

import numpy as np
import pytest

from gsrain_engine.appearance.base import ClearView, RainyView, Transfer
from gsrain_engine.appearance.scene_views import PlacedCamera, ViewChoice, chosen_cameras, scene_views
from gsrain_engine.appearance.wet_look.environment import SceneEnvironment
from gsrain_engine.appearance.wet_look.settings import WetSettings
from gsrain_engine.appearance.wet_look.translator import WetTransfer
from gsrain_engine.recolor.recolor import rainy_scene
from gsrain_engine.scene.camera import Camera, look_at
from gsrain_engine.scene.flags import BitMask, SelectionFlags
from gsrain_engine.scene.gaussians import SH_C0
from gsrain_engine.scene.progress import Progress
from gsrain_engine.scene.scene import ColorGrading, Scene
from rasterized import rasterize
from training.small_street import small_street


class Overcast:
    """Every view gets the same gray tint: what a transfer does, in one line."""

    name = "overcast"

    def transferred(self, views: Sequence[ClearView]) -> Iterator[RainyView]:
        for view in views:
            grey = view.image.mean(axis=2, keepdims=True)
            yield RainyView(view, (0.5 * grey + 0.2 * view.image).astype(np.float32))


def views_of(scene: Scene, count: int = 4) -> Sequence[ClearView]:
    return scene_views(scene, chosen_cameras(scene, ViewChoice(count=count)))


def finished_with(scene: Scene, transfer: Transfer, views: Sequence[ClearView]) -> tuple[Scene, list[Progress]]:
    steps, work = list[Progress](), rainy_scene(scene, views, transfer)
    while True:
        try:
            steps.append(next(work))
        except StopIteration as end:
            return end.value, steps


@pytest.fixture(scope="module")
def overcast() -> tuple[Scene, list[Progress]]:
    scene = small_street()
    return finished_with(scene, Overcast(), views_of(scene))


@cache
def new_camera() -> Camera:
    eye = np.array([3.2, -1.0, 1.7])
    return Camera.from_fov(96, 64, 60, look_at(eye, eye + np.array([1, 0.1, -0.08]), np.array([0.0, 0, 1])))


def drawn(scene: Scene, wetness: float) -> np.ndarray:
    return rasterize(scene.parts(0.0, wetness=wetness), new_camera()).over()


def test_the_test_transfer_is_one():
    assert isinstance(Overcast(), Transfer)


def test_progress_rises_to_the_end_and_shows_pictures(overcast):
    _, steps = overcast
    fractions = [step.fraction for step in steps]
    assert fractions == sorted(fractions)
    assert (fractions[0], fractions[-1]) == (0, 1)
    assert all(step.message for step in steps)
    assert any(step.message == "Making view 2 of 4 rainy" for step in steps)
    previews = [step.preview for step in steps if step.preview is not None]
    assert len(previews) > 10
    assert {each.shape for each in previews} == {(64, 96, 3)}


def test_every_layer_and_actor_gets_wet_colors_and_keeps_its_clear_ones(overcast):
    clear, (wet, _) = small_street(), overcast
    for before, after in zip(clear.members, wet.members, strict=True):
        np.testing.assert_array_equal(before.gaussians.sh, after.gaussians.sh)
        assert after.wet_sh is not None
        assert after.wet_sh.shape == before.gaussians.sh.shape
        assert np.isfinite(after.wet_sh).all()


def test_a_view_that_was_not_used_looks_as_the_transfer_would_have_made_it(overcast):
    scene, _ = overcast
    clear, wet = drawn(scene, 0.0), drawn(scene, 1.0)
    wanted = 0.5 * clear.mean(axis=2, keepdims=True) + 0.2 * clear
    assert np.abs(wet - wanted).mean() < 0.012
    assert np.abs(clear - wanted).mean() > 0.15


def test_gaussians_that_no_view_sees_change_as_their_neighbours_do(overcast):
    scene, _ = overcast
    street = scene.member("layers/street")
    means, wet_sh = street.gaussians.means, street.wet_sh
    assert wet_sh is not None
    is_road = means[:, 2] < 0.01
    seen = 0.5 + SH_C0 * wet_sh[is_road & (np.abs(means[:, 0] - 12) < 8), 0].mean(axis=0)
    unseen = 0.5 + SH_C0 * wet_sh[is_road & (means[:, 0] < -40), 0].mean(axis=0)
    assert seen.mean() < 0.4  # it was 0.52
    np.testing.assert_allclose(unseen, seen, atol=0.03)


def test_the_wet_look_makes_a_street_grey_and_its_road_darker():
    scene = small_street()
    transfer = WetTransfer(WetSettings(), SceneEnvironment(scene))
    wet, _ = finished_with(scene, transfer, views_of(scene))
    before, after = drawn(wet, 0.0), drawn(wet, 1.0)
    sky = (slice(2, 12), slice(30, 66))
    assert float((before[sky][..., 2] - before[sky][..., 0]).mean()) > 0.4
    assert float((after[sky][..., 2] - after[sky][..., 0]).mean()) < 0.15
    road = (slice(54, 63), slice(20, 76))
    assert after[road].mean() < before[road].mean()


def test_the_same_bytes_every_time(overcast):
    first, _ = overcast
    second, _ = finished_with(small_street(), Overcast(), views_of(small_street()))
    for one, other in zip(first.members, second.members, strict=True):
        assert one.wet_sh is not None and other.wet_sh is not None
        assert one.wet_sh.tobytes() == other.wet_sh.tobytes()


def test_views_are_needed_and_must_see_something():
    scene = small_street()
    with pytest.raises(ValueError, match="at least one view"):
        next(rainy_scene(scene, [], Overcast()))
    blind = Scene("void")
    with pytest.raises(ValueError, match="none of the 2 cameras sees anything of the scene 'void'"):
        finished_with(blind, Overcast(), scene_views(blind, chosen_cameras(scene, ViewChoice(count=2))))


def test_a_view_of_nothing_is_no_harm():
    scene = small_street()
    up = look_at(np.array([0.0, 0, 500]), np.array([0.0, 0, 600]), np.array([1.0, 0, 0]))
    cameras = [*chosen_cameras(scene, ViewChoice(count=2)), PlacedCamera("up", Camera.from_fov(32, 32, 60, up))]
    wet, _ = finished_with(scene, Overcast(), scene_views(scene, cameras))
    assert wet.has_wet_colors


def test_deleted_gaussians_and_grading_stay_what_they_are():
    scene = small_street()
    road = scene.layers[0]
    deleted = BitMask.of(np.arange(len(road.gaussians)) % 3 == 0)
    scene = scene.with_member(road.key, marks=SelectionFlags(deleted=deleted))
    graded = scene.with_member(road.key, grading=ColorGrading(exposure_ev=-2.0))
    plain, same = (finished_with(each, Overcast(), views_of(each, 1))[0] for each in (scene, graded))
    for one, other in zip(plain.members, same.members, strict=True):
        np.testing.assert_array_equal(one.wet_sh, other.wet_sh)
    assert same.layers[0].grading == graded.layers[0].grading
    assert same.layers[0].marks.deleted is deleted
