"""Signal processing of a sensor: noise of even surfaces is smoothed, that of details and details themselves remain."""

import numpy as np
import pytest

from gsrain_engine.render.camera_response import CameraResponse, display_noise
from gsrain_engine.render.signal_processing import processed
from gsrain_engine.scene.camera import Camera
from gsrain_engine.scene.sensor import Sensor

CAMERA = Camera(240, 160, 200.0, 200.0, 120.0, 80.0)
FIELDS = {"size_px": (240, 160), "full_well_e": 600.0, "read_noise_e": 2.0}
RAW, REDUCED = Sensor(**FIELDS), Sensor(**FIELDS, noise_reduction=1.2)


def even_and_striped():
    image = np.full((160, 240, 3), 100, np.uint8)
    image[:, 120:] += 60 * (np.arange(120) // 4 % 2).astype(np.uint8)[None, :, None]
    return image


def residuals(sensor):
    """Luma of noise in the even and in the striped half."""
    made = [
        CameraResponse(sensor, CAMERA, 0.1 * k).picture(even_and_striped()) @ [0.299, 0.587, 0.114] for k in range(12)
    ]
    values = np.stack(made) - np.mean(made, axis=0)
    return values[:, 8:-8, 8:112], values[:, 8:-8, 128:-8]


def correlation(values):
    return float((values[..., 1:] * values[..., :-1]).mean() / (values**2).mean())


def test_noise_is_smoothed_on_even_surfaces_and_remains_in_details():
    (raw_even, raw_striped), (even, striped) = residuals(RAW), residuals(REDUCED)
    assert even.std() < 0.55 * raw_even.std()
    assert striped.std() > 0.8 * raw_striped.std()
    assert abs(correlation(raw_even)) < 0.03 and correlation(even) > 0.5
    assert correlation(striped) < 0.2


def test_details_remain_and_are_sharpened():
    clean = even_and_striped().astype(np.float32)
    noise = display_noise(RAW, 160)[clean[..., 0].astype(np.uint8)]
    reduced, sharp = (processed(clean, noise, each) for each in (REDUCED, Sensor(**FIELDS, sharpening=1.0)))
    assert np.abs(reduced - clean)[8:-8, 128:-8].max() < 6
    assert np.ptp(sharp[80, 140:220]) > 1.3 * np.ptp(clean[80, 140:220])
    np.testing.assert_allclose(sharp.mean(), clean.mean(), atol=0.3)


def test_color_differences_are_blurred():
    sensor = Sensor(**FIELDS, chroma_blur_px=(2.0, 1.0))
    values = np.stack(
        [CameraResponse(sensor, CAMERA, 0.1 * k).picture(np.full((160, 240, 3), 110, np.uint8)) for k in range(4)]
    )
    red = values[..., 0].astype(float) - values.mean(axis=3)
    across = float((red[:, :, 3:] * red[:, :, :-3]).mean() / (red - red.mean()).var())
    down = float((red[:, 3:] * red[:, :-3]).mean() / (red - red.mean()).var())
    assert across > down + 0.15 and across > 0.5


@pytest.mark.parametrize("field", ["demosaic_px", "noise_reduction", "sharpening"])
def test_a_processed_signal_over_a_photograph_leaves_the_rest(field):
    behind = np.random.default_rng(0).uniform(0, 255, (40, 60, 3)).astype(np.float32)
    signal = np.zeros_like(behind)
    signal[:20] = 20
    made = processed(signal, np.full((40, 60), 5, np.float32), Sensor(**FIELDS, **{field: 1.0}), behind)
    np.testing.assert_allclose(made[28:], behind[28:], atol=1e-3)
    np.testing.assert_allclose(made[:12], behind[:12] + 20, atol=1.5)
