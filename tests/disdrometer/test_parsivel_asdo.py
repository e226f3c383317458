from pathlib import Path

import numpy as np
import pytest

from gsrain_engine.disdrometer.open import read_disdrometer
from gsrain_engine.disdrometer.spectra import DisdrometerFileError
from parsivel_text import DRY, RAIN_MM_H, rain


def spectrum(counts: np.ndarray, separator: str) -> str:
    return "<SPECTRUM>" + "".join(f"{count or ''}{separator}" for count in counts.T.ravel()) + "</SPECTRUM>"


def written(folder: Path, *lines: str) -> Path:
    path = folder / "asdo.csv"
    path.write_bytes("\r\n".join(lines).encode("latin-1"))
    return path


def test_columns_are_found_by_their_names(tmp_path: Path):
    header = "Date,Time,Snow intensity (mm/h),Weather code SYNOP WaWa,Intensity of precipitation (mm/h),Spectrum"
    reading = read_disdrometer(
        written(
            tmp_path,
            header,
            "15.11.2019,00:50:00,9.000,0,0.000,<SPECTRUM>ZERO</SPECTRUM>",
            header,  # one stands wherever recording began again
            f"15.11.2019,00:51:00,9.000,61,0.772,{spectrum(rain(), ',')}",
        )
    )
    assert reading.skipped == ()
    np.testing.assert_array_equal(reading.spectra.counts, [DRY, rain()])
    np.testing.assert_array_equal(reading.spectra.reported_mm_h, [0, 0.772])
    np.testing.assert_allclose(reading.spectra.rate_mm_h, [0, RAIN_MM_H], rtol=1e-4)
    np.testing.assert_array_equal(reading.spectra.times, np.array(["2019-11-15T00:50", "2019-11-15T00:51"], "M8[ms]"))


@pytest.mark.parametrize("header", ["Datum;Zeit;Niederschlagsintensit\u00e4t (mm/h);Spektrum", ""])
def test_decimal_commas_and_files_without_a_header(tmp_path: Path, header: str):
    path = written(tmp_path, header, f"15.11.2019;00:51:00;0,772;{spectrum(rain(), ';')}")
    np.testing.assert_array_equal(read_disdrometer(path).spectra.reported_mm_h, [0.772])


@pytest.mark.parametrize(("dates", "read"), [(("3/4", "4/4"), "2024-04-03"), (("3/4", "3/13"), "2024-03-04")])
def test_month_first_only_where_a_day_shows_it(tmp_path: Path, dates: tuple[str, str], read: str):
    path = written(tmp_path, *(f"{date}/2024\t12:00:00\t0.000\t<SPECTRUM>ZERO</SPECTRUM>" for date in dates))
    assert read_disdrometer(path).spectra.times[0] == np.datetime64(f"{read}T12:00", "ms")


@pytest.mark.parametrize(
    ("lines", "words"),
    [
        (("Date;Time;MOR Visibility (m);Spectrum", "15.11.2019;00:51:00;9;<SPECTRUM>ZERO</SPECTRUM>"), "no intensity"),
        (
            (
                "Date;Time;Intensity of precipitation (mm/h);Spectrum",
                "15.11.2019;00:51:00;1;<SPECTRUM>ZERO</SPECTRUM>",
                "Date;Time;Kinetic Energy;Intensity of precipitation (mm/h);Spectrum",
            ),
            "line 3: its columns are not those before it",
        ),
        (("15.11.2019;00:51:00;1;<SPECTRUM>1;2;",), "the spectrum is not whole"),
        (("15.11.2019;00:51:00;<SPECTRUM>ZERO</SPECTRUM>",), "2 fields before the spectrum instead of 3"),
    ],
)
def test_what_is_wrong_is_named(tmp_path: Path, lines: tuple[str, ...], words: str):
    with pytest.raises(DisdrometerFileError, match=words):
        read_disdrometer(written(tmp_path, *lines))
