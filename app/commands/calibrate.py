"""`gsrain calibrate FILES... -o CAL.yaml`: a rain calibration from disdrometer spectra."""

from dataclasses import asdict, is_dataclass
from pathlib import Path
from typing import Annotated, Any

import msgspec
from cyclopts import Parameter

from gsrain_engine.rain.calibration import save_calibration
from gsrain_engine.rain.fitting.calibrate_files import RatesDisagreeError, calibrate_files
from gsrain_engine.rain.fitting.fit_options import FitOptions
from gsrain_engine.rain.fitting.measured_file import Measured, MeasuredFile, open_measured
from gsrain_engine.rain.fitting.plot import check_plot_name, write_plot
from gsrain_engine.rain.fitting.result import FittedCalibration, FittedRow

from ..console import Console, Table, print, print_lines
from .arguments import JsonFile, write_numbers
from .converted_options import converted_options
from .disdrometer_info import Columns, columns_of
from .outputs import check_writable
from .progress import progress_bar

_DEFAULTS = FitOptions()
_COLUMNS = 120  # of the table, also where output goes into a file


def calibrate(
    files: Annotated[list[Path], Parameter(help="Disdrometer files of one instrument; gzip is fine.")],
    /,
    *,
    output: Annotated[Path, Parameter(name=["--output", "-o"], help="Calibration file to write, .yaml.")],
    plot: Annotated[Path | None, Parameter(help="Figure of spectra, fits and closure: .png, .pdf or .svg.")] = None,
    name: Annotated[str | None, Parameter(help="Name of the calibration; default: that of the file.")] = None,
    intensities: Annotated[
        str | None, Parameter(help="Middles of the intensity bins in mm/h, with commas between; default: 0.3 to 90.")
    ] = None,
    half_width: Annotated[
        float, Parameter(help="Minutes within this share of a bin's middle belong to it.")
    ] = _DEFAULTS.half_width,
    smallest_mm: Annotated[
        float, Parameter(help="Leave out diameter classes that begin below, where an instrument misses drops.")
    ] = _DEFAULTS.smallest_mm,
    resamples: Annotated[
        int, Parameter(help="Bootstrap draws behind the 95 % intervals; 0: none.")
    ] = _DEFAULTS.resamples,
    seed: Annotated[int, Parameter(help="Of the bootstrap.")] = _DEFAULTS.seed,
    columns: Columns = None,
    force: Annotated[
        bool,
        Parameter(
            negative="",
            help="Fit even where the drops' rain rate is not 0.7 to 1.4 times the instrument's own, or r is below 0.9.",
        ),
    ] = False,
    json: JsonFile = None,
) -> None:
    """Fit drop number, sizes and fall speed to measured spectra, by intensity, with 95 % intervals.

    Prints of each file its instrument, records, drops and rain, what is rejected and why, and how well the rate from
    the drops agrees with the instrument's own. Where they disagree over 30 rainy records or more (a ratio outside 0.7
    to 1.4, or r below 0.9: snow, insects, other classes), nothing is fitted without --force. `gsrain info FILE` prints
    the same.
    """
    options = _options(intensities, half_width=half_width, smallest_mm=smallest_mm, resamples=resamples, seed=seed)
    if output.suffix not in (".yaml", ".yml"):
        raise ValueError(f"{output}: expected a name that ends with .yaml")
    if plot is not None:
        check_plot_name(plot)
    described = columns_of(columns)
    check_writable(output, plot, json)
    measured: list[MeasuredFile] = []
    with progress_bar("Reading", len(files)) as advance:
        for path in files:
            measured.append(open_measured(path, described))
            advance()
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


def _options(intensities: str | None, **others: float) -> FitOptions:
    """Check the options; errors name them as they are typed."""
    values: dict[str, Any] = dict(others)
    if intensities is not None:
        try:
            values["intensities_mm_h"] = [float(each) for each in intensities.split(",")]
        except ValueError:
            raise ValueError(f"--intensities {intensities}: expected numbers in mm/h such as 1.2,8.5,12") from None
    return converted_options(values, FitOptions, {"intensities_mm_h": "intensities"})


def _numbers(fitted: FittedCalibration, measured: list[MeasuredFile], found: list[Measured]) -> dict[str, Any]:
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


def _row_numbers(each: FittedRow) -> dict[str, Any]:
    return msgspec.to_builtins(each.row) | {
        "moments": {"shape": each.moments_shape, "scale_mm": each.moments_scale_mm},
        "implied_mm_h": each.implied_mm_h,
        "minutes": each.minutes,
        "records": each.records,
        "drops": each.drops,
    }


def _plain(report: Any) -> dict[str, Any]:
    return asdict(report) if is_dataclass(report) and not isinstance(report, type) else msgspec.to_builtins(report)


def _print(fitted: FittedCalibration, files: int) -> None:
    console = Console(width=_COLUMNS, highlight=False, markup=False)
    if files > 1 and fitted.rate_check is not None:
        console.print(f"all {files} files: {fitted.rate_check.line}")
    a, b, c = fitted.calibration.velocity.coefficients
    r2 = fitted.calibration.velocity.r2
    quality = "assumed: the instrument measures no speed" if r2 is None else f"R² = {r2:.4f}"
    console.print(f"V = {a:.4g} D² {b:+.4g} D {c:+.4g} m/s, {quality}")
    table = Table(
        "mm/h", "minutes", "drops", "N per m³", "shape", "scale mm", "by moments (mm)", "implied mm/h", box=None
    )
    for each in fitted.rows:
        row = each.row
        limits = (None,) * 3 if row.confidence is None else tuple(msgspec.structs.astuple(row.confidence))
        values = (row.density_m3, row.shape, row.scale_mm)
        table.add_row(
            f"{row.intensity_mm_h:.3g}",
            f"{each.minutes:,}",
            f"{each.drops:,}",
            *(_with_limits(*pair) for pair in zip(values, limits, strict=True)),
            f"{each.moments_shape:.3g} x {each.moments_scale_mm:.3g}",
            f"{each.implied_mm_h:.3g}",
        )
    console.print(table)
    if fitted.passed_over:
        bins = ", ".join(reason.partition(" mm/h")[0] for reason in fitted.passed_over)
        console.print(f"too little rain for a row at {bins} mm/h")


def _with_limits(value: float, limits: tuple[float, float] | None) -> str:
    return f"{value:.3g}" if limits is None else f"{value:.3g} ({limits[0]:.3g}..{limits[1]:.3g})"
