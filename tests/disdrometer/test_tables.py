"""Tables of text: dialects that their header tells, and tables that a YAML file describes."""

import gzip
from pathlib import Path

import numpy as np
import pytest

from extension_package import titled_blocks
from gsrain_engine.disdrometer.file_summary import open_disdrometer_file
from gsrain_engine.disdrometer.open import read_disdrometer
from gsrain_engine.disdrometer.spectra import DisdrometerFileError, UnknownKindError
from gsrain_engine.disdrometer.tables import TableColumns, drops_of_densities, load_columns
from gsrain_engine.disdrometer.two_dvd import RD80_EDGES_MM
from parsivel_text import DRY, RAIN_MM_H, rain, velocity_major
from repository import REPOSITORY

FIELDS_32 = [f"{i:02d}" for i in range(32)]


def written(folder: Path, *lines: str, end: str = "\n") -> Path:
    path = folder / "table.txt"
    path.write_bytes(end.join([*lines, ""]).encode("utf-8"))
    return path


def described(folder: Path, text: str) -> Path:
    (folder / "columns.yaml").write_text(text)
    return folder / "columns.yaml"


def pyatmoslogger(rows: list[tuple[str, str, np.ndarray]]) -> list[str]:
    names = ["datetime_utc", "rain rate [mm/h]", "rain accum [mm]", "Z [dBz]", "sample interval [s]"]
    names += ["Rain intensity 16 bit low [mm/h]", *(f"N{i}" for i in FIELDS_32), *(f"v{i}" for i in FIELDS_32)]
    names += [f"M_{i}_{j}" for i in range(32) for j in range(32)]
    rest = ["99", *["-9.999"] * 32, *["00.000"] * 32]
    lines = [
        ";".join([time, rate, "0003.69", "-9.999", "00060", *rest, *velocity_major(counts)])
        for time, rate, counts in rows
    ]
    return [";".join(names), *lines]


def scamp(rows: list[tuple[str, str, np.ndarray]]) -> list[str]:
    names = "time;rainfall_rate_32bit;rainfall_accumulated_32bit;sample_interval;sensor_time;station_name;"
    names += "raw_drop_concentration;raw_drop_average_velocity;raw_drop_number"
    spectra = ",".join(["-9.999"] * 32)
    return [names] + [
        f"{time};{rate};0019.25;00060;01:32:00;SCAMP;{spectra};{spectra};{','.join(velocity_major(counts))}"
        for time, rate, counts in rows
    ]


def campbell(rows: list[tuple[str, str, np.ndarray]]) -> list[str]:
    header = '"TIMESTAMP","RECORD","Intensity","AccumulatedAmount","Code4680","Error","FieldN","Fieldv","RowData"'
    fields = '"-9.999,-9.999,","00.000,00.000,"'
    lines = [
        f'"{time}",{i},"{rate}","0000.00","00","000",{fields},"{",".join(velocity_major(counts))},"'
        for i, (time, rate, counts) in enumerate(rows)
    ]
    begin = ['"TOA5","7481","CR1000","7481","CR1000.Std.11","CPU:Parsivel.CR1","49567","Parsiv1"', header]
    return [*begin, '"TS","RN","","","","","","",""', '"","","Smp","Smp","Smp","Smp","Smp","Smp","Smp"', *lines]


ROWS = [
    ("2024-02-19 00:01:00", "0000.772", rain()),
    ("2024-02-19 00:02:00", "0000.000", DRY),
    ("2024-02-19 00:03:00", "0000.772", rain()),
]


@pytest.mark.parametrize("dialect", [pyatmoslogger, scamp, campbell])
def test_parsivel_tables_told_by_their_header(tmp_path: Path, dialect):
    reading = read_disdrometer(written(tmp_path, *dialect(ROWS), end="\r\n"))
    spectra = reading.spectra
    assert (spectra.instrument, reading.skipped) == ("OTT Parsivel", ())
    np.testing.assert_array_equal(spectra.counts, [rain(), DRY, rain()])
    np.testing.assert_array_equal(spectra.seconds, [60, 60, 60])
    np.testing.assert_array_equal(spectra.reported_mm_h, [0.772, 0, 0.772])
    np.testing.assert_allclose(spectra.rate_mm_h[0], RAIN_MM_H, rtol=1e-4)
    assert spectra.times[0] == np.datetime64("2024-02-19T00:01", "ms")


def test_a_stated_interval_is_the_length_and_none_is_the_step(tmp_path: Path):
    lines = [line.replace(";00060;", ";00030;") for line in pyatmoslogger(ROWS)]
    np.testing.assert_array_equal(read_disdrometer(written(tmp_path, *lines)).spectra.seconds, [30, 30, 30])
    lines = [
        line.replace("00:0", "00:00:0") for line in campbell([(f"2024-02-19 01:00:{s}", "0", DRY) for s in (10, 20)])
    ]
    np.testing.assert_array_equal(read_disdrometer(written(tmp_path, *lines)).spectra.seconds, [10, 10])


def test_a_logger_that_starts_anew_writes_its_header_again(tmp_path: Path):
    for dialect in (campbell, pyatmoslogger):
        whole = dialect(ROWS)
        reading = read_disdrometer(written(tmp_path, *whole, *dialect([("2024-02-19 01:00:00", "NAN", DRY)])))
        assert len(reading.spectra) == 4 and reading.skipped == ()
        assert np.isnan(reading.spectra.reported_mm_h[-1])


def test_broken_rows_of_a_table_are_left_out_and_named(tmp_path: Path):
    lines = pyatmoslogger(ROWS)
    cut, word = lines[1][:3000], lines[3].replace(";020;", ";many;", 1)
    reading = read_disdrometer(written(tmp_path, *lines, cut, word, lines[2].replace("2024-02", "2024-99")))
    assert len(reading.spectra) == 3
    first, second, third = reading.skipped
    assert first.startswith("line 5: ") and first.endswith("columns instead of 1094: the record is cut off")
    assert second == "line 6: drop count 356 is 'many', not a number"
    assert third == "line 7: time '2024-99-19 00:02:00' can't be read"


def test_a_missing_count_is_no_zero(tmp_path: Path):
    lines = scamp(ROWS)
    with_blank = lines[1].rsplit(",020,", 1)
    reading = read_disdrometer(written(tmp_path, lines[0], ",,".join(with_blank), *lines[2:]))
    assert len(reading.spectra) == 2 and "is '', not a number" in reading.skipped[0]


RD80 = (
    "YYYY-MM-DD\thh:mm:ss\tStatus\tInterval [s]\t"
    + "\t".join(f"n{i}" for i in range(1, 21))
    + "\tRI [mm/h]\tRA [mm]\tRAT [mm]"
)


def rd80_row(minute: int, drops: int, rate: str) -> str:
    counts = [0] * 20
    counts[7] = drops  # 1.232 to 1.429 mm
    return "\t".join(["2022-01-01", f"18:{minute:02d}:00", "0", "60", *map(str, counts), rate, "0,001", "0,002"])


def test_densities_become_the_drops_that_would_have_been_counted():
    """N(D) dD times what drops sweep past in the time: 1 mm at 3.95 m/s, 3 mm at 8.03 m/s (Atlas et al. 1973)."""
    density = np.array([[100.0, 0.0], [200.0, 10.0]])
    counted = drops_of_densities(density, np.array([0.5, 1.5, 4.5]), 0.005, np.array([60.0, 30.0]))
    slow, fast = 9.65 - 10.3 * np.exp(-0.6), 9.65 - 10.3 * np.exp(-1.8)
    assert counted == pytest.approx(0.005 * np.array([[100 * slow * 60, 0], [200 * slow * 30, 30 * fast * 30]]))


def test_classes_of_the_rd80_lie_around_its_mean_diameters():
    """The other column of Distromet's table, to its three digits."""
    means = [0.359, 0.455, 0.551, 0.656, 0.771, 0.913, 1.116, 1.331, 1.506, 1.665]
    means += [1.912, 2.259, 2.584, 2.869, 3.198, 3.544, 3.916, 4.350, 4.859, 5.373]
    assert (RD80_EDGES_MM[:-1] + RD80_EDGES_MM[1:]) / 2 == pytest.approx(means, abs=1.1e-3)


def test_rd80_text_with_the_countrys_commas(tmp_path: Path):
    volume_mm = 100 * np.pi / 6 * 1.3305**3 / 5000
    lines = [RD80, *(rd80_row(minute, 100, f"{volume_mm * 60:.4f}".replace(".", ",")) for minute in (14, 15))]
    spectra = read_disdrometer(written(tmp_path, *lines, end="\r\n")).spectra
    assert spectra.instrument == "Joss-Waldvogel" and spectra.velocity_edges_m_s is None
    np.testing.assert_array_equal(spectra.diameter_edges_mm, RD80_EDGES_MM)
    np.testing.assert_array_equal(spectra.counts[:, 7, 0], [100, 100])
    np.testing.assert_allclose(spectra.rate_mm_h, spectra.reported_mm_h, rtol=1e-3)
    assert spectra.times[-1] == np.datetime64("2022-01-01T18:15", "ms")


OWN = """
instrument: Our counter
time: [Day, Clock]
time_format: "%d/%m/%Y %H.%M"
time_is: start
utc_offset_h: 2
seconds: 120
rate: Rain
rate_unit: mm/min
drops: {first: "0.5-1", last: "2-3"}
diameter_edges_mm: [0.5, 1, 2, 3]
area_m2: 0.01
separator: ";"
decimal: ","
header_line: 2
comments: ["#"]
"""


def test_any_table_by_the_description_of_its_columns(tmp_path: Path):
    path = written(
        tmp_path,
        "a logger of our own",
        "Day;Clock;Rain;Battery;0.5-1;1-2;2-3",
        "# maintenance",
        "13/05/2024;14.02;0,05;12,1;10;20;1",
        "13/05/2024;14.00;0,02;12,1;10;5;0",
    )
    spectra = read_disdrometer(path, load_columns(described(tmp_path, OWN))).spectra
    assert spectra.instrument == "Our counter" and spectra.velocity_edges_m_s is None
    np.testing.assert_array_equal(spectra.counts[:, :, 0], [[10, 5, 0], [10, 20, 1]])
    np.testing.assert_array_equal(spectra.times, np.array(["2024-05-13T12:02", "2024-05-13T12:04"], "M8[ms]"))
    np.testing.assert_allclose(spectra.reported_mm_h, [1.2, 3.0])
    np.testing.assert_array_equal(spectra.seconds, [120, 120])
    volume = np.pi / 6 * np.array([0.75, 1.5, 2.5]) ** 3 @ [10, 20, 1]
    np.testing.assert_allclose(spectra.rate_mm_h[1], volume / 10_000 * 30)


def test_columns_by_number_and_a_column_of_all_drops(tmp_path: Path):
    counts = "/".join(velocity_major(rain()))
    path = written(tmp_path, f"20240219000100 0.772 60 {counts}", f"20240219000200 0.772 60 {counts}")
    columns = (
        "{instrument: OTT Parsivel, header_line: 0, separator: ' ', time: 1, rate: 2, seconds_column: 3, drops: 4}"
    )
    spectra = read_disdrometer(path, load_columns(described(tmp_path, columns))).spectra
    np.testing.assert_array_equal(spectra.counts, [rain(), rain()])
    np.testing.assert_array_equal(spectra.seconds, [60, 60])


def test_densities_become_the_drops_that_make_them(tmp_path: Path):
    path = written(tmp_path, "time,d1,d2,d3", "2024-05-01T10:00:00,100,0,0")
    columns = "{instrument: densities, time: time, seconds: 60, drops: {first: d1, last: d3}, quantity: drops_m3_mm, "
    columns += "diameter_edges_mm: [1, 1.5, 2, 2.5], area_m2: 0.005}"
    spectra = read_disdrometer(path, load_columns(described(tmp_path, columns))).spectra
    fall = 9.65 - 10.3 * np.exp(-0.6 * 1.25)
    np.testing.assert_allclose(spectra.counts[0, :, 0], [100 * 0.5 * fall * 0.005 * 60, 0, 0])


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("instrument: OTT Parsivel\ntime: t\ndrop: x", "unknown field `drop`; did you mean `drops`?"),
        ("instrument: OTT Parsivel\ndrops: x", "missing required field `time`"),
        ("instrument: OTT Parsivel\ntime: t\ndrops: 0", ">= 1 - at `$.drops`"),
        (
            "instrument: Pluvio\ntime: t\ndrops: x",
            "`instrument` Pluvio is none of OTT Parsivel, Thies LNM, Joss-Waldvogel, 2DVD",
        ),
        ("instrument: X\ntime: t\ndrops: x\ndiameter_edges_mm: [1, 2, 3, 4]", "give `area_m2`, too"),
        (
            "instrument: X\ntime: t\ndrops: x\narea_m2: 1\ndiameter_edges_mm: [1, 3, 2, 4]",
            "`diameter_edges_mm` must rise",
        ),
        ("instrument: X\ntime: t\ndrops: x\narea_m2: 1\ndiameter_edges_mm: [1, 3, 20, 400]", "must lie within 0 to 50"),
        ("instrument: 2DVD\ntime: t\ndrops: x\nseconds: 0", ">= 1.0 - at `$.seconds`"),
        ("instrument: 2DVD\ntime: t\ndrops: x\nseconds: .nan", "finite"),
        ("instrument: 2DVD\ntime: t\ndrops: x\nrate_unit: inch", "expected m/s, mm/h, mm/min, mm/s"),
        ("instrument: 2DVD\ntime: t\ndrops: x\ntime_format: '%H:%M'", "must name year, month, day and hour"),
        ("instrument: 2DVD\ntime: t\ndrops: x\ntime_format: '%Y-%q'", "`time_format` %Y-%q: "),
        ("instrument: OTT Parsivel\ntime: t\ndrops: x\nquantity: drops_m3_mm", "a number density has no fall speeds"),
        ("instrument: 2DVD\ntime: t\ndrops: x\nseparator: ','\ndecimal: ','", "a comma can't separate numbers and be"),
        ("[1, 2]", "Expected `object`, got `array`"),
        ("a: *b", "not readable as YAML"),
    ],
)
def test_a_wrong_description_is_one_sentence(tmp_path: Path, text: str, reason: str):
    path = described(tmp_path, text)
    with pytest.raises(ValueError) as caught:
        load_columns(path)
    assert str(caught.value).startswith(f"{path}: ") and reason in str(caught.value)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ("rate: Rian", "`rate`: no column is called Rian (there are Day, Clock, Rain, Battery, 0.5-1, 1-2, 2-3)"),
        ("header_line: 9", "header_line is 9, and it has 4 lines"),
        ('drops: {first: "2-3", last: "1-2"}', "`drops`: its last column, 6, stands before its first, 7"),
        ('drops: {first: "1-2", last: "2-3"}', "`drops`: 2 columns, and Our counter has 3 classes"),
        ("header_line: 1", "`drops.first`: no column is called 0.5-1 (there are a logger of our own)"),
    ],
)
def test_a_description_that_does_not_fit_is_one_sentence(tmp_path: Path, change: str, reason: str):
    path = written(
        tmp_path, "a logger of our own", "Day;Clock;Rain;Battery;0.5-1;1-2;2-3", "13/05/2024;14.02;0;1;0;0;0"
    )
    key = change.partition(":")[0]
    lines = [line for line in OWN.strip().splitlines() if not line.startswith(f"{key}:")]
    columns = load_columns(described(tmp_path, "\n".join([*lines, change])))
    with pytest.raises(DisdrometerFileError) as caught:
        read_disdrometer(path, columns)
    assert str(caught.value) == f"{path}: {reason}"


def test_a_start_without_a_length_can_not_be_an_end(tmp_path: Path):
    path = written(tmp_path, "time,n", "2024-05-01 10:00:00," + "0 " * 50)
    columns = load_columns(described(tmp_path, "{instrument: 2DVD, time: time, time_is: start, drops: n}"))
    with pytest.raises(DisdrometerFileError, match="its length is not known: give `seconds`"):
        read_disdrometer(path, columns)


def test_a_refusal_lists_the_kinds_that_are_known(tmp_path: Path):
    with pytest.raises(UnknownKindError) as caught:
        read_disdrometer(written(tmp_path, "time,rain", "2024-05-01 10:00:00,3"))
    for words in (
        "Campbell TOA5",
        "pyAtmosLogger",
        "SCAMP",
        "DISDRODB",
        "RD-80",
        "Thies LNM",
        "2DVD",
        "APU",
        "--columns",
    ):
        assert words in str(caught.value)


def test_columns_do_not_describe_what_is_no_text(tmp_path: Path):
    path = tmp_path / "table.gz"
    columns = load_columns(described(tmp_path, "{instrument: 2DVD, time: time, drops: n}"))
    path.write_bytes(gzip.compress(bytes(range(256))))
    with pytest.raises(DisdrometerFileError, match="not a text: columns describe a table of text"):
        read_disdrometer(path, columns)


def test_the_documented_example_prints_what_the_page_says(tmp_path: Path):
    blocks = titled_blocks(REPOSITORY / "docs" / "guide" / "calibration.md")
    for name in ("counter.csv", "counter.yaml"):
        (tmp_path / name).write_text(blocks[name], encoding="utf-8")
    measured = open_disdrometer_file(tmp_path / "counter.csv", load_columns(tmp_path / "counter.yaml")).measured()
    assert "\n".join(measured.lines) == blocks["printed"].rstrip()


def test_every_field_of_a_description_is_documented():
    text = (REPOSITORY / "docs" / "formats.md").read_text(encoding="utf-8")
    section = text.partition("## Tables of disdrometers\n")[2].partition("\n## ")[0]
    assert [field for field in TableColumns.__struct_fields__ if f"`{field}`" not in section] == []
