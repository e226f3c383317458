"""Text files of every instrument, in every dialect, whole and damaged."""

import gzip
import re
from pathlib import Path

import numpy as np
import pytest

import parsivel_text
from gsrain_engine.disdrometer import open, spectra
from gsrain_engine.disdrometer.instruments import PARSIVEL, THIES
from gsrain_engine.disdrometer.open import read_disdrometer
from gsrain_engine.disdrometer.spectra import DisdrometerFileError, DisdrometerReading, UnknownKindError
from parsivel_text import DRY, RAIN_MM_H, SILENT_DIALECTS, STATING_DIALECTS, rain, station_line

ROWS = [
    ("2024-02-19 00:01:00", "0000.772", rain()),
    ("2024-02-19 00:01:30", "0000.000", DRY),
    ("2024-02-19 00:02:00", "0001.544", rain()),
]


def written(folder: Path, *lines: str, end: str = "\n") -> Path:
    path = folder / "disdrometer.txt"
    path.write_bytes(end.join(lines).encode("latin-1"))
    return path


def read(folder: Path, *lines: str, end: str = "\n") -> DisdrometerReading:
    return read_disdrometer(written(folder, *lines, end=end))


@pytest.mark.parametrize("dialect", (*STATING_DIALECTS, *SILENT_DIALECTS))
def test_parsivel_records_come_back_from_every_dialect_whole_and_cut_off(dialect, tmp_path):
    """Recording begins again after three records, and the fourth ends anywhere."""
    last = dialect([("2024-02-19 01:00:00", "NAN", DRY)])
    text = "\n".join([*dialect(ROWS), *last])
    start = text.rindex("01:NAN") if dialect is parsivel_text.telegrams else len(text) - len(last[-1])
    whole = read(tmp_path, *text.split("\n"), "", end="\r\n")
    assert len(whole.spectra) == 4 and whole.skipped == () and np.isnan(whole.spectra.reported_mm_h[-1])
    for cut in np.linspace(start + 10, len(text) - 40, 4).astype(int):
        reading = read(tmp_path, *text[:cut].split("\n"))
        assert len(reading.skipped) == 1
        found, seconds = reading.spectra, 60 if dialect in STATING_DIALECTS else 30
        assert (found.instrument, reading.drops) == ("OTT Parsivel", None)
        np.testing.assert_array_equal(found.counts, [rain(), DRY, rain()])
        np.testing.assert_array_equal(found.seconds, np.full(3, seconds))
        np.testing.assert_array_equal(found.reported_mm_h, [0.772, 0, 1.544])
        np.testing.assert_array_equal(found.times, np.array([time for time, _, _ in ROWS], "M8[ms]"))
        np.testing.assert_allclose(found.rate_mm_h, np.array([RAIN_MM_H, 0, RAIN_MM_H]) * 60 / seconds, rtol=1e-4)


@pytest.mark.parametrize(
    ("header", "rows", "time", "rate"),
    [
        ("Datum;Zeit;Intensit\u00e4t (mm/h);Spektrum", "15.11.2019;00:51:00;0,772;", "2019-11-15T00:51", 0.772),
        ("", "15.11.2019;00:51:00;0,772;", "2019-11-15T00:51", 0.772),
        ("", "3/4/2024\t12:00:00\t0.5\t|4/4/2024\t12:00:00\t0.5\t", "2024-04-03T12:00", 0.5),
        ("", "3/4/2024\t12:00:00\t0.5\t|3/13/2024\t12:00:00\t0.5\t", "2024-03-04T12:00", 0.5),  # a day shows the order
    ],
)  # fmt: skip
def test_asdo_files_of_other_countries(header, rows, time, rate, tmp_path):
    found = read(tmp_path, header, *(f"{row}<SPECTRUM>ZERO</SPECTRUM>" for row in rows.split("|"))).spectra
    assert (found.times[0], found.reported_mm_h[0]) == (np.datetime64(time, "ms"), rate)


def test_bad_records_are_left_out_and_named(tmp_path):
    good = station_line(20, rain(), "0000.772")
    damage = {
        station_line(0)[2000:]: "begin with a time",
        station_line(21, rate="U0000.000"): "rain rate 'U0000.000'",
        good.replace(";030;", ";nan;"): "drop count 486 is nan",
        good.replace(";030;", ";-30;"): "drop count 486 is -30",
        good.replace(";030;", ";3O;"): "drop count 486 is '3O'",
        good[:-40]: "1014 drop counts instead of 1024",
        station_line(22, rate="inf"): "rain rate is inf",
        station_line(23).replace(";00060;", ";9999;"): "sample interval is 9999",
        station_line(99): "time '20190410230799'",
    }
    reading = read(tmp_path, good, *damage, "", station_line(24), station_line(24), station_line(19))
    np.testing.assert_array_equal(reading.spectra.counts, [DRY, rain(), DRY])  # in order of time
    reasons = [*damage.values(), "the record of 2019-04-10T23:07:24.000"]  # that one is there twice
    lines = [*range(2, 11), 13]
    for sentence, line, reason in zip(reading.skipped, lines, reasons, strict=True):
        assert sentence.startswith(f"line {line}: ") and reason in sentence


def thies_line(second: int, *, rate: str = "000.000", counts: str = "", extra: str = "") -> str:
    head = f"00;1025;2.52;15.09.21;07:00:{second:02d};00;00;NP   ;000.000;00;00;NP   ;{rate}".split(";")
    return ";".join([*head, *["0"] * (79 - len(head)), *(counts or "000;" * 439 + "000").split(";"), *extra.split(";")])


def test_thies_telegrams_bare_logged_and_short(tmp_path):
    counts = np.zeros((22, 20), int)
    counts[6, 11] = 60  # 1.25 to 1.5 mm at 4.2 to 5 m/s
    text = ";".join(f"{count:03d}" for count in counts.ravel())
    bare = thies_line(0, rate="001.072", counts=text, extra="8A")
    logged = '"2024-04-14 00:01:00",552609,"' + thies_line(30, counts=text, extra='+00.2;99999;8A"')
    reading = read(tmp_path, "a header", bare, logged, "\x02" + thies_line(20)[:400])
    np.testing.assert_array_equal(reading.spectra.counts, [counts, counts])
    times = np.array(["2021-09-15T07:00:00", "2024-04-14T00:01:00"], "M8[ms]")
    np.testing.assert_array_equal(reading.spectra.times, times)
    np.testing.assert_allclose(reading.spectra.rate_mm_h, np.pi / 6 * 1.375**3 * 60 / 4560 * 60)
    np.testing.assert_array_equal(reading.spectra.reported_mm_h, [1.072, 0])
    assert [each.partition(": ")[0] for each in reading.skipped] == ["line 4"]

    short = [";".join(thies_line(i, rate="1.5").split(";")[:22]) for i in (0, 59)]
    reading = read(tmp_path, *short, ";".join(short[0].split(";")[:10]))
    assert reading.spectra.counts.shape == (2, 0, 1) and len(reading.skipped) == 1
    np.testing.assert_array_equal(reading.spectra.reported_mm_h, [1.5, 1.5])


def test_classes_of_parsivel_and_thies():
    """Bounds of the makers' tables, and the areas of Battaglia et al. (2010) and of the maker."""
    edges, speeds = PARSIVEL.diameter_edges_mm, PARSIVEL.velocity_edges_m_s
    np.testing.assert_allclose(edges[[0, 10, 15, 20, 25, 30, 32]], [0, 1.25, 2.5, 5, 10, 20, 26])
    np.testing.assert_allclose(speeds[[0, 10, 15, 20, 25, 30, 32]], [0, 1, 2, 4, 8, 16, 22.4])
    np.testing.assert_allclose(PARSIVEL.area_m2, 1e-6 * 180 * (30 - (edges[:-1] + edges[1:]) / 4))
    np.testing.assert_allclose(THIES.diameter_edges_mm[[0, 3, 9, 22]], [0.125, 0.5, 2, 8.5])
    np.testing.assert_allclose(THIES.velocity_edges_m_s[[0, 5, 11, 18, 20]], [0, 1, 3.4, 9, 20])
    np.testing.assert_allclose(THIES.area_m2, 0.00456)


def test_a_transposed_log_is_read_and_reported(tmp_path, caplog):
    found = read(tmp_path, station_line(20, numbers=[f"{count:03d}" for count in rain().ravel()])).spectra
    np.testing.assert_array_equal(found.counts[0], rain())
    assert "diameters first" in caplog.text
    caplog.clear()
    read(tmp_path, station_line(20, rain()))
    assert caplog.text == ""


@pytest.mark.parametrize("reported", [RAIN_MM_H, 0.0, np.nan])
@pytest.mark.parametrize("written", ["velocities first", "diameters first"])
def test_the_order_of_the_numbers_is_found(reported, written):
    def arranged(counts, rate, records=1):
        numbers = np.tile(counts.ravel().astype(float), (records, 1))
        return PARSIVEL.arranged(numbers, written, np.full(records, 60.0), np.full(records, rate))

    slow = np.zeros_like(DRY)
    slow[12, 8] = 400  # 1.6 mm at 0.85 m/s: in the other order these drops are smaller, and less rain than reported
    slow_mm_h = 60 * 400 * np.pi / 6 * PARSIVEL.diameter_edges_mm[12:14].mean() ** 3 / (1e6 * PARSIVEL.area_m2[12])
    for turn, order in (((0, 1), "diameters first"), ((1, 0), "velocities first")):
        found = arranged(rain().transpose(turn), reported)
        np.testing.assert_array_equal(found[0][0], rain())
        assert found[1] == order
        assert arranged(slow.transpose(turn), float(slow_mm_h))[1] == order
        few = (rain() // 6).transpose(turn)
        assert 0 < few.sum() < 50 and arranged(few, 0.0)[1] == written == arranged(DRY, 0.0)[1]
        for factor in (0.25, 4.0, 30.0):  # a rate that fits neither order proves nothing: the drops' speeds decide
            assert arranged(rain().transpose(turn), factor * RAIN_MM_H, 5)[1] == order


ATLAS_07, ATLAS_12 = (9.65 - 10.3 * np.exp(-0.6 * each) for each in (0.7, 1.1875))


@pytest.mark.parametrize(
    ("row", "instrument", "place", "drops"),
    [
        (" 2013  115    1   26" + "   0" * 9 + " 100" + "   0" * 22, "APU (OTT Parsivel)", 9, 100),
        # 100 drops per m^3 and mm in 1.125..1.25 mm: 12.5 in each m^3, which fall through the area for a minute.
        (" 2011  140    1   28" + " 0.0000" * 9 + " 100.0000" + " 0.0000" * 22, "APU (OTT Parsivel)", 9,
         12.5 * ATLAS_12 * 60 * 180e-6 * (30 - 1.1875 / 2)),
        ("2014  121    1   21   0  16" + "   0" * 48, "2DVD", 1, 16),
        (" 2013   98    6    2" + " 0.0000" * 3 + " 100.0000" + " 0.0000" * 46, "2DVD", 3, 20 * ATLAS_07 * 60 * 0.01),
    ],
)  # fmt: skip
def test_nasas_tables_are_counts_or_densities_by_their_decimals(row, instrument, place, drops, tmp_path):
    bad = re.sub(r"^(\s*\d+\s+\d+\s+\d+\s+)\d+", r"\g<1>61", row)
    reading = read(tmp_path, row, bad)
    found = reading.spectra
    assert found.instrument == instrument and found.velocity_edges_m_s is None
    np.testing.assert_allclose(found.counts[0, place, 0], drops)
    assert np.count_nonzero(found.counts) == 1
    assert [each.partition(":")[0] for each in reading.skipped] == ["line 2"]
    if row.startswith("2014"):
        assert found.times[0] == np.datetime64("2014-05-01T01:22")


def test_rainsense_intensity(tmp_path):
    found = read(tmp_path, "current intensity:9.245").spectra
    np.testing.assert_array_equal(found.reported_mm_h, [9.245])
    assert np.isnat(found.times[0]) and np.isnan(found.rate_mm_h[0]) and found.counts.size == 0


MASK = "\n".join(",".join("01"[(row, column) == (20, 8)] for column in range(32)) + "," for row in range(32))
ASDO = "Date;Time;{};Spectrum\n15.11.2019;00:51:00;1;<SPECTRUM>ZERO</SPECTRUM>"


@pytest.mark.parametrize(
    ("data", "kind", "where"),
    [
        (None, DisdrometerFileError, "No such file"),
        (b"", DisdrometerFileError, "empty"),
        (b"\x1f\x8b", DisdrometerFileError, "empty"),
        (b"\x1f\x8b" + b"\xff" * 40, DisdrometerFileError, "gzip"),
        (b"name,value\n1,2\n", UnknownKindError, "line 1.*--columns"),
        (bytes(range(256)) * 20, UnknownKindError, "NetCDF"),
        (b"\x89PNG\r\n\x1a\n" + bytes(99), UnknownKindError, "it is a picture"),
        (b"current intensity:", DisdrometerFileError, "line 1"),
        (b"current intensity:-3", DisdrometerFileError, "line 1"),
        (f"{station_line(20, rate='x')}\n{station_line(21, rate='y')}".encode(), DisdrometerFileError, "line 1.*and 1"),
        (station_line(20, rate="x").encode(), DisdrometerFileError, "line 1: .*not a number$"),
        (MASK.encode(), DisdrometerFileError, "mask"),
        (ASDO.format("MOR Visibility (m)").encode(), DisdrometerFileError, "intensity"),
        (f"{ASDO}\n{ASDO}".format("Intensity", "Energy;Intensity").encode(), DisdrometerFileError, "line 3"),
        (b"15.11.2019;00:51:00;1;<SPECTRUM>1;2;", DisdrometerFileError, "line 1.*spectrum"),
        (b"15.11.2019;00:51:00;<SPECTRUM>ZERO</SPECTRUM>", DisdrometerFileError, "line 1.*2 fields"),
    ],
)  # fmt: skip
def test_other_and_damaged_files_are_refused(data, kind, where, tmp_path):
    path = tmp_path / "file"
    if data is not None:
        path.write_bytes(data)
    with pytest.raises(kind, match=f"^{re.escape(str(path))}: .*{where}"):
        read_disdrometer(path)


def test_gzip_is_opened_and_its_cut_off_end_is_named(tmp_path):
    rng = np.random.default_rng(1)
    noisy = [rng.integers(0, 2, (32, 32)) for _ in range(20)]
    text = "\n".join(station_line(second, counts) for second, counts in enumerate(noisy)).encode()
    path = tmp_path / "log.gz"
    path.write_bytes(gzip.compress(text[:50_000]) + gzip.compress(text[50_000:]))
    assert len(read_disdrometer(path).spectra) == 20
    whole = bytearray(gzip.compress(text))
    path.write_bytes(whole[: len(whole) // 2])
    reading = read_disdrometer(path)
    assert 5 < len(reading.spectra) < 15 and "gzip" in reading.skipped[-1]
    np.testing.assert_array_equal(reading.spectra.counts[3], noisy[3])
    whole[-8] ^= 1  # the checksum
    path.write_bytes(whole)
    with pytest.raises(DisdrometerFileError, match="gzip"):
        read_disdrometer(path)


def test_sizes_are_bounded(tmp_path, monkeypatch):
    monkeypatch.setattr(spectra, "MAX_COUNTS", 2 * 1024)
    with pytest.raises(DisdrometerFileError, match="line 3: more than 2 spectra"):
        read(tmp_path, *(station_line(second) for second in range(3)))
    monkeypatch.setattr(open, "LARGEST_FILE", 2**20)
    for data in (gzip.compress(bytes(2**20 + 1)), bytes(2**20 + 1)):
        (tmp_path / "bomb.gz").write_bytes(data)
        with pytest.raises(DisdrometerFileError, match="more than 1 MiB"):
            read_disdrometer(tmp_path / "bomb.gz")
    monkeypatch.setattr(open, "MAX_LINES", 2)
    with pytest.raises(DisdrometerFileError, match="more than 2 lines"):
        read(tmp_path, "a", "b", "c", "d")
