import gzip
import re
from pathlib import Path

import numpy as np
import pytest

from gsrain_engine.disdrometer import filter, spectra
from gsrain_engine.disdrometer.file_summary import open_disdrometer_file
from gsrain_engine.disdrometer.open import read_disdrometer
from gsrain_engine.disdrometer.spectra import DisdrometerFileError
from parsivel_text import DRY, RAIN_MM_H, locarno_line, rain, station_line, velocity_major


def written(folder: Path, *lines: str) -> Path:
    path = folder / "disdrometer.txt"
    path.write_bytes("\n".join(lines).encode("latin-1"))
    return path


def refusal(path: Path) -> str:
    with pytest.raises(DisdrometerFileError) as caught:
        read_disdrometer(path)
    assert str(caught.value).startswith(f"{path}: ")
    return str(caught.value).removeprefix(f"{path}: ")


def test_station_log(tmp_path: Path):
    reading = read_disdrometer(written(tmp_path, station_line(20), station_line(40, rain(), "0000.772")))
    spectra = reading.spectra
    assert (reading.skipped, reading.drops, spectra.instrument) == ((), None, "OTT Parsivel")
    np.testing.assert_array_equal(spectra.counts[1], rain())
    np.testing.assert_array_equal(spectra.seconds, [60, 60])
    np.testing.assert_array_equal(spectra.times, np.array(["2019-04-10T23:07:20", "2019-04-10T23:07:40"], "M8[ms]"))
    np.testing.assert_allclose(spectra.rate_mm_h, [0, RAIN_MM_H], rtol=1e-4)
    np.testing.assert_array_equal(spectra.reported_mm_h, [0, 0.772])


def test_parsivel_classes_and_area(tmp_path: Path):
    spectra = read_disdrometer(written(tmp_path, station_line(20))).spectra
    assert spectra.velocity_edges_m_s is not None
    np.testing.assert_allclose(spectra.diameter_edges_mm[[0, 10, 15, 20, 25, 30, 32]], [0, 1.25, 2.5, 5, 10, 20, 26])
    np.testing.assert_allclose(spectra.velocity_edges_m_s[[0, 10, 15, 20, 25, 30, 32]], [0, 1, 2, 4, 8, 16, 22.4])
    np.testing.assert_allclose(spectra.area_m2, 1e-6 * 180 * (30 - spectra.diameters_mm / 2))


def test_locarno_log_shows_its_step(tmp_path: Path):
    lines = [locarno_line(f"26-10-2018 18:{minute:02d}:{second:02d}") for minute in (43, 44) for second in (1, 30)]
    # The same drops in half the time: twice the rate.
    lines.append(locarno_line("26-10-2018 18:45:01", rain(), "0001.544"))
    spectra = read_disdrometer(written(tmp_path, *lines)).spectra
    np.testing.assert_array_equal(spectra.seconds, np.full(5, 30.0))
    np.testing.assert_allclose(spectra.rate_mm_h[-1], 2 * RAIN_MM_H, rtol=1e-4)


def test_tagged_log(tmp_path: Path):
    head = "Date;Time;Intensity of precipitation (mm/h);and so on;Spectrum"
    before = "2019/11/15;00:5{}:00;{};210.74;-9.999;20000;22067;0;2;0.03;23.4;0.000;0;0;NP;C;0;<SPECTRUM>{}</SPECTRUM>"
    blanks = "".join(f"{count or ''};" for count in rain().T.ravel())
    path = written(tmp_path, head, before.format(0, "0.000", "ZERO"), before.format(1, "0.772", blanks))
    spectra = read_disdrometer(path).spectra
    np.testing.assert_array_equal(spectra.counts, [DRY, rain()])
    np.testing.assert_array_equal(spectra.seconds, [60, 60])


def test_campbell_log_by_the_names_of_its_columns(tmp_path: Path):
    columns = ["TIMESTAMP", "RECORD", "snowIntensity", "rainIntensity", *(f"spectrum({i})" for i in range(1, 1025))]
    header = ",".join(f'"{column}"' for column in columns)
    rows = [
        f'"2021-02-08 20:0{i}:00",{i},0,{rate},{",".join(velocity_major(counts))}'
        for i, (rate, counts) in enumerate((("0.772", rain()), ('"NAN"', DRY)))
    ]
    spectra = read_disdrometer(written(tmp_path, '"TOA5","CR1000"', header, '"TS","RN"', '"","Smp"', *rows)).spectra
    np.testing.assert_array_equal(spectra.counts, [rain(), DRY])
    np.testing.assert_array_equal(spectra.reported_mm_h, [0.772, np.nan])


def telegram(time: str, counts: np.ndarray, rate: str) -> list[str]:
    fields = {"01": rate, "02": "0134.86", "09": "00060", "11": "00000", "20": time, "21": "09.09.2011", "22": ""}
    fields["93"] = ";".join(velocity_major(counts)) + ";"
    return [*(f"{number}:{value}" for number, value in fields.items()), ""]


def test_telegrams_and_one_cut_off(tmp_path: Path):
    whole = telegram("00:01:00", rain(), "0000.772")
    reading = read_disdrometer(written(tmp_path, *telegram("00:00:00", DRY, "0000.000"), *whole, *whole[:5]))
    np.testing.assert_array_equal(reading.spectra.counts, [DRY, rain()])
    assert reading.skipped == ("telegram at line 19: field 21 (date) is missing: the telegram is cut off",)


def thies_line(second: int, *, rate: str = "000.000", counts: str = "", extra: str = "") -> str:
    head = f"00;1025;2.52;15.09.21;07:00:{second:02d};00;00;NP   ;000.000;00;00;NP   ;{rate}".split(";")
    return ";".join([*head, *["0"] * (79 - len(head)), *(counts or "000;" * 439 + "000").split(";"), *extra.split(";")])


def test_thies_telegrams_bare_and_logged(tmp_path: Path):
    counts = np.zeros((22, 20), int)
    counts[6, 11] = 60  # 1.25 to 1.5 mm at 4.2 to 5 m/s
    text = ";".join(f"{count:03d}" for count in counts.ravel())
    lines = [
        thies_line(0, rate="001.072", counts=text, extra="8A"),
        '"2024-04-14 00:01:00",552609,"' + thies_line(30, counts=text, extra='+00.2;99999;8A"'),
        "\x02" + thies_line(20)[:400],
    ]
    reading = read_disdrometer(written(tmp_path, "a header", *lines))
    spectra = reading.spectra
    np.testing.assert_array_equal(spectra.counts, [counts, counts])
    np.testing.assert_array_equal(spectra.times, np.array(["2021-09-15T07:00:00", "2024-04-14T00:01:00"], "M8[ms]"))
    np.testing.assert_allclose(spectra.rate_mm_h, np.pi / 6 * 1.375**3 * 60 / 4560 * 60)
    np.testing.assert_array_equal(spectra.reported_mm_h, [1.072, 0])
    assert len(reading.skipped) == 1
    assert re.match(r"line 4: \d+ values instead of 519 or more: the telegram is cut off", reading.skipped[0])


def test_thies_classes(tmp_path: Path):
    spectra = read_disdrometer(written(tmp_path, thies_line(0))).spectra
    assert spectra.velocity_edges_m_s is not None
    assert (spectra.diameter_edges_mm[0], spectra.velocity_edges_m_s[0]) == (0.125, 0)
    np.testing.assert_allclose(np.diff(spectra.diameter_edges_mm), np.repeat([0.125, 0.25, 0.5], [3, 6, 13]))
    np.testing.assert_allclose(np.diff(spectra.velocity_edges_m_s), np.repeat([0.2, 0.4, 0.8, 1, 10], [5, 6, 7, 1, 1]))
    np.testing.assert_allclose(spectra.area_m2, 0.00456)


def test_short_thies_telegrams_have_rates_and_no_drops(tmp_path: Path):
    spectra = read_disdrometer(written(tmp_path, *(";".join(thies_line(i).split(";")[:22]) for i in (0, 59)))).spectra
    assert spectra.counts.shape == (2, 0, 1)
    np.testing.assert_array_equal(spectra.reported_mm_h, [0, 0])


def test_two_dvd_table(tmp_path: Path):
    row = "2014  121    1   {}   0  16  26" + "   0" * 47
    reading = read_disdrometer(written(tmp_path, row.format(21), row.format(61), row.format(22)))
    spectra = reading.spectra
    np.testing.assert_array_equal(spectra.counts[:, :4, 0], [[0, 16, 26, 0]] * 2)
    np.testing.assert_array_equal(spectra.times, np.array(["2014-05-01T01:22", "2014-05-01T01:23"], "M8[ms]"))
    assert spectra.velocity_edges_m_s is None
    assert len(reading.skipped) == 1 and reading.skipped[0].startswith("line 2: '2014 121 1 61' is no year")


def test_apu_table_of_densities(tmp_path: Path):
    # 100 drops per m^3 and mm in 1.125..1.25 mm: 12.5 in each m^3, falling through the area for a minute.
    row = " 2011  140    1   28" + "   0.0000" * 9 + " 100.0000" + "   0.0000" * 22
    spectra = read_disdrometer(written(tmp_path, row)).spectra
    speed = 9.65 - 10.3 * np.exp(-0.6 * 1.1875)
    np.testing.assert_allclose(spectra.counts[0, 9, 0], 12.5 * speed * 60 * 180e-6 * (30 - 1.1875 / 2))
    assert np.count_nonzero(spectra.counts) == 1


def test_nasas_tables_are_counts_or_densities_by_their_decimals(tmp_path: Path):
    apu = " 2013  115    1   26" + "   0" * 9 + " 100" + "   0" * 22
    spectra = read_disdrometer(written(tmp_path, apu)).spectra
    assert spectra.instrument == "APU (OTT Parsivel)" and spectra.counts[0, 9, 0] == 100 == spectra.counts.sum()
    # 100 drops per m^3 and mm in 0.6..0.8 mm: 20 in each m^3, falling through 0.01 m^2 for a minute.
    two_dvd = " 2013   98    6    2" + "   0.0000" * 3 + " 100.0000" + "   0.0000" * 46
    spectra = read_disdrometer(written(tmp_path, two_dvd)).spectra
    np.testing.assert_allclose(spectra.counts[0, 3, 0], 20 * (9.65 - 10.3 * np.exp(-0.6 * 0.7)) * 60 * 0.01)


def test_rainsense_intensity(tmp_path: Path):
    spectra = read_disdrometer(written(tmp_path, "current intensity:9.245")).spectra
    np.testing.assert_array_equal(spectra.reported_mm_h, [9.245])
    assert np.isnat(spectra.times[0]) and np.isnan(spectra.rate_mm_h[0]) and spectra.counts.size == 0


@pytest.mark.parametrize("text", ["current intensity:", "current intensity:heavy", "current intensity:-3"])
def test_rainsense_intensity_must_be_a_rate(tmp_path: Path, text: str):
    assert refusal(written(tmp_path, text)).startswith("line 1: ")


def test_a_transposed_spectrum_is_noticed(tmp_path: Path, caplog: pytest.LogCaptureFixture):
    diameter_major = [f"{count:03d}" for count in rain().ravel()]
    by_rate = [station_line(20, numbers=diameter_major, rate="0000.772")]
    # Without a rate the drops' speeds tell.
    by_speed = [station_line(20, numbers=diameter_major)]
    for lines in (by_rate, by_speed):
        spectra = read_disdrometer(written(tmp_path, *lines)).spectra
        np.testing.assert_array_equal(spectra.counts[0], rain())
        assert "run with diameters first, not as usual with velocities first" in caplog.text
        caplog.clear()
    read_disdrometer(written(tmp_path, station_line(20, rain(), "0000.772")))
    assert caplog.text == ""


def test_a_rate_that_agrees_in_neither_order_is_read_and_disagrees(tmp_path: Path):
    path = written(tmp_path, *(station_line(second, rain(), "0008.500") for second in range(5)))
    measured = open_disdrometer_file(path).measured()
    assert measured.rate_check is not None and measured.rate_check.agrees is False
    assert measured.rate_check.ratio == pytest.approx(0.0908, abs=1e-4)


def test_bad_records_are_left_out_and_named(tmp_path: Path):
    good = station_line(20, rain(), "0000.772")
    lines = [
        station_line(0)[2000:],
        good,
        station_line(21, rate="U0000.000"),
        good.replace(";030;", ";nan;"),
        good.replace(";030;", ";-30;"),
        good.replace(";030;", ";3O;"),
        good[:-40],
        station_line(22, rate="inf"),
        station_line(99),
        station_line(23),
        "\x00\x01\x02 noise",
        "",
    ]
    reading = read_disdrometer(written(tmp_path, *lines))
    np.testing.assert_array_equal(reading.spectra.counts, [rain(), DRY])
    assert [each.split(":")[0] for each in reading.skipped] == [f"line {i}" for i in (1, 3, 4, 5, 6, 7, 8, 9, 11)]
    text = "\n".join(reading.skipped)
    for reason in (
        "rain rate 'U0000.000' is not a number",
        "is nan",
        "is -30",
        "'3O', not a number",
        "1014 drop counts instead of 1024",
        "rain rate is inf",
        "time '20190410230799' can't be read",
    ):
        assert reason in text


def test_a_record_that_stands_twice_counts_once(tmp_path: Path):
    reading = read_disdrometer(written(tmp_path, station_line(20), station_line(20), station_line(21)))
    assert len(reading.spectra) == 2
    assert reading.skipped == ("line 2: the record of 2019-04-10T23:07:20.000 stands there twice",)


def test_records_come_in_order_of_time(tmp_path: Path):
    spectra = read_disdrometer(written(tmp_path, station_line(40), station_line(20))).spectra
    assert spectra.times[0] < spectra.times[1]


def test_no_record_left_is_refused_with_the_first_reason(tmp_path: Path):
    lines = [station_line(20, rate="x"), station_line(21, rate="y")]
    assert refusal(written(tmp_path, *lines)) == (
        "no record can be used: line 1: rain rate 'x' is not a number (and 1 more such records)"
    )


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (b"", "the file is empty"),
        (gzip.compress(b"", mtime=0), "the file is empty"),
        (b"\n\n", "line 1: not a disdrometer file of a kind that is known"),
        (b"name,value\n1,2\n", "line 1: not a disdrometer file of a kind that is known"),
        (bytes(range(256)) * 20, "neither text nor NetCDF"),
        (b"\x1f\x8b" + b"\xff" * 40, "the gzip stream is damaged"),
        (b"\x1f\x8b", "the file is empty"),
    ],
)
def test_other_files_are_refused(tmp_path: Path, data: bytes, reason: str):
    path = tmp_path / "file"
    path.write_bytes(data)
    assert refusal(path).startswith(reason)


def test_an_absent_file_is_refused(tmp_path: Path):
    assert refusal(tmp_path / "absent.txt") == "No such file or directory"


def test_gzip_is_opened_and_its_cut_off_end_is_named(tmp_path: Path):
    rng = np.random.default_rng(1)
    noisy = [rng.integers(0, 2, (32, 32)) for _ in range(20)]
    text = "\n".join(station_line(second, counts) for second, counts in enumerate(noisy))
    path = tmp_path / "log.gz"
    path.write_bytes(gzip.compress(text[:50_000].encode()) + gzip.compress(text[50_000:].encode()))
    assert len(read_disdrometer(path).spectra) == 20

    whole = gzip.compress(text.encode())
    path.write_bytes(whole[: len(whole) // 2])
    reading = read_disdrometer(path)
    assert 5 < len(reading.spectra) < 15
    np.testing.assert_array_equal(reading.spectra.counts[3], noisy[3])
    assert reading.skipped[-1] == "end of file: the gzip stream is cut off"
    assert reading.skipped[0].startswith(f"line {len(reading.spectra) + 1}: ")


def test_a_gzip_stream_with_a_wrong_checksum_is_refused(tmp_path: Path):
    data = bytearray(gzip.compress(station_line(20).encode()))
    data[-8] ^= 1
    (tmp_path / "log.gz").write_bytes(data)
    assert refusal(tmp_path / "log.gz").startswith("the gzip stream is damaged")


def test_inflated_size_is_bounded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(filter, "LARGEST_FILE", 2**20)
    (tmp_path / "bomb.gz").write_bytes(gzip.compress(bytes(2**20 + 1)))
    assert refusal(tmp_path / "bomb.gz").startswith("the file holds more than 1 MiB")


def test_number_of_spectra_is_bounded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(spectra, "MAX_COUNTS", 2 * 1024)
    path = written(tmp_path, *(station_line(second) for second in range(3)))
    assert refusal(path) == "line 3: more than 2 spectra: split the file by days"


def test_class_mask_is_no_measurement(tmp_path: Path):
    table = np.zeros((32, 32), int)
    table[20, 8] = 1
    path = written(tmp_path, *(",".join(map(str, row)) + "," for row in table))
    assert "a mask of diameters and speeds" in refusal(path)
