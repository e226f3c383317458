import numpy as np

from gsrain_engine.rain.calibration import load_calibration
from gsrain_engine.rain.properties import calibration_curves, spectrum_at


def test_curves_run_through_the_rows_and_spectra_add_up():
    published = load_calibration("published")
    curves = calibration_curves(published)
    for row, implied in zip(published.rows, (0.80, 6.59, 11.03), strict=True):
        at = np.log(row.intensity_mm_h), np.log(curves.intensities_mm_h)
        np.testing.assert_allclose(np.exp(np.interp(*at, np.log(curves.density_m3))), row.density_m3, rtol=0.01)
        np.testing.assert_allclose(np.interp(*at, curves.implied_share), implied / row.intensity_mm_h, rtol=0.02)
        spectrum = spectrum_at(published, row.intensity_mm_h)
        np.testing.assert_allclose(np.trapezoid(spectrum, curves.diameters_mm), row.density_m3, rtol=0.01)
    np.testing.assert_allclose(curves.fall_speed_m_s, published.velocity(curves.diameters_mm))
