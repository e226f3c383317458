"""Wet colors from the Gaussians' own: sun and shadow are gone, detail and color are not."""

from dataclasses import replace

import numpy as np
import pytest

from gsrain_engine.appearance.wet_look.settings import WetSettings
from gsrain_engine.recolor.recolor import wet_scene
from gsrain_engine.scene.gaussians import SH_C0, Gaussians, sh_from_color
from gsrain_engine.scene.geometry import linear_to_srgb
from gsrain_engine.scene.progress import run_to_end
from gsrain_engine.scene.scene import Layer, Scene
from training.small_street import flat_patch, small_street

SUN, SHADOW = np.array([0.42, 0.40, 0.36]), np.array([0.095, 0.10, 0.115])


def painted(g: Gaussians, linear: np.ndarray) -> Gaussians:
    sh = g.sh.copy()
    sh[:, :1] = sh_from_color(linear_to_srgb(linear).astype(np.float32))
    return g.with_sh(sh)


@pytest.fixture(scope="module")
def street() -> Scene:
    """A road with grains, half of it in blue shadow, that white stripes cross; leaves, a brick wall and a sky dome."""
    rng = np.random.default_rng(3)
    road = flat_patch((0, -6, 0), (40, 0, 0), (0, 12, 0), (0.5, 0.5, 0.5), 0.25, 1)
    light = np.where(road.means[:, 1:2] > 0, SUN, SHADOW)
    grain = np.exp2(rng.normal(0, 0.25, (len(road), 1)))
    stripe = (np.abs(road.means[:, :1] - 20) < 0.3) * 1.5 + 1
    road = painted(road, light * grain * stripe)
    road = replace(road, scales=road.scales * np.array([1, 1, 0.05], np.float32))
    wall = flat_patch((0, 6, 0.5), (40, 0, 0), (0, 0, 6), (0.62, 0.36, 0.26), 0.4, 1)
    tree = flat_patch((0, -6, 2.0), (40, 0, 0), (0, 0, 4), (0.35, 0.47, 0.16), 0.4, 1)
    away = rng.normal(size=(3000, 3))
    dome = 900 * away / np.linalg.norm(away, axis=1, keepdims=True)
    sky = flat_patch((0, 0, 0), (100, 0, 0), (0, 30, 0), (0.3, 0.5, 0.9), 1.0, 1)
    sky = replace(sky, means=dome.astype(np.float32), scales=np.full((3000, 3), 40.0, np.float32))
    whole = Gaussians.concatenate([road, wall, tree, sky])
    return Scene("road", (Layer("all", whole),), ground_m=0.0)


def display(sh: np.ndarray) -> np.ndarray:
    return 0.5 + SH_C0 * sh[:, 0]


def saturation(colors: np.ndarray) -> float:
    return float(((colors.max(axis=1) - colors.min(axis=1)) / colors.max(axis=1)).mean())


def wetted(scene: Scene, **settings: float) -> np.ndarray:
    return run_to_end(wet_scene(scene, WetSettings(**settings))).layers[0].wet_sh


def test_shadows_are_gone_and_the_grain_of_the_road_is_not(street):
    g, after = street.layers[0].gaussians, display(wetted(street))
    plain = (g.means[:, 2] == 0) & (np.abs(g.means[:, 0] - 20) > 1) & (np.abs(g.means[:, 1]) > 0.7)
    before, sun, shadow = display(g.sh), plain & (g.means[:, 1] > 0), plain & (g.means[:, 1] < 0)
    assert before[sun].mean() > 1.8 * before[shadow].mean()
    assert after[sun].mean() == pytest.approx(after[shadow].mean(), rel=0.1)
    tints = [np.ptp(after[each].mean(axis=0)) for each in (sun, shadow)]
    assert max(tints) < 0.02 < np.ptp(before[shadow].mean(axis=0))
    for part in (sun, shadow):
        grain = [np.log(each[part].mean(axis=1)) for each in (before, after)]
        assert np.corrcoef(*grain)[0, 1] > 0.97 and 0.9 < grain[1].std() / grain[0].std() < 1.6


def test_white_paint_in_the_shadow_stays_paint(street):
    g, after = street.layers[0].gaussians, display(wetted(street)).mean(axis=1)
    is_stripe, is_road = np.abs(g.means[:, 0] - 20) < 0.3, (g.means[:, 2] == 0) & (np.abs(g.means[:, 0] - 20) < 2)
    for side in (g.means[:, 1] > 0.7, g.means[:, 1] < -0.7):
        paint, asphalt = after[is_road & is_stripe & side], after[is_road & ~is_stripe & side]
        assert paint.mean() > 1.25 * asphalt.mean()


def test_brick_and_leaves_are_darker_and_stronger_in_color(street):
    g, after = street.layers[0].gaussians, display(wetted(street))
    before, upright = display(g.sh), (g.means[:, 2] > 1) & (np.abs(g.means[:, 2]) < 7) & (np.abs(g.means[:, 1]) < 7)
    for side in (upright & (g.means[:, 1] > 5), upright & (g.means[:, 1] < -5)):
        assert side.sum() > 500
        assert after[side].mean() < 0.9 * before[side].mean()
        assert saturation(after[side]) > 1.02 * saturation(before[side])


def test_a_dome_far_away_becomes_clouds_as_does_a_layer_of_the_sky(street):
    after = display(wetted(street))[-3000:]
    assert np.ptp(after, axis=1).max() < 0.06 and after.mean() > 0.7
    small = run_to_end(wet_scene(small_street()))
    sky = display(small.member("layers/sky").wet_sh)
    assert np.ptp(sky, axis=1).max() < 0.06 and sky.mean() > 0.7
    assert all(each.wet_sh is not None and np.isfinite(each.wet_sh).all() for each in small.members)


def test_colors_change_with_direction_by_the_same_factor(street):
    g = street.layers[0].gaussians
    sh = g.sh.copy()
    sh[:, 1:] = np.float32(0.1) * sh[:, :1] + np.float32(0.02)
    shining = street.with_member("layers/all", gaussians=g.with_sh(sh))
    after, low = wetted(shining), slice(7680, len(g) - 3000)  # the mirror adds highlights of the road
    gain = display(after)[low] / display(sh)[low]
    np.testing.assert_allclose(after[low, 1:], gain[:, None] * sh[low, 1:], rtol=0.02, atol=1e-4)


def test_dry_is_unchanged_and_the_same_scene_gets_the_same_bytes(street):
    np.testing.assert_allclose(wetted(street, wetness=0.0), street.layers[0].gaussians.sh, atol=2e-5)
    assert wetted(street).tobytes() == wetted(street).tobytes()
