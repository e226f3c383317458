"""The Read-out panel: what follows from the intensity."""

from functools import lru_cache

from imgui_bundle import imgui

from gsrain_engine.rain.calibration import Calibration
from gsrain_engine.rain.rain import Rain
from gsrain_engine.rain.rain_state import intensity_of
from gsrain_engine.session.session import Session

from ..widgets.readings import readings
from .rain_panel import WARNING


def rain_readout_panel(session: Session) -> None:
    state = session.shown_rainfall.state_at(session.clock.time_s)
    if state.intensity_mm_h == 0:
        imgui.text_wrapped("0 mm/h now: no rain at all." if session.weather.keys else "0 mm/h: no rain at all.")
        return
    drawn = int(session.statistics.get("drops drawn", 0))
    haze = int(session.statistics.get("haze Gaussians", 0))
    rows = (
        ("Asked for", f"{state.intensity_mm_h:.2f} mm/h", "Rainfall intensity R."),
        ("Drawn drops carry", f"{state.implied_mm_h:.2f} mm/h", "6e-4 pi N E[V D^3] of the drops as drawn."),
        ("Table would carry", f"{state.table_implied_mm_h:.2f} mm/h", "The same for the calibration's own density."),
        (
            "Drops per m\u00b3",
            f"{state.density_m3:,.0f}",
            f"Number density N; the table says {state.table_density_m3:,.0f}.",
        ),
        (
            "Table has as many at",
            _by_number(state.density_m3, session.shown_rainfall.calibration),
            "Intensity at which the calibration's own table has as many drops as are drawn.",
        ),
        ("Gamma shape", f"{state.shape:.3f}", "mu of the gamma law of diameters."),
        ("Gamma scale", f"{state.scale_mm:.4f} mm", "theta of the gamma law of diameters."),
        ("Mean diameter", f"{state.mean_diameter_mm:.3f} mm", "Of all drops in the air."),
        ("Mean fall speed", f"{state.mean_fall_speed_m_s:.2f} m/s", "Of all drops in the air."),
        ("Drops in region", f"{state.drops:,}", "Density times the streak region's volume."),
        ("Drops drawn", f"{drawn:,}", "Seen by this camera, nearer than phi f D."),
        ("Haze Gaussians", f"{haze:,}", f"Around the view; {state.haze_gaussians:,} at full opacity in the region."),
        ("Extinction", f"{1000 * state.extinction_per_m:.3f} /km", "beta = (pi/4) Q N E[D^2], times the haze gain."),
        ("Visibility", f"{state.visibility_m / 1000:.2f} km", "Where 5 % of a beam is left."),
    )
    readings("readout", rows)
    if state.beyond_calibration:
        imgui.text_colored(WARNING, "beyond calibration (13 mm/h)")
    if session.rain.exaggeration:
        imgui.text_colored(WARNING, session.rain.exaggeration)


@lru_cache(maxsize=4)
def _by_number(density_m3: float, calibration: Calibration) -> str:
    try:
        return f"{intensity_of(density_m3, Rain(closure='published'), calibration):.2f} mm/h"
    except ValueError:
        return "over 100 mm/h"
