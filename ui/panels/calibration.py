"""Calibration and Disdrometer panels: fit and comparison of rain calibrations, and a virtual disdrometer."""

from pathlib import Path

import numpy as np
from imgui_bundle import imgui, implot

from gsrain_engine.disdrometer.fit_models import FittedCalibration
from gsrain_engine.disdrometer.measurement import DisdrometerMeasurement
from gsrain_engine.editor.editor import Editor
from gsrain_engine.editor.rain import CalibrationTools, compare_calibration, use_calibration, use_fitted_calibration
from gsrain_engine.rain.calibration import Calibration
from gsrain_engine.rain.properties import CalibrationCurves, calibration_curves, spectrum_at

from ..widgets.draw import line, plot, points
from ..widgets.fields import ask_what_to_open, plain_label
from ..widgets.text import readings, visible_name
from .rain import WARNING

_FAINTEST = 1e-2
_MEASUREMENTS = "Disdrometer files{.*}"
_CALIBRATIONS = "Calibrations{.yaml,.yml},All files{.*}"


def calibration_panel(session: Editor) -> None:
    lab = session.lab
    own = session.rainfall.calibration
    _choose(session)
    imgui.text_wrapped(own.source)
    _fit(session)
    shown = {own.name: own}
    if lab.fitted is not None:
        shown.setdefault(lab.fitted.calibration.name, lab.fitted.calibration)
    shown.setdefault(lab.pass_file.name, lab.pass_file)
    _plots(session, shown)


def _choose(session: Editor) -> None:
    lab, present = session.lab, session.rain.calibration
    lab.add_file(present)
    names = lab.calibrations
    plain_label("Rain follows", "The calibration that drop numbers, sizes and speeds come from.")
    changed, index = imgui.combo("##calibration", names.index(present), [Path(each).stem for each in names])
    if changed:
        use_calibration(session, lab, names[index])
    plain_label("Beside it", "A calibration to compare with.")
    changed, index = imgui.combo("##compared", names.index(lab.compared), [Path(each).stem for each in names])
    if changed:
        compare_calibration(session, lab, names[index])
    if imgui.button("Open..."):
        ask_what_to_open(
            "Open a calibration", _CALIBRATIONS, lambda chosen: use_calibration(session, lab, str(chosen[0]))
        )
    imgui.set_item_tooltip("Let the rain follow a calibration file.")
    imgui.same_line()
    imgui.begin_disabled(lab.busy is not None)
    if imgui.button("Fit to measurements..."):
        ask_what_to_open("Disdrometer files of one instrument", _MEASUREMENTS, lab.fit, several=True)
    imgui.end_disabled()
    imgui.set_item_tooltip(
        "Fit a calibration to disdrometer files. With a table of an unknown kind choose a YAML file, too, that says "
        "which column is what."
    )


def _fit(session: Editor) -> None:
    lab, fitted = session.lab, session.lab.fitted
    if lab.busy is not None:
        imgui.text_disabled(lab.busy)
    if lab.problem is not None:
        imgui.push_style_color(imgui.Col_.text, WARNING)
        imgui.text_wrapped(lab.problem)
        imgui.pop_style_color()
    if lab.disagreeing and lab.busy is None:
        if imgui.button("Calibrate anyway"):
            lab.fit(lab.disagreeing, force=True)
        imgui.set_item_tooltip(
            "Fit to drops that don't give the instrument's own rain rate: snow, insects, other classes."
        )
    if fitted is not None:
        _fitted(session, lab, fitted)
    _measured(lab)


def _fitted(session: Editor, lab: CalibrationTools, fitted: FittedCalibration) -> None:
    imgui.separator_text(visible_name(f"Fitted: {fitted.calibration.name}"))
    imgui.text_wrapped(f"{fitted.records_used:,} of {fitted.records:,} records in {len(fitted.rows)} rows")
    if fitted.rate_check is not None and len(lab.measured) > 1:
        imgui.text_wrapped(f"all files: {fitted.rate_check.line}")
    r2 = fitted.calibration.velocity.r2
    imgui.text_wrapped("fall speed assumed: none was measured" if r2 is None else f"fall speed: R2 = {r2:.4f}")
    if imgui.button("Keep and use"):
        use_fitted_calibration(session, lab)
    imgui.set_item_tooltip("Save it among your calibrations, and let the rain follow it.")


def _measured(lab: CalibrationTools) -> None:
    """Draw the summary of each chosen file: drops, rain, rejected records with reasons, and agreement of its rates."""
    if lab.measured:
        imgui.separator_text("Measured")
    for each in lab.measured:
        first, *others = each.lines
        imgui.text_wrapped(first)
        imgui.indent()
        for each_line in others:
            imgui.text_wrapped(each_line.strip())
        imgui.unindent()


def _plots(session: Editor, shown: dict[str, Calibration]) -> None:
    curves = {name: calibration_curves(each) for name, each in shown.items()}
    _density(shown, curves)
    _sizes(shown, curves)
    _spectra(session, shown, curves)
    _speeds(session, curves)
    _closure(curves)


def _density(shown: dict[str, Calibration], curves: dict[str, CalibrationCurves]) -> None:
    with plot("Number density", "mm/h", "drops per m\u00b3", log_x=True, log_y=True, legend=True) as seen:
        if seen:
            for name, each in shown.items():
                line(name, curves[name].intensities_mm_h, curves[name].density_m3)
                rows = each.rows
                points(name, np.array([r.intensity_mm_h for r in rows]), np.array([r.density_m3 for r in rows]))


def _sizes(shown: dict[str, Calibration], curves: dict[str, CalibrationCurves]) -> None:
    with plot("Mean diameter", "mm/h", "mm", log_x=True) as seen:
        if seen:
            for name, each in shown.items():
                line(name, curves[name].intensities_mm_h, curves[name].mean_diameter_mm)
                rows = each.rows
                points(name, np.array([r.intensity_mm_h for r in rows]), np.array([r.shape * r.scale_mm for r in rows]))


def _spectra(session: Editor, shown: dict[str, Calibration], curves: dict[str, CalibrationCurves]) -> None:
    intensity = session.rain.intensity_mm_h or 8.5
    with plot(f"Spectrum at {intensity:.3g} mm/h###spectrum", "mm", "N(D) per m\u00b3 and mm", log_y=True) as seen:
        if seen:
            for name, each in shown.items():
                spectrum = spectrum_at(each, intensity)
                there = spectrum > _FAINTEST
                line(name, curves[name].diameters_mm[there], spectrum[there])
            fitted = session.lab.fitted
            if fitted is not None:
                nearest = min(fitted.rows, key=lambda row: abs(np.log(row.row.intensity_mm_h / intensity)))
                middles = 0.5 * (fitted.diameter_edges_mm[:-1] + fitted.diameter_edges_mm[1:])
                there = nearest.spectrum_m3_mm > _FAINTEST
                measured = f"measured at {nearest.row.intensity_mm_h:.3g} mm/h"
                points(measured, middles[there], nearest.spectrum_m3_mm[there])


def _speeds(session: Editor, curves: dict[str, CalibrationCurves]) -> None:
    with plot("Fall speed", "mm", "m/s") as seen:
        if seen:
            for name, each in curves.items():
                line(name, each.diameters_mm, each.fall_speed_m_s)
            fitted = session.lab.fitted
            if fitted is not None and fitted.speeds is not None:
                used = fitted.speeds.fitted
                middles = 0.5 * (fitted.diameter_edges_mm[:-1] + fitted.diameter_edges_mm[1:])
                points("measured", middles[used], fitted.speeds.mean_m_s[used])


def _closure(curves: dict[str, CalibrationCurves]) -> None:
    with plot("Flux closure", "mm/h", "implied / mm/h", log_x=True) as seen:
        if seen:
            for name, each in curves.items():
                line(name, each.intensities_mm_h, each.implied_share)


# Disdrometer panel: measures the simulated rain rate

_STEP_MM = 0.1


def disdrometer_panel(session: Editor) -> None:
    lab, rain = session.lab, session.rain_now
    plain_label("Area (m\u00b2)", "Of the horizontal square that catches drops.")
    _, lab.area_m2 = imgui.slider_float("##area", lab.area_m2, 0.005, 10, "%.3g", _LOGARITHMIC)
    plain_label("Time (s)", "Simulated: sixty seconds are counted in a fraction of one.")
    _, lab.seconds = imgui.slider_float("##seconds", lab.seconds, 1, 3600, "%.0f", _LOGARITHMIC)
    imgui.begin_disabled(lab.busy is not None or rain.intensity_mm_h == 0)
    if imgui.button("Measure"):
        lab.measure(rain)
    imgui.end_disabled()
    imgui.set_item_tooltip("Count the drops of the very field that is drawn as they fall through the square.")
    if lab.busy is not None:
        imgui.same_line()
        imgui.text_disabled(lab.busy)
    if rain.intensity_mm_h == 0:
        imgui.text_wrapped("0 mm/h: nothing to count.")
    if lab.problem is not None:
        imgui.push_style_color(imgui.Col_.text, WARNING)
        imgui.text_wrapped(lab.problem)
        imgui.pop_style_color()
    if lab.counted is not None:
        _result(lab.counted)


_LOGARITHMIC = imgui.SliderFlags_.logarithmic | imgui.SliderFlags_.always_clamp


def _result(counted: DisdrometerMeasurement) -> None:
    state = counted.state
    rows = (
        ("Asked for", f"{state.implied_mm_h:.3f} mm/h", "What the drops in the air should carry."),
        (
            "Measured",
            f"{counted.rate_mm_h:.3f} \u00b1 {counted.standard_error_mm_h:.3f} mm/h",
            "With its standard error.",
        ),
        ("Off by", f"{_off(counted):+.1f} standard errors", "Within 3 it agrees."),
        ("Drops counted", f"{counted.drops:,}", f"On {counted.area_m2:g} m\u00b2 in {counted.seconds.sum():g} s."),
        ("Drops per m\u00b3", f"{counted.density_m3:,.0f}", f"Asked for: {state.density_m3:,.0f}."),
        (
            "Mean diameter",
            "none" if counted.mean_diameter_mm is None else f"{counted.mean_diameter_mm:.3f} mm",
            f"In the air. Asked for: {state.mean_diameter_mm:.3f} mm.",
        ),
    )
    readings("counted", rows)
    _spectrum(counted)


def _off(counted: DisdrometerMeasurement) -> float:
    error = counted.standard_error_mm_h
    return (counted.rate_mm_h - counted.state.implied_mm_h) / error if error > 0 else 0.0


def _spectrum(counted: DisdrometerMeasurement) -> None:
    edges = counted.spectra.diameter_edges_mm
    middles = 0.5 * (edges[:-1] + edges[1:])
    in_air, _ = np.histogram(counted.diameters_mm, edges, weights=counted.in_air_m3)
    law = counted.state.density_m3 * counted.state.sizes.probability_per_mm(middles)
    last = int(np.flatnonzero(in_air).max(initial=0)) + 2
    with plot("Drops in the air", "mm", "N(D) per m\u00b3 and mm", legend=True) as seen:
        if seen:
            implot.plot_bars("counted", middles[:last], in_air[:last] / _STEP_MM, 0.9 * _STEP_MM)
            line("asked for", middles[:last], law[:last])
