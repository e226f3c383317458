"""`gsrain calibrate FILES... -o CAL.yaml`: a rain calibration from disdrometer spectra."""

from collections import Counter
from dataclasses import asdict, is_dataclass
from pathlib import Path
from typing import Annotated, Any

import msgspec
from cyclopts import Parameter
from rich.console import Console
from rich.table import Table

from gsrain_engine.rain.calibration import save_calibration
from gsrain_engine.rain.fitting.calibrate_files import MeasuredFile, calibrate_files, open_measured
from gsrain_engine.rain.fitting.fit_options import FitOptions
from gsrain_engine.rain.fitting.plot import check_plot_name, write_plot
from gsrain_engine.rain.fitting.result import FittedCalibration, FittedRow

from .arguments import JsonFile, write_numbers
from .converted_options import converted_options
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
    json: JsonFile = None,
) -> None:
    """Fit drop number, sizes and fall speed to measured spectra, by intensity, with 95 % intervals."""
    options = _options(intensities, half_width=half_width, smallest_mm=smallest_mm, resamples=resamples, seed=seed)
    if output.suffix not in (".yaml", ".yml"):
        raise ValueError(f"{output}: expected a name that ends with .yaml")
    if plot is not None:
        check_plot_name(plot)
    check_writable(output, plot, json)
    measured: list[MeasuredFile] = []
    with progress_bar("Reading", len(files)) as advance:
        for path in files:
            measured.append(open_measured(path))
            advance()
    fitted = calibrate_files(measured, name=name or output.stem, options=options)
    output.parent.mkdir(parents=True, exist_ok=True)
    save_calibration(fitted.calibration, output)
    if plot is not None:
        plot.parent.mkdir(parents=True, exist_ok=True)
        write_plot(fitted, plot)
    _print(fitted, measured)
    write_numbers(json, _numbers(fitted, measured))
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


def _numbers(fitted: FittedCalibration, measured: list[MeasuredFile]) -> dict[str, Any]:
    check, ratios = fitted.rate_check, fitted.axis_ratios
    velocity = fitted.calibration.velocity
    skipped = [f"{each.path.name}: {reason}" for each in measured for reason in each.reading.skipped]
    return {
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


def _print(fitted: FittedCalibration, measured: list[MeasuredFile]) -> None:
    console = Console(width=_COLUMNS, highlight=False)
    for each in measured:
        spectra = each.reading.spectra
        console.print(f"{each.path.name}: {spectra.instrument}, {len(spectra):,} records")
        reasons = Counter(reason.partition(": ")[2] or reason for reason in each.reading.skipped)
        for reason, count in reasons.most_common(5):
            console.print(f"  {count:,} skipped: {reason}", markup=False)
        kept, *masks = each.quality.lines
        console.print(f"  {kept}", markup=False)
        for line, mask in zip(masks, each.quality.masks, strict=True):
            if mask.drops or mask.records or mask.not_applied:
                console.print(f"  {line}", markup=False)
    check = fitted.rate_check
    if check is not None:
        correlation = "" if check.correlation is None else f", r = {check.correlation:.4f}"
        console.print(f"rate from drops over reported: {check.ratio:.3f}{correlation} ({check.records:,} records)")
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
