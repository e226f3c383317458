"""Tables as text, Markdown, CSV, HTML and JSON."""

import csv
import io

import pytest

from gsrain_engine.report.interval import Interval
from gsrain_engine.report.table import Column, Table, columns, table_of

CHANGE = Interval(-0.25, -0.5, 0.125, "Student, 95 %", "rain seeds", 5)
NAN = float("nan")


@pytest.fixture
def table():
    titled = (
        Column("name"), Column("change", "+.2f", "of 1", "--", "how much it falls."), Column("share", ".0%"),
        Column("drops", ","), Column("wet"),
    )  # fmt: skip
    rows = [("a|b", CHANGE, 0.5, 12345, True), ("<i>c_*", None, NAN, None, False), ("\u202ed\n", 1.0, 1.0, 7, None)]
    return Table("Title", titled, rows, "About <it>.", foot=[("mean", 0.5, 0.75, 6176, None)])


def test_text_is_aligned_and_states_over_what_intervals_are(table):
    assert table.text.splitlines() == [
        "name              change (of 1)  share   drops  wet",
        "---------  --------------------  -----  ------  ---",
        "a|b        -0.25 (-0.50..+0.12)    50%  12,345  yes",
        "<i>c_*                       --      -       -  no",
        "\\u202ed\\n                 +1.00   100%       7  -",
        "mean                      +0.50    75%   6,176  -",
        "",
        "About <it>.",
        "change: Student, 95 %, over 5 rain seeds.",
        "change: how much it falls.",
    ]


def test_wide_titles_break_and_long_captions_too():
    titled = columns({"a title of many words": ".1f", "b": ""})
    lines = Table("", titled, [(1.5, "x")], "word " * 40).text.splitlines()
    assert lines[:2] == ["a title of", "many words  b"] and max(map(len, lines)) <= 80


def test_markdown_has_no_markup_of_names(table):
    lines = table.markdown.splitlines()
    assert lines[1] == "| --- | ---: | ---: | ---: | --- |"
    assert lines[2] == "| a\\|b | -0.25 (-0.50..+0.12) | 50% | 12,345 | yes |"
    assert lines[3] == "| &lt;i>c\\_\\* | -- | - | - | no |"
    assert lines[4].startswith("| \\\\u202ed\\\\n |") and lines[5].startswith("| mean |")
    assert lines[7] == "* About &lt;it>."


def test_csv_has_whole_values_and_the_ends_of_intervals(table):
    first, second, third = csv.DictReader(io.StringIO(table.csv))
    title = "change (of 1)"
    assert (first[title], first[f"{title} low"], first[f"{title} high"], first[f"{title} n"]) == (
        "-0.25", "-0.5", "0.125", "5"
    )  # fmt: skip
    assert (first["drops"], first["wet"], second["wet"]) == ("12345", "true", "false")
    assert [second[name] for name in (title, f"{title} low", "share", "drops")] == [""] * 4
    assert third["name"] == "\u202ed\n" and "mean" not in table.csv
    quoted = Table("", columns(["a"]), [('say "x", y',)]).csv
    assert quoted == 'a\n"say ""x"", y"\n'
    assert Table("", columns(["a", "b"]), []).csv == "a,b\n"


def test_html_is_escaped_and_sorts_by_value(table):
    assert "&lt;i&gt;c_*" in table.html and "<i>" not in table.html and "\\u202ed\\n" in table.html
    assert '<td class="number" data-value="-0.25">-0.25 (-0.50..+0.12)</td>' in table.html
    assert '<td class="number" data-value="nan">--</td>' in table.html
    assert '<td class="number" data-value="12345.0">12,345</td><td class="word">yes</td>' in table.html
    body, foot = table.html.split("<tfoot>")
    assert body.count("<tr>") == 4 and foot.count("<tr>") == 1


def test_json_has_plain_values(table):
    first, second, third = table.json
    assert first == {"name": "a|b", "change (of 1)": CHANGE.plain, "share": 0.5, "drops": 12345, "wet": True}
    assert second == {"name": "<i>c_*", "change (of 1)": None, "share": None, "drops": None, "wet": False}
    assert third["wet"] is None


@pytest.mark.parametrize(
    ("cell", "text"),
    [
        (0.123456, "0.123"), (3, "3"), (None, "-"), (NAN, "-"), ("as it is", "as it is"),
        (Interval(NAN, NAN, NAN, "k", "frames", 3), "-"), (Interval(1.0, NAN, NAN, "k", "frames", 1), "1.000"),
        (Interval(1.0, 1.0, 1.0, "k", "frames", 2), "1.000"),
        (Interval(1.0, 0.5, float("inf"), "k", "frames", 2), "1.000 (0.500..inf)"),
    ],
)  # fmt: skip
def test_formats(cell, text):
    assert Table("", (Column("a", ".3f"),), [(cell,)]).text.splitlines()[2].strip() == text


def test_cells_state_their_n_where_it_differs():
    few = Interval(0.5, 0.25, 0.75, "Wilson, 95 %", "drives", 4)
    other = Interval(1.0, 1.0, 1.0, "Wilson, 95 %", "drives", 1)
    table = Table("", (Column("a", ".2f"), Column("b", ".2f")), [(few, few), (other, few)])
    assert "0.50 (0.25..0.75, n = 4)  0.50 (0.25..0.75)" in table.text
    assert "1.00 (n = 1)" in table.text
    assert table.notes == ("a: Wilson, 95 %, over 1 to 4 drives.", "b: Wilson, 95 %, over 4 drives.")
    one = Table("", (Column("a"), Column("b")), [(other, other)])
    assert one.notes == ("Intervals: Wilson, 95 %, over 1 drive.",)


def test_rows_with_names_may_lack_values():
    table = table_of("", ("a", Column("b", ".1f")), [{"a": 1, "b": 2.0, "c": 3}, {"b": None}])
    assert table.csv == "a,b\n1,2.0\n,\n" and table.text.splitlines()[2] == "1  2.0"
