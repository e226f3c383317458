"""The figure of a calibration."""

from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from gsrain_engine.disdrometer.fit import fit_calibration
from gsrain_engine.disdrometer.fit_models import AxisRatios, FitOptions
from gsrain_engine.disdrometer.fit_plot import draw_calibration, write_plot
from measured_rain import measured_rain


@pytest.fixture(scope="module")
def fitted():
    rain = [
        measured_rain(271.0, 9.705, 0.074, minutes=20, seed=1),
        measured_rain(1190.0, 7.132, 0.114, minutes=8, seed=2, start="2024-05-01T12:00"),
    ]
    options = FitOptions(intensities_mm_h=(0.8, 6.6), half_width=0.5, resamples=50)
    return fit_calibration(rain, name="drawn", source="drawn", options=options)


def titled(figure):
    return {axes.get_title(loc="left"): axes for axes in figure.axes if axes.get_title(loc="left")}


def test_every_panel_is_there_with_units(fitted):
    panels = titled(draw_calibration(fitted))
    assert [title.split(")")[0] for title in panels] == ["(a", "(b", "(c", "(d", "(e"]
    for axes in panels.values():
        assert "mm" in axes.get_xlabel()
        assert axes.get_ylabel()
        assert axes.get_legend() is not None


def test_spectra_and_fits_lie_where_the_numbers_say(fitted):
    spectra = next(iter(titled(draw_calibration(fitted)).values()))
    points, law = spectra.lines[2:4]  # of the second row
    row = fitted.rows[1]
    assert points.get_ydata() == pytest.approx(row.spectrum_m3_mm[row.spectrum_m3_mm > 0])
    assert np.trapezoid(law.get_ydata(), law.get_xdata()) == pytest.approx(row.row.density_m3, rel=0.01)


def test_axis_ratios_get_a_panel_of_their_own(fitted):
    ratios = AxisRatios(
        diameters_mm=np.array([1.1, 2.0, 3.0]),
        medians=np.array([0.99, 0.93, 0.86]),
        quartiles=np.array([[0.9, 0.85, 0.8], [1.0, 0.98, 0.9]]),
        drops=300,
        offset=1.07,
        slope_per_mm=-0.07,
        r2=0.9,
    )
    panels = titled(draw_calibration(replace(fitted, axis_ratios=ratios)))
    assert len(panels) == 6
    assert "(c) Axis ratio" in panels


def test_a_fit_without_speeds_or_intervals_can_be_drawn(fitted):
    bare = replace(fitted, speeds=None, velocity_confidence=None, minute_reported_mm_h=fitted.minute_rate_mm_h * np.nan)
    assert len(titled(draw_calibration(bare))) == 5


@pytest.mark.parametrize("kind", ["png", "svg"])
def test_the_same_fit_gives_the_same_bytes(fitted, tmp_path, kind):
    first, second = tmp_path / f"a.{kind}", tmp_path / f"b.{kind}"
    write_plot(fitted, first)
    write_plot(fitted, second)
    assert first.read_bytes() == second.read_bytes()
    assert len(first.read_bytes()) > 20_000
    if kind == "png":
        with Image.open(first) as picture:
            assert picture.size == (1950, 1140)


def test_other_kinds_are_refused(fitted, tmp_path):
    with pytest.raises(ValueError, match="plot.bmp: expected a name that ends with .png, .pdf, .svg"):
        write_plot(fitted, tmp_path / "plot.bmp")
    assert list(tmp_path.iterdir()) == []
