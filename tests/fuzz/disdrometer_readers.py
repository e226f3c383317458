"""Rows of the table: what disdrometers and their loggers write."""

import gzip
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import parsivel_text
from gsrain_engine.disdrometer.file_summary import open_disdrometer_file
from gsrain_engine.disdrometer.netcdf import write_spectra
from gsrain_engine.disdrometer.open import read_disdrometer
from gsrain_engine.disdrometer.rain_rates import keyframes_from_spectra
from gsrain_engine.disdrometer.spectra import DisdrometerFileError, DisdrometerReading
from gsrain_engine.disdrometer.tables import TableColumns, load_columns
from parsivel_text import rain, station_line, velocity_major
from tests.disdrometer.test_netcdf import cloudnet, disdrodb, two_dvd_drops, two_dvd_minutes
from tests.disdrometer.test_open import ROWS, thies_line
from tests.disdrometer.test_tables import RD80, rd80_row

from .mutations import Damage, damaged_bytes, damaged_text, damaged_yaml, inside_gzip
from .reader import Reader, one_file, one_text


def _read(path: Path) -> None:
    """Read a file, keep what can be trusted, and make weather of it."""
    reading = open_disdrometer_file(path).reading
    _check(reading)
    try:
        keyframes_from_spectra(reading)
    except ValueError as error:
        assert "no record has a time" in str(error) or "a weather lasts" in str(error), str(error)


def _check(reading: DisdrometerReading) -> None:
    spectra = reading.spectra
    assert len(spectra) > 0 and np.isfinite(spectra.counts).all() and (spectra.counts >= 0).all(), "has odd counts"
    assert np.isfinite(spectra.diameter_edges_mm).all(), "has odd bins"
    assert (spectra.seconds > 0).all() | np.isnan(spectra.seconds).all(), "has odd durations"
    rates = spectra.reported_mm_h
    assert (np.isnan(rates) | ((rates >= 0) & (rates < np.inf))).all(), "has a rate that is none"
    assert (np.diff(spectra.times[~np.isnat(spectra.times)]) >= np.timedelta64(0)).all(), "goes back in time"
    drops = reading.drops
    assert drops is None or np.isfinite(drops.diameters_mm).all()


def _lines(*lines: str, packed: bool = False) -> Callable[[Path], Path]:
    data = "\n".join(lines).encode("latin-1")
    return one_file("log.txt", lambda path: path.write_bytes(gzip.compress(data, mtime=0) if packed else data))


def _described() -> str:
    counts = ",".join(velocity_major(rain()))
    return "\n".join(["when|rate|which", *(f"2024-02-19 00:0{i}:00|0.772|{counts}" for i in (1, 2))])


def _read_described(path: Path) -> None:
    columns = TableColumns(instrument="OTT Parsivel", separator="|", time="when", rate="rate", drops="which")
    _check(open_disdrometer_file(path, columns).reading)


def _read_by_description(path: Path) -> None:
    """Read a description, then the table that the sound one describes."""
    columns = load_columns(path)
    table = path.with_suffix(".csv")
    table.write_text("\n".join(["a counter", "Day;Clock;Rain;a;b;c", "13/05/2024;14.02;0,05;10;20;1"]))
    try:
        _check(read_disdrometer(table, columns))
    except DisdrometerFileError as error:
        assert table.name in str(error)
    finally:
        table.unlink()


COUNTER = """
instrument: Drop counter
time: [Day, Clock]
time_format: "%d/%m/%Y %H.%M"
time_is: start
utc_offset_h: 2
seconds: 60
rate: Rain
rate_unit: mm/min
drops: {first: a, last: c}
quantity: drops
diameter_edges_mm: [0.5, 1, 2, 3]
area_m2: 0.01
separator: ";"
decimal: ","
header_line: 2
comments: ["#"]
"""


def _minutes(values: int) -> list[str]:
    return [f"2014  121    1   {minute}   0  16  26" + "   0" * (values - 3) for minute in (20, 21, 22)]


def _netcdf(made: Callable[[], Any], engine: str, **options: Any) -> Callable[[Path], Path]:
    return one_file("file.nc", lambda path: made().to_netcdf(path, engine=engine, **options))


_IN_TIME = {"unlimited_dims": "time"}


def _own(folder: Path) -> Path:
    log = _lines(station_line(20), station_line(40, rain(), "0000.772"))(folder)
    write_spectra(folder / "file.nc", open_disdrometer_file(log).reading.spectra)
    return folder / "file.nc"


def _row(
    name: str,
    write: Callable[[Path], Path],
    damage: Damage = damaged_text,
    read: Callable[[Path], None] = _read,
    error: type[Exception] = DisdrometerFileError,
) -> Reader:
    return Reader(f"disdrometer-{name}", write, read, error, (("*", damage),))


_DIALECTS = {
    "station": parsivel_text.station,
    "locarno": parsivel_text.locarno,
    "tagged": parsivel_text.tagged,
    "asdo": parsivel_text.asdo,
    "telegrams": parsivel_text.telegrams,
    "campbell": parsivel_text.campbell_columns,
    "campbell-one-column": parsivel_text.campbell_field,
    "pyatmoslogger": parsivel_text.pyatmoslogger,
    "scamp": parsivel_text.scamp,
}
DISDROMETER_READERS = (
    *(_row(name, _lines(*dialect(ROWS))) for name, dialect in _DIALECTS.items()),
    _row("gzip", _lines(*parsivel_text.station(ROWS), packed=True), inside_gzip(damaged_text)),
    _row("rd80", _lines(RD80, *(rd80_row(minute, 40, "1,5") for minute in (14, 15, 16)))),
    _row("described", one_text("table.txt", _described()), read=_read_described),
    _row("columns", one_text("counter.yaml", COUNTER), damaged_yaml, _read_by_description, ValueError),
    _row("netcdf-minutes", _netcdf(two_dvd_minutes, "scipy", **_IN_TIME), damaged_bytes),
    _row("thies", _lines("a header", thies_line(0, rate="001.072"), thies_line(30))),
    _row("two-dvd-table", _lines(*_minutes(50))),
    _row("apu-table", _lines(*_minutes(32))),
    _row("rainsense", _lines("current intensity: 8.5", "")),
    _row("netcdf-classic", _netcdf(cloudnet, "scipy", **_IN_TIME), damaged_bytes),
    _row("netcdf-drops", _netcdf(two_dvd_drops, "scipy", **_IN_TIME), damaged_bytes),
    *(
        Reader(f"disdrometer-{name}", write, _read, DisdrometerFileError, (("*.nc", damaged_bytes),), 4, 60)
        for name, write in (
            ("netcdf-hdf5", _netcdf(cloudnet, "h5netcdf", **_IN_TIME)),
            ("netcdf-own", _own),
            ("netcdf-disdrodb", _netcdf(disdrodb, "h5netcdf")),
        )
    ),  # each file in a process of its own first
)  # fmt: skip
"""Logs and tables, and what looks at them."""
