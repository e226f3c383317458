"""The Disdrometer panel, a virtual one: whether the simulated rain carries the water that was asked for."""

import numpy as np
from imgui_bundle import imgui, implot

from gsrain_engine.rain.counted_drops import CountedDrops
from gsrain_engine.session.session import Session

from ..widgets.fields import plain_label
from ..widgets.plots import line, plot
from ..widgets.readings import readings
from .rain_panel import WARNING

_STEP_MM = 0.1


def disdrometer_panel(session: Session) -> None:
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


def _result(counted: CountedDrops) -> None:
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


def _off(counted: CountedDrops) -> float:
    error = counted.standard_error_mm_h
    return (counted.rate_mm_h - counted.state.implied_mm_h) / error if error > 0 else 0.0


def _spectrum(counted: CountedDrops) -> None:
    edges = counted.spectra.diameter_edges_mm
    middles = 0.5 * (edges[:-1] + edges[1:])
    in_air, _ = np.histogram(counted.diameters_mm, edges, weights=counted.in_air_m3)
    law = counted.state.density_m3 * counted.state.sizes.probability_per_mm(middles)
    last = int(np.flatnonzero(in_air).max(initial=0)) + 2
    with plot("Drops in the air", "mm", "N(D) per m\u00b3 and mm", legend=True) as seen:
        if seen:
            implot.plot_bars("counted", middles[:last], in_air[:last] / _STEP_MM, 0.9 * _STEP_MM)
            line("asked for", middles[:last], law[:last])
