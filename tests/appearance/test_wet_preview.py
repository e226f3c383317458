import numpy as np
import pytest

from gsrain_engine.appearance.wet_preview import ground_share, wet_preview
from gsrain_engine.scene.camera import Camera, look_at
from gsrain_engine.scene.srgb import srgb_to_linear

CAMERA = Camera.from_fov(60, 48, 60, look_at(np.array([0, 0, 1.5]), np.array([1.0, 0, 1.4]), np.array([0.0, 0, 1])))
FLAT = np.zeros((48, 60), np.float32)


def look(color, *, upness: float = 0.0, sky: float = 0.0, depth: float = 10.0, **options) -> np.ndarray:
    """Wet look of an image of one colour."""
    image = np.broadcast_to(np.asarray(color, np.float32), (48, 60, 3)).copy()
    planes = (FLAT + np.float32(each) for each in (depth, upness, sky))
    return wet_preview(image, *planes, CAMERA, **options)


def saturation(color: np.ndarray) -> float:
    return float((color.max() - color.min()) / color.max())


def test_no_strength_changes_nothing():
    color = np.random.default_rng(0).uniform(0, 1, (48, 60, 3)).astype(np.float32)
    same = wet_preview(color, FLAT + 5, FLAT + 1, FLAT, CAMERA, strength=0.0)
    np.testing.assert_allclose(same, color, atol=1e-5)


def test_strength_goes_from_clear_to_wet_in_linear_light():
    clear, half, full = (srgb_to_linear(look((0.6, 0.5, 0.4), upness=1, strength=s)[-1, 30]) for s in (0.0, 0.5, 1.0))
    np.testing.assert_allclose(half, (clear + full) / 2, atol=1e-5)


def test_a_road_gets_darker_than_a_wall_does():
    road, wall = look((0.5, 0.5, 0.5), upness=1)[-1, 30], look((0.5, 0.5, 0.5))[-1, 30]
    assert road.mean() < wall.mean() < 0.5


def test_light_gets_less_warm():
    wall = look((0.6, 0.6, 0.6))[20, 30]
    assert wall[0] < wall[1] < wall[2]


def test_a_coloured_road_gets_more_saturated_than_a_wall():
    road, wall = look((0.6, 0.4, 0.35), upness=1)[-1, 30], look((0.6, 0.4, 0.35))[-1, 30]
    assert saturation(road) > saturation(wall)


def test_shadows_soften():
    def ratio(bright, dark):
        return srgb_to_linear(bright).mean() / srgb_to_linear(dark).mean()

    sunny, shady = np.full(3, 0.75, np.float32), np.full(3, 0.3, np.float32)
    assert ratio(look(sunny)[0, 0], look(shady)[0, 0]) < 0.8 * ratio(sunny, shady)


def test_a_road_reflects_the_sky_more_at_grazing_angles():
    road = look((0.2, 0.2, 0.2), upness=1).mean(axis=-1)[:, 30]
    far, near = CAMERA.height // 2 + 1, CAMERA.height - 1  # just below the horizon, and at the bonnet
    assert road[far] > road[near] + 0.1


def test_sky_becomes_grey_and_darker_overhead():
    sky = look((0.3, 0.55, 0.95), sky=1)
    assert saturation(sky[0, 30]) < 0.2
    assert sky[0, 30].mean() < sky[20, 30].mean()


def test_only_what_is_low_is_ground():
    depth = FLAT + np.float32(4)  # at the lower edge, 35 degrees down, that is 2.9 m below the eye
    assert ground_share(depth, FLAT + 1, CAMERA, ground_m=-1.4)[-1, 30] > 0.9
    assert ground_share(depth, FLAT + 1, CAMERA, ground_m=-3.0)[-1, 30] == 0
    everywhere = ground_share(depth, FLAT + 1, CAMERA, ground_m=None)
    np.testing.assert_array_equal(everywhere, 1)
    assert not ground_share(FLAT, FLAT + 1, CAMERA, ground_m=None).any()
    assert not ground_share(depth, FLAT + np.float32(0.5), CAMERA, ground_m=None).any()


@pytest.mark.parametrize("color", [(0, 0, 0), (1, 1, 1), (1, 0, 0), (3.0, -1.0, 0.5)])
@pytest.mark.parametrize("sky", [0.0, 0.5, 1.0])
def test_result_is_a_display_colour(color, sky):
    for depth, upness in ((0.0, 0.0), (3.0, 1.0)):
        result = look(color, upness=upness, sky=sky, depth=depth, ground_m=0.0)
        assert result.dtype == np.float32
        assert np.isfinite(result).all()
        assert (result >= 0).all()
        assert (result <= 1).all()
