"""Fits to counts of the virtual disdrometer return the law that the drops were drawn from."""

import msgspec
import numpy as np
import pytest

from gsrain_engine.disdrometer.fit import fit_calibration
from gsrain_engine.disdrometer.fit_models import FitOptions
from gsrain_engine.disdrometer.virtual import VirtualDisdrometer
from gsrain_engine.rain.settings import RainSettings, load_preset
from gsrain_engine.rain.simulation import RainSimulation

INTENSITIES = (1.2, 8.5, 12.0)


@pytest.mark.parametrize("calibration", ["published", "locarno_2018", "marshall_palmer"])
def test_the_virtual_disdrometer_closes_the_loop(calibration):
    instruments = []
    for intensity in INTENSITIES:
        values = msgspec.to_builtins(load_preset("paper"))
        rain = msgspec.convert(
            values | {"intensity_mm_h": intensity, "calibration": calibration, "closure": "density"}, RainSettings
        )
        instruments.append(VirtualDisdrometer(RainSimulation.start(rain), area_m2=0.5))
    counted = [each.measure(np.arange(4) * 40.0) for each in instruments]
    options = FitOptions(intensities_mm_h=INTENSITIES, resamples=0)
    fitted = fit_calibration([each.spectra for each in counted], name="virtual", source="simulated", options=options)
    for row, each in zip(fitted.calibration.rows, counted, strict=True):
        assert row.density_m3 == pytest.approx(each.state.density_m3, rel=0.03)
        assert row.shape == pytest.approx(each.state.shape, rel=0.05)
        assert row.scale_mm == pytest.approx(each.state.scale_mm, rel=0.05)
        assert row.intensity_mm_h == pytest.approx(each.state.intensity_mm_h, rel=0.03)
    asked = instruments[0].rainfall.calibration.velocity
    d = np.linspace(0.5, 2, 7)
    assert fitted.calibration.velocity(d) == pytest.approx(asked(d), rel=0.03)
