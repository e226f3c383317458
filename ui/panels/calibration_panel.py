"""The Calibration panel: what the rain is calibrated by, beside another calibration or a fit to measurements."""

from pathlib import Path

import numpy as np
from imgui_bundle import imgui

from gsrain_engine.rain.calibration import Calibration
from gsrain_engine.rain.calibration_curves import CalibrationCurves, calibration_curves, spectrum_at
from gsrain_engine.rain.fitting.calibrate import FittedCalibration
from gsrain_engine.session.rain.calibrations import compare_calibration, use_calibration, use_fitted_calibration
from gsrain_engine.session.rain.rain_lab import RainLab
from gsrain_engine.session.session import Session

from ..widgets.fields import plain_label
from ..widgets.file_dialogs import ask_what_to_open
from ..widgets.names import visible_name
from ..widgets.plots import line, plot, points
from .rain_panel import WARNING

_FAINTEST = 1e-2
_MEASUREMENTS = "Disdrometer files{.*}"
_CALIBRATIONS = "Calibrations{.yaml,.yml},All files{.*}"


def calibration_panel(session: Session) -> None:
    lab = session.lab
    own = session.rainfall.calibration
    _choose(session)
    imgui.text_wrapped(own.source)
    _fit(session)
    shown = {own.name: own}
    if lab.fitted is not None:
        shown.setdefault(lab.fitted.calibration.name, lab.fitted.calibration)
    shown.setdefault(lab.beside.name, lab.beside)
    _plots(session, shown)


def _choose(session: Session) -> None:
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


def _fit(session: Session) -> None:
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


def _fitted(session: Session, lab: RainLab, fitted: FittedCalibration) -> None:
    imgui.separator_text(visible_name(f"Fitted: {fitted.calibration.name}"))
    imgui.text_wrapped(f"{fitted.records_used:,} of {fitted.records:,} records in {len(fitted.rows)} rows")
    if fitted.rate_check is not None and len(lab.measured) > 1:
        imgui.text_wrapped(f"all files: {fitted.rate_check.line}")
    r2 = fitted.calibration.velocity.r2
    imgui.text_wrapped("fall speed assumed: none was measured" if r2 is None else f"fall speed: R2 = {r2:.4f}")
    if imgui.button("Keep and use"):
        use_fitted_calibration(session, lab)
    imgui.set_item_tooltip("Save it among your calibrations, and let the rain follow it.")


def _measured(lab: RainLab) -> None:
    """Draw, for each chosen file, its drops and rain, rejected records with reasons, and how well its rates agree."""
    if lab.measured:
        imgui.separator_text("Measured")
    for each in lab.measured:
        first, *others = each.lines
        imgui.text_wrapped(first)
        imgui.indent()
        for each_line in others:
            imgui.text_wrapped(each_line.strip())
        imgui.unindent()


def _plots(session: Session, shown: dict[str, Calibration]) -> None:
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


def _spectra(session: Session, shown: dict[str, Calibration], curves: dict[str, CalibrationCurves]) -> None:
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


def _speeds(session: Session, curves: dict[str, CalibrationCurves]) -> None:
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
