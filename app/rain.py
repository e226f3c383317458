"""`gsrain calibrate` and `gsrain disdrometer`: rain calibration from measured spectra, and a virtual disdrometer."""

from collections.abc import Sequence
from dataclasses import asdict, is_dataclass
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import msgspec

from gsrain_engine.disdrometer.fit_settings import FitOptions
from gsrain_engine.rain.available import check_available
from gsrain_engine.rain.settings import RainSettings, load_preset

from .console import Console, print, print_lines, progress_bar
from .options import JsonFile, Preset, check_within, flag, option, options_of, takes_set
from .outputs import check_ending, check_writable, write_numbers
from .scene import Columns

if TYPE_CHECKING:
    import numpy as np
    from jaxtyping import Float64

    from gsrain_engine.disdrometer.file_summary import MeasuredFile, MeasurementSummary
    from gsrain_engine.disdrometer.fit_models import FittedCalibration, FittedRow
    from gsrain_engine.disdrometer.measurement import DisdrometerMeasurement
    from gsrain_engine.rain.properties import DropSizes
    from gsrain_engine.report.table import Cell


_COLUMNS = 120  # table width, also if the output is a file

CalibrationOptions = options_of(FitOptions, "calibrate", topic="Method")


@takes_set
def calibrate(
    files: Annotated[list[Path], option("Disdrometer files of one instrument; gzip is fine.")],
    /,
    *,
    output: Annotated[Path, option("Calibration file to write, .yaml.", "--output", "-o")],
    plot: Annotated[Path | None, option("Figure of spectra, fits and closure: .png, .pdf or .svg.")] = None,
    name: Annotated[str | None, option("Name of the calibration; default: that of the file.")] = None,
    fit: CalibrationOptions | None = None,
    columns: Columns = None,
    force: Annotated[
        bool, flag("Fit even if the drops' rain rate is not 0.7 to 1.4 times the instrument's own, or r is below 0.9.")
    ] = False,
    json: JsonFile = None,
) -> None:
    """Fit drop number, sizes and fall speed to measured spectra, by intensity, with 95 % intervals.

    Prints of each file its instrument, records, drops and rain, what is rejected and why, and how well the rate from
    the drops agrees with the instrument's own. Where they disagree over 30 rainy records or more (a ratio outside 0.7
    to 1.4, or r below 0.9: snow, insects, other classes), nothing is fitted without --force. `gsrain info FILE` prints
    the same.
    """
    from gsrain_engine.disdrometer.file_summary import open_disdrometer_files
    from gsrain_engine.disdrometer.fit import RatesDisagreeError, calibrate_files
    from gsrain_engine.disdrometer.fit_plot import check_plot_name, write_plot
    from gsrain_engine.disdrometer.tables import load_columns
    from gsrain_engine.rain.calibration import save_calibration

    options = (fit or CalibrationOptions()).settings()
    if output.suffix not in (".yaml", ".yml"):
        raise ValueError(f"{output}: expected a name that ends with .yaml")
    if plot is not None:
        check_plot_name(plot)
    described = columns and load_columns(columns)
    check_writable(output, plot, json)
    with progress_bar("Reading", len(files)) as advance:
        measured = open_disdrometer_files(files, described, advance)
    found = [each.measured() for each in measured]
    for each in found:
        print_lines("\n".join(each.lines))
    try:
        fitted = calibrate_files(measured, name=name or output.stem, options=options, force=force)
    except RatesDisagreeError as error:
        raise ValueError(f"{error} --force fits all the same") from None
    output.parent.mkdir(parents=True, exist_ok=True)
    save_calibration(fitted.calibration, output)
    if plot is not None:
        plot.parent.mkdir(parents=True, exist_ok=True)
        write_plot(fitted, plot)
    _print(fitted, len(measured))
    write_numbers(json, _numbers(fitted, measured, found))
    for path in (output, plot, json):
        if path is not None:
            print(path)


def _numbers(
    fitted: "FittedCalibration", measured: "list[MeasuredFile]", found: "list[MeasurementSummary]"
) -> dict[str, Any]:
    check, ratios = fitted.rate_check, fitted.axis_ratios
    velocity = fitted.calibration.velocity
    skipped = [f"{each.path.name}: {reason}" for each in measured for reason in each.reading.skipped]
    return {
        "instrument": found[0].instrument,
        "drops": sum(each.drops for each in found),
        "rain_mm": sum(each.rain_mm for each in found),
        "records": fitted.records,
        "records_used": fitted.records_used,
        "records_skipped": skipped,
        "rate_ratio": None if check is None else check.ratio,
        "rate_correlation": None if check is None else check.correlation,
        "rate_records": 0 if check is None else check.records,
        "velocity": {
            "coefficients": list(velocity.coefficients),
            "r2": velocity.r2,
            "confidence": fitted.velocity_confidence,
            "measured": fitted.speeds is not None,
        },
        "fitted_range_mm": list(fitted.fitted_range_mm),
        "rows": [_row_numbers(each) for each in fitted.rows],
        "bins_without_row": list(fitted.passed_over),
        "axis_ratio": None
        if ratios is None
        else {"offset": ratios.offset, "slope_per_mm": ratios.slope_per_mm, "r2": ratios.r2, "drops": ratios.drops},
        "files": [each.numbers() for each in found],
        "quality": [{"file": each.path.name} | _plain(each.quality) for each in measured],
    }


def _row_numbers(each: "FittedRow") -> dict[str, Any]:
    return msgspec.to_builtins(each.row) | {
        "moments": {"shape": each.moments_shape, "scale_mm": each.moments_scale_mm},
        "implied_mm_h": each.implied_mm_h,
        "minutes": each.minutes,
        "records": each.records,
        "drops": each.drops,
    }


def _plain(report: Any) -> dict[str, Any]:
    return asdict(report) if is_dataclass(report) and not isinstance(report, type) else msgspec.to_builtins(report)


def _print(fitted: "FittedCalibration", files: int) -> None:
    from gsrain_engine.report.interval import Interval
    from gsrain_engine.report.table import Table, columns

    console = Console(width=_COLUMNS, highlight=False, markup=False)
    if files > 1 and fitted.rate_check is not None:
        console.print(f"all {files} files: {fitted.rate_check.line}")
    a, b, c = fitted.calibration.velocity.coefficients
    r2 = fitted.calibration.velocity.r2
    quality = "assumed: the instrument measures no speed" if r2 is None else f"R² = {r2:.4f}"
    console.print(f"V = {a:.4g} D² {b:+.4g} D {c:+.4g} m/s, {quality}")
    titled = {
        "mm/h": ".3g", "minutes": ",", "drops": ",", "N per m³": ".3g", "shape": ".3g", "scale mm": ".3g",
        "by moments (mm)": "", "implied mm/h": ".3g",
    }  # fmt: skip
    rows: list[tuple[Cell, ...]] = []
    for each in fitted.rows:
        row = each.row
        values = row.density_m3, row.shape, row.scale_mm
        limits = None if row.confidence is None else msgspec.structs.astuple(row.confidence)
        cells: Sequence[Cell] = values
        if limits is not None:
            cells = [
                Interval(value, *ends, "bootstrap, 95 %", "minutes", each.minutes)
                for value, ends in zip(values, limits, strict=True)
            ]
        moments = f"{each.moments_shape:.3g} x {each.moments_scale_mm:.3g}"
        rows.append((row.intensity_mm_h, each.minutes, each.drops, *cells, moments, each.implied_mm_h))
    print_lines(Table("Fit", columns(titled), rows).text)
    if fitted.passed_over:
        bins = ", ".join(reason.partition(" mm/h")[0] for reason in fitted.passed_over)
        console.print(f"too little rain for a row at {bins} mm/h")


# gsrain disdrometer

_ROWS_MM = 0.1, 0.5, 1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 6.0, 8.0
_MAX_S, _MAX_RECORDS = 86_400.0, 10_000

_RAIN = RainSettings(intensity_mm_h=8.5)  # without options
DisdrometerOptions = options_of(
    RainSettings, "disdrometer", "Default: {}, or the preset's.", {"intensity_mm_h": "8.5"}, topic="Rain"
)


@takes_set
def disdrometer(
    *,
    rain: DisdrometerOptions | None = None,
    preset: Preset = None,
    area: Annotated[float, option("Catching area in m².")] = 0.5,
    seconds: Annotated[float, option("Simulated duration of the measurement in seconds.")] = 60.0,
    record: Annotated[float, option("Seconds per record: one spectrum each.")] = 60.0,
    output: Annotated[Path | None, option("Write the spectra to this netCDF file (.nc).", "--output", "-o")] = None,
    json: JsonFile = None,
) -> None:
    """Count simulated drops through a horizontal area; report rain rate, sizes, and the gamma law, set and fitted.

    `gsrain calibrate` reads what -o writes, so that the simulation can be fitted like a measurement.
    """
    from gsrain_engine.disdrometer.open import require_netcdf
    from gsrain_engine.disdrometer.virtual import VirtualDisdrometer
    from gsrain_engine.rain.simulation import RainSimulation

    times = _times(seconds, record)
    check_ending("--output", output, (".nc",))
    if output is not None:
        require_netcdf("--output")
    check_writable(output, json)
    base = load_preset(preset) if preset is not None else _RAIN
    options = rain or DisdrometerOptions()
    settings = options.settings(base)
    check_available(options.changes(), settings, "disdrometer")
    instrument = VirtualDisdrometer(RainSimulation.start(settings), area)
    with progress_bar("Counting drops", len(times) - 1) as advance:
        counts = []
        for start, end in pairwise(times):
            counts.append(instrument.count(start, end))
            advance()
    counted = instrument.collect(times, counts)
    if output is not None:
        from gsrain_engine.disdrometer.netcdf import write_spectra  # xarray is optional

        output.parent.mkdir(parents=True, exist_ok=True)
        write_spectra(output, counted.spectra)
    write_numbers(json, _disdrometer_numbers(counted))
    _print_disdrometer(counted)
    if output is not None:
        print(f"{output}: {len(counts)} spectra")


def _times(seconds: float, record: float) -> "Float64[np.ndarray, ' records_and_one']":
    """Return the bounds of the records; the last one may be shorter."""
    import numpy as np

    check_within("--seconds", seconds, 0.001, _MAX_S, "s")
    check_within("--record", record, 0.001, _MAX_S, "s")
    whole = round(seconds / record, 6)
    if whole > _MAX_RECORDS:
        raise ValueError(f"--record {record:g}: {seconds:g} s make {whole:.0f} records, at most {_MAX_RECORDS}")
    return np.append(np.arange(max(1, np.ceil(whole))) * record, seconds)


def _disdrometer_numbers(counted: "DisdrometerMeasurement") -> dict[str, Any]:
    state, fitted = counted.state, _fitted_sizes(counted)
    return {
        "requested_mm_h": state.intensity_mm_h,
        "rain_class": state.rain_class,
        "implied_mm_h": state.implied_mm_h,
        "measured_mm_h": counted.rate_mm_h,
        "standard_error_mm_h": counted.standard_error_mm_h,
        "drops_counted": counted.drops,
        "mean_diameter_mm": counted.mean_diameter_mm,
        "requested_mean_diameter_mm": state.mean_diameter_mm,
        "mean_counted_diameter_mm": counted.mean_counted_diameter_mm,
        "density_m3": counted.density_m3,
        "requested_density_m3": state.density_m3,
        "requested_shape": state.shape,
        "requested_scale_mm": state.scale_mm,
        "shape": None if fitted is None else fitted.shape,
        "scale_mm": None if fitted is None else fitted.scale_mm,
        "area_m2": counted.area_m2,
        "seconds": float(counted.seconds.sum()),
        "records": len(counted.counts),
        "record_mm_h": counted.record_rates_mm_h.tolist(),
        "extinction_per_m": state.extinction_per_m,
        "marshall_palmer_extinction_per_m": state.marshall_palmer_extinction_per_m,
        "meteorological_range_m": state.visibility_m if state.extinction_per_m > 0 else None,
        "beyond_calibration": state.beyond_calibration,
        "calibrated_up_to_mm_h": state.calibrated_up_to_mm_h,
        "spectrum": _spectrum(counted, counted.spectra.diameter_edges_mm),
    }


def _fitted_sizes(counted: "DisdrometerMeasurement") -> "DropSizes | None":
    """Return the gamma law of the counted drops; None if they occupy fewer than three classes."""
    import numpy as np

    from gsrain_engine.disdrometer.fit_models import fit_sizes

    edges_mm = counted.spectra.diameter_edges_mm
    in_air, _ = np.histogram(counted.diameters_mm, edges_mm, weights=counted.in_air_m3)
    return fit_sizes(in_air, edges_mm) if np.count_nonzero(in_air) >= 3 else None


def _spectrum(
    counted: "DisdrometerMeasurement", edges_mm: "Float64[np.ndarray, ' n_and_one']"
) -> dict[str, list[float]]:
    import numpy as np

    drops, _ = np.histogram(counted.diameters_mm, edges_mm, weights=counted.counts.sum(axis=0).astype(float))
    in_air, _ = np.histogram(counted.diameters_mm, edges_mm, weights=counted.in_air_m3)
    return {
        "diameter_edges_mm": edges_mm.tolist(),
        "drops": drops.tolist(),
        "drops_per_m3_mm": (in_air / np.diff(edges_mm)).tolist(),
    }


def _print_disdrometer(counted: "DisdrometerMeasurement") -> None:
    import numpy as np

    from gsrain_engine.report.table import Table, columns

    console, state = Console(highlight=False, soft_wrap=True), counted.state
    asked = f"{state.intensity_mm_h:g} mm/h asked"
    if state.rain_class:
        asked += f" ({state.rain_class})"
    if f"{state.implied_mm_h:.3g}" != f"{state.intensity_mm_h:.3g}":
        asked += f", {state.implied_mm_h:.3g} mm/h drawn"
    if state.beyond_calibration:
        asked += ", beyond calibration"
    measured = f"{counted.rate_mm_h:.4g} ± {counted.standard_error_mm_h:.2g} mm/h measured"
    where = f"{counted.area_m2:g} m² in {float(counted.seconds.sum()):g} s"
    console.print(f"{asked}; {measured}: {counted.drops:,} drops on {where}")
    if counted.mean_diameter_mm is None:
        return
    console.print(
        f"in the air {counted.density_m3:,.0f} drops/m³ (asked {state.density_m3:,.0f}), "
        f"mean diameter {counted.mean_diameter_mm:.3f} mm (asked {state.mean_diameter_mm:.3f}), "
        f"extinction {state.extinction_text}"
    )
    law = f"gamma law of diameters: shape {state.shape:.4g}, scale {state.scale_mm:.3g} mm asked"
    fitted = _fitted_sizes(counted)
    if fitted is not None:
        law += f"; {fitted.shape:.4g}, {fitted.scale_mm:.3g} mm fitted to the counted drops"
    console.print(law)
    spectrum = _spectrum(counted, np.array(_ROWS_MM))
    bins = (f"{low:g} - {high:g}" for low, high in pairwise(_ROWS_MM))
    rows = [*zip(bins, spectrum["drops"], spectrum["drops_per_m3_mm"], strict=True)]
    titled = columns({"diameter mm": "", "drops": ",.0f", "N(D) 1/(m³ mm)": ".4g"})
    print_lines(Table("Spectrum", titled, rows).text)
