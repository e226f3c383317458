"""Light of single photographs under clouds: which are softened, and what softening does to road, sky and markings."""

from dataclasses import replace

import numpy as np
import pytest

from gsrain_engine.appearance.capture_photos import CapturePhotos
from gsrain_engine.appearance.overcast_photos import SOFTENED_ABOVE_MM_H, whole_sky
from gsrain_engine.datasets.capture import Capture, CaptureFrame
from gsrain_engine.rain.keyframes import RainKeyframe, RainKeyframes
from gsrain_engine.rain.settings import RainSettings
from gsrain_engine.rain.simulation import RainSimulation
from gsrain_engine.scene.camera import Camera
from gsrain_engine.scene.lens import Lens

WIDTH, HEIGHT, HORIZON = 240, 160, 70
LEVEL = np.array([[0.0, -1, 0, 0], [0, 0, -1, 1.5], [1, 0, 0, 0], [0, 0, 0, 1]])
CAMERA = Camera(WIDTH, HEIGHT, 200.0, 200.0, WIDTH / 2, float(HORIZON), LEVEL)
ROWS, COLUMNS = np.mgrid[:HEIGHT, :WIDTH]
SKY = ROWS < HORIZON - 10
WALL = ~SKY & (ROWS < HORIZON + 8)
ROAD = ROWS >= HORIZON + 8
SHADOW = ROAD & ((COLUMNS // 40) % 2 == 0) & (ROWS < HEIGHT - 12)
LINE = ROAD & (np.abs(COLUMNS - 60) < 3)
"""A road marking in the sun."""
DEPTH = np.where(SKY, 0, np.where(WALL, 40.0, 1.5 * 200.0 / np.maximum(ROWS + 0.5 - HORIZON, 1))).astype(np.float32)
RAIN = RainSettings(intensity_mm_h=8.0, streaks=False, haze="none")


def street(*, sunny=True, seed=0):
    """A gray road with shadows of trees under a blue sky, or the same road and a gray sky."""
    photo = np.zeros((HEIGHT, WIDTH, 3))
    photo[SKY] = (110, 160, 225) if sunny else (205, 208, 212)
    photo[WALL] = (120, 110, 100)
    photo[ROAD] = 175 if sunny else 110
    if sunny:
        photo[SHADOW] = (60, 62, 66)
    photo[LINE] = np.where(SHADOW[LINE][:, None], 100, 240) if sunny else 190
    photo[~SKY] += np.random.default_rng(seed).normal(0, 3, photo[~SKY].shape)
    return np.clip(photo, 0, 255).astype(np.uint8)


def capture_of(*photos, depth=DEPTH, sky=SKY, lens=None):
    views = (
        CaptureFrame(
            f"view {i}", CAMERA, photo, time_s=float(i), lens=lens, depth_source=depth,
            sky_source=sky if depth is not None else None,
        )
        for i, photo in enumerate(photos)
    )  # fmt: skip
    return Capture("street", tuple(views))


def drawn(capture, index=0, rain=RAIN):
    """The photograph of a view as it is drawn, behind no drops."""
    return CapturePhotos(capture).frame(capture[index], RainSimulation.start(rain))


def levels(picture):
    """Mean brightness of road in the sun and in shadow."""
    inside = ROAD & (COLUMNS % 40 > 6) & (COLUMNS % 40 < 34) & (ROWS < HEIGHT - 20) & ~LINE
    return picture[inside & ~SHADOW].mean(), picture[inside & SHADOW].mean()


@pytest.mark.parametrize("lens", [None, Lens("opencv", (-0.05, 0.01, 0.0, 0.0, 0.0))])
def test_sun_and_shadows_of_a_sunny_photograph_become_those_of_clouds(lens):
    photo = street()
    frame = drawn(capture_of(photo, lens=lens))
    found = frame.photograph.pixels
    assert frame.photograph.light.words == "softened to overcast (sun 1.00)" and not frame.is_unchanged
    (sunlit, shadow), (was_sunlit, was_shadow) = levels(found), levels(photo)
    assert was_sunlit / was_shadow > 2.5 and sunlit / shadow < 1.4
    assert shadow > was_shadow + 20 and sunlit < was_sunlit - 20
    sky = found[:30].reshape(-1, 3).mean(axis=0)
    assert np.ptp(sky) < 10 and sky.min() > 190
    np.testing.assert_allclose(np.array(frame.light.airlight) * 255, sky, atol=8)  # haze is not blue
    if lens is None:
        line = LINE & ~SHADOW & (ROWS < HEIGHT - 20)
        assert found[line].mean() > sunlit + 25


def test_grain_of_the_road_stays():
    photo = street()
    found = drawn(capture_of(photo)).photograph.pixels
    middle = ROAD & ~SHADOW & ~LINE & (COLUMNS % 40 > 10) & (COLUMNS % 40 < 30)
    share = found[middle].mean() / photo[middle].mean()
    assert found[middle].std() > 0.7 * share * photo[middle].std()


@pytest.mark.parametrize(
    ("photo", "changes", "options", "kept"),
    [
        ((street() * 0.08).astype(np.uint8), {}, {}, "by night"),
        (street(sunny=False), {}, {}, "already overcast"),
        (street(), {"intensity_mm_h": SOFTENED_ABOVE_MM_H}, {}, "at most 2.5 mm/h"),
        (street(), {"keep_light": True}, {}, "--keep-light"),
        (street(), {}, {"depth": None}, "no distances"),
        (street(), {}, {"sky": np.zeros_like(SKY)}, "no certain sky"),
    ],
)
def test_other_photographs_stay_the_same_bytes(photo, changes, options, kept):
    rain = RainSettings(**{"intensity_mm_h": 8.0, "streaks": False, "haze": "none"} | changes)
    photograph = drawn(capture_of(photo, **options), rain=rain).photograph
    assert photograph.light.words == f"kept ({kept})"
    assert photograph.pixels.tobytes() == photo.tobytes()


def test_each_photograph_is_lit_by_itself_alone():
    photos = street(), (street() * 0.08).astype(np.uint8), street(sunny=False), street(seed=1)
    together = capture_of(*photos)
    among = CapturePhotos(together)
    for view, photo in zip(together, photos, strict=True):
        alone = drawn(Capture("street", (replace(view, image_source=photo),)))
        found = among.frame(view, RainSimulation.start(RAIN))
        assert found.photograph.pixels.tobytes() == alone.photograph.pixels.tobytes()
        assert found.light == alone.light


def test_light_follows_a_rain_that_changes():
    keys = RainKeyframe(time_s=0.0, intensity_mm_h=1.0), RainKeyframe(time_s=2.0, intensity_mm_h=20.0)
    rainfall = RainSimulation.start(RAIN, weather=RainKeyframes(keys=keys))
    capture = capture_of(street(), street(), street())
    photos = CapturePhotos(capture)
    kinds = [photos.light(view, rainfall).kind for view in capture]
    assert kinds[0] == "kept (at most 2.5 mm/h)" and kinds[2] == "softened to overcast"


def test_deep_blue_between_clouds_belongs_to_the_sky():
    image = np.full((40, 60, 3), 250, np.uint8)
    image[10:20, 20:40] = (60, 110, 190)  # a gap between clouds
    image[30:] = (60, 110, 190)  # a blue wall, measured
    sure, measured = (image[..., 0] > 200), np.zeros((40, 60), bool)
    measured[29:] = True
    found = whole_sky(sure, image, measured)
    assert found[:29].all() and not found[29:].any()
