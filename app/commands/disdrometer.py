"""`gsrain disdrometer`: measures whether the simulated rain carries the water that was asked for."""

from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
import numpy as np
from cyclopts import Parameter
from jaxtyping import Float64, Int64

from gsrain_engine.rain.counted_drops import CountedDrops
from gsrain_engine.rain.disdrometer.netcdf_spectra import write_spectra
from gsrain_engine.rain.presets import load_preset
from gsrain_engine.rain.rain import Rain
from gsrain_engine.rain.rainfall import Rainfall
from gsrain_engine.rain.virtual_disdrometer import VirtualDisdrometer

from ..console import Console, Table, print
from .arguments import JsonFile, write_numbers
from .converted_options import RAIN_OPTIONS, converted_options
from .outputs import check_writable
from .progress import progress_bar

_ROWS_MM = np.array([0.1, 0.5, 1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 6.0, 8.0])
_LONGEST_S = 86_400.0
_RECORDS = 10_000


def disdrometer(
    *,
    rain: Annotated[
        float | None, Parameter(help="Rainfall intensity in mm/h, 0..100; default 8.5, or the preset's.")
    ] = None,
    preset: Annotated[
        str | None, Parameter(help="clear, 1.2, 8.5, 12.0, paper, or a preset file; other options go on top.")
    ] = None,
    calibration: Annotated[
        str | None, Parameter(help="Name of a shipped calibration, or a file that gsrain calibrate wrote.")
    ] = None,
    closure: Annotated[
        Literal["density", "published"] | None,
        Parameter(help="density: as many drops as the intensity needs; published: the paper's table as it is."),
    ] = None,
    seed: Annotated[int | None, Parameter(help="Same seed and time, same drops.")] = None,
    area: Annotated[float, Parameter(help="Catching area in m².")] = 0.5,
    seconds: Annotated[float, Parameter(help="How long to measure, in simulated seconds.")] = 60.0,
    record: Annotated[float, Parameter(help="Seconds a record: one spectrum each.")] = 60.0,
    output: Annotated[
        Path | None, Parameter(name=["--output", "-o"], help="Write the spectra to this netCDF file (.nc).")
    ] = None,
    json: JsonFile = None,
) -> None:
    """Count simulated drops through a horizontal area; report their rain rate and sizes.

    `gsrain calibrate` reads what -o writes, so that the simulation can be fitted like a measurement.
    """
    times = _times(seconds, record)
    if output is not None and output.suffix != ".nc":
        raise ValueError(f"--output {output}: expected a name that ends in .nc")
    check_writable(output, json)
    rainfall = Rainfall.start(_rain(rain, preset, calibration, closure, seed))
    instrument = VirtualDisdrometer(rainfall, area)
    counts: list[Int64[np.ndarray, " classes"]] = []
    with progress_bar("Counting drops", len(times) - 1) as advance:
        for start, end in pairwise(times):
            counts.append(instrument.count(start, end))
            advance()
    counted = instrument.collect(times, counts)
    if output is not None:
        output.parent.mkdir(parents=True, exist_ok=True)
        write_spectra(output, counted.spectra)
    write_numbers(json, _numbers(counted))
    _print(counted)
    if output is not None:
        print(f"{output}: {len(counts)} spectra")


def _rain(
    intensity: float | None, preset: str | None, calibration: str | None, closure: str | None, seed: int | None
) -> Rain:
    chosen = load_preset(preset) if preset is not None else Rain(intensity_mm_h=8.5)
    asked = {"intensity_mm_h": intensity, "calibration": calibration, "closure": closure, "seed": seed}
    values = msgspec.to_builtins(chosen) | {name: value for name, value in asked.items() if value is not None}
    return converted_options(values, Rain, RAIN_OPTIONS)


def _times(seconds: float, record: float) -> Float64[np.ndarray, " records_and_one"]:
    """Bounds of the records; the last one is what is left."""
    for option, value in (("--seconds", seconds), ("--record", record)):
        if not 0.001 <= value <= _LONGEST_S:
            raise ValueError(f"{option} {value:g}: must be within 0.001..{_LONGEST_S:g} s")
    whole = round(seconds / record, 6)
    if whole > _RECORDS:
        raise ValueError(f"--record {record:g}: {seconds:g} s make {whole:.0f} records, at most {_RECORDS}")
    return np.append(np.arange(max(1, np.ceil(whole))) * record, seconds)


def _numbers(counted: CountedDrops) -> dict[str, Any]:
    state, edges = counted.state, counted.spectra.diameter_edges_mm
    return {
        "requested_mm_h": state.intensity_mm_h,
        "implied_mm_h": state.implied_mm_h,
        "measured_mm_h": counted.rate_mm_h,
        "standard_error_mm_h": counted.standard_error_mm_h,
        "drops_counted": counted.drops,
        "mean_diameter_mm": counted.mean_diameter_mm,
        "requested_mean_diameter_mm": state.mean_diameter_mm,
        "mean_counted_diameter_mm": counted.mean_counted_diameter_mm,
        "density_m3": counted.density_m3,
        "requested_density_m3": state.density_m3,
        "area_m2": counted.area_m2,
        "seconds": float(counted.seconds.sum()),
        "records": len(counted.counts),
        "record_mm_h": counted.record_rates_mm_h.tolist(),
        "beyond_calibration": state.beyond_calibration,
        "spectrum": _spectrum(counted, edges),
    }


def _spectrum(counted: CountedDrops, edges_mm: Float64[np.ndarray, " n_and_one"]) -> dict[str, list[float]]:
    """Drops counted, and drops in the air, by diameter."""
    drops, _ = np.histogram(counted.diameters_mm, edges_mm, weights=counted.counts.sum(axis=0).astype(float))
    in_air, _ = np.histogram(counted.diameters_mm, edges_mm, weights=counted.in_air_m3)
    return {
        "diameter_edges_mm": edges_mm.tolist(),
        "drops": drops.tolist(),
        "drops_per_m3_mm": (in_air / np.diff(edges_mm)).tolist(),
    }


def _print(counted: CountedDrops) -> None:
    console, state = Console(highlight=False, soft_wrap=True), counted.state
    asked = f"{state.intensity_mm_h:g} mm/h asked"
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
        f"mean diameter {counted.mean_diameter_mm:.3f} mm (asked {state.mean_diameter_mm:.3f})"
    )
    spectrum = _spectrum(counted, _ROWS_MM)
    table = Table("diameter mm", "drops", "N(D) 1/(m³ mm)", box=None)
    for low, high, drops, density in zip(
        _ROWS_MM[:-1], _ROWS_MM[1:], spectrum["drops"], spectrum["drops_per_m3_mm"], strict=True
    ):
        table.add_row(f"{low:g} - {high:g}", f"{drops:,.0f}", f"{density:.4g}")
    console.print(table)
