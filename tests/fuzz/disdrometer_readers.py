"""Rows of the table: what disdrometers and their loggers write."""

import gzip
from collections.abc import Callable
from pathlib import Path

import numpy as np

from gsrain_engine.disdrometer.file_summary import open_disdrometer_file
from gsrain_engine.disdrometer.netcdf import write_spectra
from gsrain_engine.disdrometer.open import read_disdrometer
from gsrain_engine.disdrometer.rain_rates import keyframes_from_spectra
from gsrain_engine.disdrometer.spectra import DisdrometerFileError, DisdrometerReading
from gsrain_engine.disdrometer.tables import TableColumns, load_columns
from parsivel_text import DRY, locarno_line, rain, station_line, velocity_major
from tests.disdrometer.test_files import telegram, thies_line
from tests.disdrometer.test_netcdf_files import (
    disdrodb_dataset,
    drops_dataset,
    spectra_dataset,
    two_dvd_minutes,
)
from tests.disdrometer.test_tables import RD80, ROWS, pyatmoslogger, rd80_row, scamp
from tests.disdrometer.test_tables import campbell as table_of_campbell

from .containers import Damage, inside_gzip
from .mutations import damaged_bytes, damaged_text
from .reader import Reader
from .yaml_mutations import damaged_yaml


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
    assert (
        np.isfinite(spectra.diameter_edges_mm).all() and (spectra.seconds > 0).all() | np.isnan(spectra.seconds).all()
    )
    rates = spectra.reported_mm_h
    assert (np.isnan(rates) | ((rates >= 0) & (rates < np.inf))).all(), "has a rate that is none"
    assert (np.diff(spectra.times[~np.isnat(spectra.times)]) >= np.timedelta64(0)).all(), "goes back in time"
    drops = reading.drops
    assert drops is None or np.isfinite(drops.diameters_mm).all()


def _lines(*lines: str, packed: bool = False) -> Callable[[Path], Path]:
    def write(folder: Path) -> Path:
        data = "\n".join(lines).encode("latin-1")
        (folder / "log.txt").write_bytes(gzip.compress(data, mtime=0) if packed else data)
        return folder / "log.txt"

    return write


def _tagged() -> list[str]:
    before = "2019/11/15;00:5{}:00;{};210.74;-9.999;20000;22067;0;2;0.03;23.4;0.000;0;0;NP;C;0;<SPECTRUM>{}</SPECTRUM>"
    blanks = "".join(f"{count or ''};" for count in rain().T.ravel())
    return ["Date;Time;Intensity;Spectrum", before.format(0, "0.000", "ZERO"), before.format(1, "0.772", blanks)]


def _campbell() -> list[str]:
    columns = ["TIMESTAMP", "RECORD", "rainIntensity", *(f"spectrum({i})" for i in range(1, 1025))]
    header = ",".join(f'"{column}"' for column in columns)
    rows = [f'"2021-02-08 20:0{i}:00",{i},0.7,{",".join(velocity_major(rain()))}' for i in range(2)]
    return ['"TOA5","CR1000"', header, '"TS","RN"', '"","Smp"', *rows]


def _described(folder: Path) -> Path:
    counts = ",".join(velocity_major(rain()))
    (folder / "table.txt").write_text(
        "\n".join(["when|rate|which", *(f"2024-02-19 00:0{i}:00|0.772|{counts}" for i in (1, 2))])
    )
    return folder / "table.txt"


def _described_by(folder: Path) -> Path:
    (folder / "counter.yaml").write_text(COUNTER)
    return folder / "counter.yaml"


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


def _disdrodb(folder: Path) -> Path:
    disdrodb_dataset().to_netcdf(folder / "file.nc", engine="h5netcdf")
    return folder / "file.nc"


def _two_dvd_minutes(folder: Path) -> Path:
    two_dvd_minutes().to_netcdf(folder / "file.nc", engine="scipy", unlimited_dims="time")
    return folder / "file.nc"


def _minutes(values: int) -> list[str]:
    return [f"2014  121    1   {minute}   0  16  26" + "   0" * (values - 3) for minute in (20, 21, 22)]


def _netcdf(engine: str) -> Callable[[Path], Path]:
    def write(folder: Path) -> Path:
        spectra_dataset().to_netcdf(folder / "file.nc", engine=engine, unlimited_dims="time")
        return folder / "file.nc"

    return write


def _drops(folder: Path) -> Path:
    drops_dataset().to_netcdf(folder / "file.nc", engine="scipy", unlimited_dims="time")
    return folder / "file.nc"


def _own(folder: Path) -> Path:
    log = _lines(station_line(20), station_line(40, rain(), "0000.772"))(folder)
    write_spectra(folder / "file.nc", open_disdrometer_file(log).reading.spectra)
    return folder / "file.nc"


def _row(name: str, write: Callable[[Path], Path], damage: Damage = damaged_text, pattern: str = "*.txt") -> Reader:
    return Reader(f"disdrometer-{name}", write, _read, DisdrometerFileError, ((pattern, damage),))


DISDROMETER_READERS = (
    _row("station", _lines(station_line(20), station_line(40, rain(), "0000.772"))),
    _row(
        "gzip", _lines(station_line(20), station_line(40, rain(), "0000.772"), packed=True), inside_gzip(damaged_text)
    ),
    _row("locarno", _lines(*(locarno_line(f"26-10-2018 18:{k}:01", rain(), "0001.5") for k in (43, 44, 45)))),
    _row("tagged", _lines(*_tagged())),
    _row("campbell", _lines(*_campbell())),
    _row("pyatmoslogger", _lines(*pyatmoslogger(ROWS))),
    _row("scamp", _lines(*scamp(ROWS))),
    _row("campbell-one-column", _lines(*table_of_campbell(ROWS))),
    _row("rd80", _lines(RD80, *(rd80_row(minute, 40, "1,5") for minute in (14, 15, 16)))),
    Reader("disdrometer-described", _described, _read_described, DisdrometerFileError, (("*.txt", damaged_text),)),
    Reader("disdrometer-columns", _described_by, _read_by_description, ValueError, (("*.yaml", damaged_yaml),)),
    _row("netcdf-minutes", _two_dvd_minutes, damaged_bytes, "*.nc"),
    _row("telegrams", _lines(*telegram("00:00:00", DRY, "0000.000"), *telegram("00:01:00", rain(), "0000.772"))),
    _row("thies", _lines("a header", thies_line(0, rate="001.072"), thies_line(30))),
    _row("two-dvd-table", _lines(*_minutes(50))),
    _row("apu-table", _lines(*_minutes(32))),
    _row("rainsense", _lines("current intensity: 8.5", "")),
    _row("netcdf-classic", _netcdf("scipy"), damaged_bytes, "*.nc"),
    _row("netcdf-drops", _drops, damaged_bytes, "*.nc"),
    *(
        Reader(
            f"disdrometer-{name}", write, _read, DisdrometerFileError, (("*.nc", damaged_bytes),), tries=4, longest_s=60
        )
        for name, write in (("netcdf-hdf5", _netcdf("h5netcdf")), ("netcdf-own", _own), ("netcdf-disdrodb", _disdrodb))
    ),  # each file in a process of its own first
)
"""Logs and tables, and what looks at them."""
