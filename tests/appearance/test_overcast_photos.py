"""Light of single photographs under clouds: which are softened, and what softening does to road, sky and markings."""

from dataclasses import replace

import numpy as np
import pytest

from appearance.sunny_street import COLUMNS, HEIGHT, LINE, ROAD, ROWS, SHADOW, SKY, capture_of, street_photo
from gsrain_engine.appearance.capture_photos import CapturePhotos
from gsrain_engine.appearance.overcast_photos import whole_sky
from gsrain_engine.datasets.capture import Capture
from gsrain_engine.rain.keyframes import RainKeyframe, RainKeyframes
from gsrain_engine.rain.settings import RainSettings
from gsrain_engine.rain.simulation import RainSimulation
from gsrain_engine.rain.wetness import SOFTENED_ABOVE_MM_H
from gsrain_engine.scene.lens import Lens

RAIN = RainSettings(intensity_mm_h=8.0, streaks=False, haze="none")


def drawn(capture, index=0, rain=RAIN):
    """The photograph of a view as it is drawn, behind no drops."""
    return CapturePhotos(capture).frame(capture[index], RainSimulation.start(rain))


def levels(picture):
    """Mean brightness of road in the sun and in shadow."""
    inside = ROAD & (COLUMNS % 40 > 6) & (COLUMNS % 40 < 34) & (ROWS < HEIGHT - 20) & ~LINE
    return picture[inside & ~SHADOW].mean(), picture[inside & SHADOW].mean()


@pytest.mark.parametrize("lens", [None, Lens("opencv", (-0.05, 0.01, 0.0, 0.0, 0.0))])
def test_sun_and_shadows_of_a_sunny_photograph_become_those_of_clouds(lens):
    photo = street_photo()
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
    photo = street_photo()
    found = drawn(capture_of(photo)).photograph.pixels
    middle = ROAD & ~SHADOW & ~LINE & (COLUMNS % 40 > 10) & (COLUMNS % 40 < 30)
    share = found[middle].mean() / photo[middle].mean()
    assert found[middle].std() > 0.7 * share * photo[middle].std()


@pytest.mark.parametrize(
    ("photo", "changes", "options", "kept"),
    [
        ((street_photo() * 0.08).astype(np.uint8), {}, {}, "by night"),
        (street_photo(sunny=False), {}, {}, "already overcast"),
        (street_photo(), {"intensity_mm_h": SOFTENED_ABOVE_MM_H}, {}, "at most 2.5 mm/h"),
        (street_photo(), {"keep_light": True}, {}, "--keep-light"),
        (street_photo(), {}, {"depth": None}, "no distances"),
        (street_photo(), {}, {"sky": np.zeros_like(SKY)}, "no certain sky"),
    ],
)
def test_other_photographs_stay_the_same_bytes(photo, changes, options, kept):
    rain = RainSettings(**{"intensity_mm_h": 8.0, "streaks": False, "haze": "none"} | changes)
    photograph = drawn(capture_of(photo, **options), rain=rain).photograph
    assert photograph.light.words == f"kept ({kept})"
    assert photograph.pixels.tobytes() == photo.tobytes()


def test_each_photograph_is_lit_by_itself_alone():
    photos = street_photo(), (street_photo() * 0.08).astype(np.uint8), street_photo(sunny=False), street_photo(seed=1)
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
    capture = capture_of(street_photo(), street_photo(), street_photo())
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
