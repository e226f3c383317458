"""Calibration and Disdrometer panels: fit and comparison of rain calibrations, and a virtual disdrometer."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from imgui_bundle import imgui, implot

from gsrain_engine.disdrometer.fit_models import FittedCalibration
from gsrain_engine.disdrometer.measurement import DisdrometerMeasurement
from gsrain_engine.editor.document import Document
from gsrain_engine.editor.live_rain import LiveRain
from gsrain_engine.editor.rain import CalibrationTools
from gsrain_engine.rain.calibration import Calibration
from gsrain_engine.rain.properties import CalibrationCurves, calibration_curves, spectrum_at

from ..widgets.draw import line, plot, points
from ..widgets.fields import LOGARITHMIC, button, combo, number, plain_label, warn
from ..widgets.file_dialogs import ask_what_to_open
from ..widgets.text import readings, visible_name

_FAINTEST = 1e-2
_CALIBRATIONS = "Calibrations{.yaml,.yml},All files{.*}"
_FIT_HELP = (
    "Fit a calibration to disdrometer files. For a table of unknown format, also choose a YAML file that names its "
    "columns."
)


def calibration_panel(document: Document, live_rain: LiveRain, calibration: CalibrationTools) -> None:
    own = live_rain.simulation.calibration
    _choose(document, calibration)
    imgui.text_wrapped(own.source)
    _fit(calibration)
    fitted = calibration.fitted
    compared = _series((own, calibration.pass_file, None if fitted is None else fitted.calibration))
    _plots(document, compared, fitted)


def _choose(document: Document, calibration: CalibrationTools) -> None:
    present = document.rain.calibration
    calibration.add_file(present)
    choices = {each: Path(each).stem for each in calibration.calibrations}
    plain_label("Rain calibration", "Source of the drops' number, sizes and fall speeds.")
    if (picked := combo("##calibration", present, choices)) != present:
        calibration.use(picked)
    plain_label("Compare with", "A calibration to compare with.")
    if (picked := combo("##compared", calibration.compared, choices)) != calibration.compared:
        calibration.compare(picked)
    if button("Open...", "Use a calibration file."):
        ask_what_to_open("Open a calibration", _CALIBRATIONS, lambda chosen: calibration.use(str(chosen[0])))
    imgui.same_line()
    if button("Fit to measurements...", _FIT_HELP, enabled=calibration.busy is None):
        ask_what_to_open("Disdrometer files of one instrument", "Disdrometer files{.*}", calibration.fit, several=True)


def _fit(calibration: CalibrationTools) -> None:
    if calibration.busy is not None:
        imgui.text_disabled(calibration.busy)
    warn(calibration.error)
    help_text = "Fit to drops that contradict the instrument's own rain rate: snow, insects, other size classes."
    if calibration.disagreeing and calibration.busy is None and button("Calibrate anyway", help_text):
        calibration.fit(calibration.disagreeing, force=True)
    if calibration.fitted is not None:
        _fitted(calibration, calibration.fitted)
    if calibration.measured:
        imgui.separator_text("Measured")
    for each in calibration.measured:  # drops, rain, rejected records and reasons, and agreement of the rates of a file
        first, *others = each.lines
        imgui.text_wrapped(first)
        imgui.indent()
        for other in others:
            imgui.text_wrapped(other.strip())
        imgui.unindent()


def _fitted(calibration: CalibrationTools, fitted: FittedCalibration) -> None:
    imgui.separator_text(visible_name(f"Fitted: {fitted.calibration.name}"))
    imgui.text_wrapped(f"{fitted.records_used:,} of {fitted.records:,} records in {len(fitted.rows)} rows")
    if fitted.rate_check is not None and len(calibration.measured) > 1:
        imgui.text_wrapped(f"all files: {fitted.rate_check.line}")
    r2 = fitted.calibration.velocity.r2
    imgui.text_wrapped("fall speed assumed: none was measured" if r2 is None else f"fall speed: R2 = {r2:.4f}")
    if button("Save and use", "Save it among your calibrations, and use it for the rain."):
        calibration.use_fitted()


class _Series(NamedTuple):
    """A calibration in the plots, in the color of its number in all of them."""

    number: int
    calibration: Calibration
    curves: CalibrationCurves


_MEASURED = 3
"""Number of the measured drops; those of calibrations are before it."""


def _series(calibrations: Sequence[Calibration | None]) -> dict[str, _Series]:
    """Return what is compared by name: each has the number of its first place, whatever else is there."""
    found = dict[str, _Series]()
    for place, each in enumerate(calibrations):
        if each is not None and each.name not in found:
            found[each.name] = _Series(place, each, calibration_curves(each))
    return found


def _plots(document: Document, compared: Mapping[str, _Series], fitted: FittedCalibration | None) -> None:
    several = len(compared) > 1
    with plot("Number density", "mm/h", "drops per m\u00b3", log_x=True, log_y=True, legend=several) as is_visible:
        for name, each in compared.items() if is_visible else ():
            line(name, each.curves.intensities_mm_h, each.curves.density_m3, each.number)
            rows = each.calibration
            points(name, _of_rows(rows, "intensity_mm_h"), _of_rows(rows, "density_m3"), each.number)
    with plot("Mean diameter", "mm/h", "mm", log_x=True, legend=several) as is_visible:
        for name, each in compared.items() if is_visible else ():
            line(name, each.curves.intensities_mm_h, each.curves.mean_diameter_mm, each.number)
            means_mm = _of_rows(each.calibration, "shape") * _of_rows(each.calibration, "scale_mm")
            points(name, _of_rows(each.calibration, "intensity_mm_h"), means_mm, each.number)
    middles = None if fitted is None else 0.5 * (fitted.diameter_edges_mm[:-1] + fitted.diameter_edges_mm[1:])
    intensity = document.rain.intensity_mm_h or 8.5
    title = f"Spectrum at {intensity:.3g} mm/h###spectrum"
    legend = several or fitted is not None
    with plot(title, "mm", "N(D) per m\u00b3 and mm", log_y=True, legend=legend) as is_visible:
        for name, each in compared.items() if is_visible else ():
            spectrum = spectrum_at(each.calibration, intensity)
            there = spectrum > _FAINTEST
            line(name, each.curves.diameters_mm[there], spectrum[there], each.number)
        if is_visible and fitted is not None and middles is not None:
            nearest = min(fitted.rows, key=lambda row: abs(np.log(row.row.intensity_mm_h / intensity)))
            there = nearest.spectrum_m3_mm > _FAINTEST
            name = f"measured at {nearest.row.intensity_mm_h:.3g} mm/h"
            points(name, middles[there], nearest.spectrum_m3_mm[there], _MEASURED)
    with plot("Fall speed", "mm", "m/s", legend=legend) as is_visible:
        for name, each in compared.items() if is_visible else ():
            line(name, each.curves.diameters_mm, each.curves.fall_speed_m_s, each.number)
        if is_visible and fitted is not None and middles is not None and fitted.speeds is not None:
            there = fitted.speeds.fitted
            points("measured", middles[there], fitted.speeds.mean_m_s[there], _MEASURED)
    with plot("Flux closure", "mm/h", "implied / mm/h", log_x=True, legend=several) as is_visible:
        for name, each in compared.items() if is_visible else ():
            line(name, each.curves.intensities_mm_h, each.curves.implied_share, each.number)


def _of_rows(calibration: Calibration, field: str) -> np.ndarray:
    return np.array([getattr(row, field) for row in calibration.rows])


# Disdrometer panel: measures the simulated rain rate

_STEP_MM = 0.1


def disdrometer_panel(document: Document, calibration: CalibrationTools) -> None:
    rain = document.rain_now
    help_text = "Area of the horizontal square that catches drops."
    calibration.area_m2 = number(
        "Area (m\u00b2)", "area", calibration.area_m2, 0.005, 10, "%.3g", help_text, LOGARITHMIC
    )
    help_text = "Simulated time; a minute takes a fraction of a second."
    calibration.seconds = number("Time (s)", "seconds", calibration.seconds, 1, 3600, "%.0f", help_text, LOGARITHMIC)
    help_text = "Count the simulated drops that fall through the square."
    if button("Measure", help_text, enabled=calibration.busy is None and rain.intensity_mm_h != 0):
        calibration.measure()
    if calibration.busy is not None:
        imgui.same_line()
        imgui.text_disabled(calibration.busy)
    if rain.intensity_mm_h == 0:
        imgui.text_wrapped("0 mm/h: nothing to count.")
    warn(calibration.error)
    if calibration.counted is not None:
        _result(calibration.counted)


def _result(counted: DisdrometerMeasurement) -> None:
    state, error = counted.state, counted.standard_error_mm_h
    deviation = (counted.rate_mm_h - state.implied_mm_h) / error if error > 0 else 0.0
    diameter = "none" if counted.mean_diameter_mm is None else f"{counted.mean_diameter_mm:.3f} mm"
    rows = (
        ("Set rain rate", f"{state.implied_mm_h:.3f} mm/h", "Rain rate of the simulated drops."),
        ("Measured", f"{counted.rate_mm_h:.3f} \u00b1 {error:.3f} mm/h", "With its standard error."),
        ("Deviation", f"{deviation:+.1f} standard errors", "Within 3 it agrees."),
        ("Drops counted", f"{counted.drops:,}", f"On {counted.area_m2:g} m\u00b2 in {counted.seconds.sum():g} s."),
        ("Drops per m\u00b3", f"{counted.density_m3:,.0f}", f"Set: {state.density_m3:,.0f}."),
        ("Mean diameter", diameter, f"In the air. Set: {state.mean_diameter_mm:.3f} mm."),
    )
    readings("counted", rows)
    edges = counted.spectra.diameter_edges_mm
    middles = 0.5 * (edges[:-1] + edges[1:])
    in_air, _ = np.histogram(counted.diameters_mm, edges, weights=counted.in_air_m3)
    law = state.density_m3 * state.sizes.probability_per_mm(middles)
    last = int(np.flatnonzero(in_air).max(initial=0)) + 2
    with plot("Drops in the air", "mm", "N(D) per m\u00b3 and mm", legend=True) as is_visible:
        if is_visible:
            implot.plot_bars("counted", middles[:last], in_air[:last] / _STEP_MM, 0.9 * _STEP_MM)
            line("set", middles[:last], law[:last], series=1)
