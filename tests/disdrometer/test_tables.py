"""Tables of text: dialects that their header tells, and tables that a YAML file describes."""

import gzip
import re
from pathlib import Path

import numpy as np
import pytest

from extension_package import titled_blocks
from gsrain_engine.disdrometer.file_summary import open_disdrometer_file
from gsrain_engine.disdrometer.instruments import RD80_EDGES_MM
from gsrain_engine.disdrometer.open import read_disdrometer
from gsrain_engine.disdrometer.spectra import DisdrometerFileError
from gsrain_engine.disdrometer.tables import TableColumns, load_columns
from parsivel_text import DRY, pyatmoslogger, rain, scamp, velocity_major
from repository import REPOSITORY


def written(folder: Path, *lines: str, end: str = "\n") -> Path:
    path = folder / "table.txt"
    path.write_bytes(end.join([*lines, ""]).encode("utf-8"))
    return path


def described(folder: Path, text: str) -> Path:
    (folder / "columns.yaml").write_text(text)
    return folder / "columns.yaml"


ROWS = [
    ("2024-02-19 00:01:00", "0000.772", rain()),
    ("2024-02-19 00:02:00", "0000.000", DRY),
    ("2024-02-19 00:03:00", "0000.772", rain()),
]


def test_broken_rows_of_a_table_are_left_out_and_named(tmp_path: Path):
    lines = pyatmoslogger(ROWS)
    cut, word = lines[1][:3000], lines[3].replace(";020;", ";many;", 1)
    reading = read_disdrometer(written(tmp_path, *lines, cut, word, lines[2].replace("2024-02", "2024-99")))
    assert len(reading.spectra) == 3
    expected = ("line 5: .* instead of 1094", "line 6: drop count 356 is 'many'", "line 7: time '2024-99")
    for sentence, words in zip(reading.skipped, expected, strict=True):
        assert re.match(words, sentence)
    lines = scamp(ROWS)
    reading = read_disdrometer(written(tmp_path, lines[0], ",,".join(lines[1].rsplit(",020,", 1)), *lines[2:]))
    assert len(reading.spectra) == 2 and "is ''" in reading.skipped[0]  # a missing count is no zero


RD80 = (
    "YYYY-MM-DD\thh:mm:ss\tStatus\tInterval [s]\t"
    + "\t".join(f"n{i}" for i in range(1, 21))
    + "\tRI [mm/h]\tRA [mm]\tRAT [mm]"
)


def rd80_row(minute: int, drops: int, rate: str) -> str:
    counts = [0] * 20
    counts[7] = drops  # 1.232 to 1.429 mm
    return "\t".join(["2022-01-01", f"18:{minute:02d}:00", "0", "60", *map(str, counts), rate, "0,001", "0,002"])


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


def test_a_described_density_is_counted_too(tmp_path: Path):
    path = written(tmp_path, "time,d1,d2,d3", "2024-05-01T10:00:00,100,40,0")
    columns = "{instrument: densities, time: time, seconds: 60, drops: {first: d1, last: d3}, quantity: drops_m3_mm, "
    columns += "diameter_edges_mm: [1, 1.5, 2, 2.5], area_m2: 0.005}"
    spectra = read_disdrometer(path, load_columns(described(tmp_path, columns))).spectra
    fall = 9.65 - 10.3 * np.exp(-0.6 * np.array([1.25, 1.75, 2.25]))  # Atlas et al. 1973
    np.testing.assert_allclose(spectra.counts[0, :, 0], np.array([100, 40, 0]) * 0.5 * fall * 0.005 * 60)


def test_columns_by_number_and_a_column_of_all_drops(tmp_path: Path):
    counts = "/".join(velocity_major(rain()))
    path = written(tmp_path, f"20240219000100 0.772 60 {counts}", f"20240219000200 0.772 60 {counts}")
    columns = (
        "{instrument: OTT Parsivel, header_line: 0, separator: ' ', time: 1, rate: 2, seconds_column: 3, drops: 4}"
    )
    spectra = read_disdrometer(path, load_columns(described(tmp_path, columns))).spectra
    np.testing.assert_array_equal(spectra.counts, [rain(), rain()])
    np.testing.assert_array_equal(spectra.seconds, [60, 60])


OTT, DVD = "instrument: OTT Parsivel\ntime: t\n", "instrument: 2DVD\ntime: t\ndrops: x\n"
OTHER = "instrument: X\ntime: t\ndrops: x\n"


@pytest.mark.parametrize(
    ("text", "field"),
    [
        (OTT + "drop: x", "`drop`; did you mean `drops`"),
        ("instrument: OTT Parsivel\ndrops: x", "`time`"),
        (OTT + "drops: 0", r"\$.drops"),
        ("instrument: Pluvio\ntime: t\ndrops: x", "`instrument` Pluvio .*Thies LNM"),
        (OTHER + "diameter_edges_mm: [1, 2, 3, 4]", "`area_m2`"),
        (DVD + "area_m2: 1", "`area_m2` and `velocity_edges_m_s`"),
        (OTHER + "area_m2: 1\ndiameter_edges_mm: [1, 3, 2, 4]", "`diameter_edges_mm` must rise"),
        (OTHER + "area_m2: 1\ndiameter_edges_mm: [1, 3, 20, 400]", "`diameter_edges_mm`"),
        (DVD + "seconds: 0", r"\$.seconds"),
        (DVD + "seconds: .nan", "seconds"),
        (DVD + "rate_unit: inch", "m/s, mm/h"),
        (DVD + "time_format: '%H:%M'", "`time_format` %H:%M must name"),
        (DVD + "time_format: '%Y-%q'", "`time_format` %Y-%q: "),
        (OTT + "drops: x\nquantity: drops_m3_mm", "`quantity`"),
        (DVD + "separator: ','\ndecimal: ','", "`decimal`"),
        ("[1, 2]", "Expected an object"),
        ("a: *b", "YAML"),
    ],
)
def test_a_wrong_description_names_its_field(tmp_path: Path, text: str, field: str):
    path = described(tmp_path, text)
    with pytest.raises(ValueError, match=f"^{re.escape(str(path))}: .*{field}"):
        load_columns(path)


@pytest.mark.parametrize(
    ("change", "field"),
    [
        ("rate: Rian", "`rate`: .*Rian .*Day, Clock, Rain, Battery"),
        ("header_line: 9", "header_line is 9"),
        ('drops: {first: "2-3", last: "1-2"}', "`drops`: its last column, 6"),
        ('drops: {first: "1-2", last: "2-3"}', "`drops`: 2 columns"),
        ("header_line: 1", "`drops.first`"),
    ],
)
def test_a_description_that_does_not_fit_names_its_field(tmp_path: Path, change: str, field: str):
    header = "a logger of our own", "Day;Clock;Rain;Battery;0.5-1;1-2;2-3"
    path = written(tmp_path, *header, "13/05/2024;14.02;0;1;0;0;0")
    lines = [line for line in OWN.strip().splitlines() if not line.startswith(f"{change.partition(':')[0]}:")]
    columns = load_columns(described(tmp_path, "\n".join([*lines, change])))
    with pytest.raises(DisdrometerFileError, match=f"^{re.escape(str(path))}: {field}"):
        read_disdrometer(path, columns)


def test_a_start_without_a_length_and_what_is_no_text_are_refused(tmp_path: Path):
    path = written(tmp_path, "time,n", "2024-05-01 10:00:00," + "0 " * 50)
    columns = load_columns(described(tmp_path, "{instrument: 2DVD, time: time, time_is: start, drops: n}"))
    with pytest.raises(DisdrometerFileError, match="`seconds`"):
        read_disdrometer(path, columns)
    path.write_bytes(gzip.compress(bytes(range(256))))
    with pytest.raises(DisdrometerFileError, match="not a text"):
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
