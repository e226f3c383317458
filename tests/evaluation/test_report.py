"""The page of a run: whole, safe to open, bounded in size, and showing the figures that were measured."""

import base64
import re
from html.parser import HTMLParser
from pathlib import Path

import cv2
import numpy as np
import pytest

from gsrain_engine.evaluation.report import (
    MAX_IMAGES,
    ReportCurve,
    ReportFigure,
    ReportTable,
    RunReport,
    report_page,
    write_report,
)
from gsrain_engine.evaluation.report_charts import (
    LARGEST_ERROR,
    WIDEST_PX,
    ImageComparison,
    axis_ticks,
    error_map_uri,
    format_number,
    svg_chart,
)

_VOID = {"meta", "img", "input", "link", "br"}


class _Page(HTMLParser):
    """Checks that elements nest, and keeps text and attributes."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.words: list[str] = []
        self.sources: list[str] = []
        self.feed(page)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.sources += [value or "" for name, value in attrs if name in ("src", "href")]
        if tag not in _VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        pass

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.words.append(data)


def _comparison(name: str = "CAM_FRONT/1", difference: float = 0.1, width: int = 40) -> ImageComparison:
    truth = np.full((20, width, 3), 0.5)
    return ImageComparison.measured(name, truth + difference, truth)


def _decoded(source: str) -> np.ndarray:
    return cv2.imdecode(np.frombuffer(base64.b64decode(source.partition(",")[2]), np.uint8), cv2.IMREAD_COLOR)


def test_the_page_holds_everything_itself_and_shows_the_figures(tmp_path: Path):
    steps = np.arange(5)
    curve = ReportCurve("loss", steps, 1.0 / (1 + steps), times_s=steps * 100.0, unit="of 1")
    report = RunReport("a run", {"steps": 5}, (curve,), (_comparison(),), {"training": 75.0}, {"Gaussians": "1,234"})
    write_report(tmp_path / "report.html", report)
    text = (tmp_path / "report.html").read_text(encoding="utf-8")
    page = _Page(text)
    words = " ".join(page.words)
    assert {path.name for path in tmp_path.iterdir()} == {"report.html"}
    assert all(source.startswith("data:image/") for source in page.sources)
    assert "http" not in text and "url(" not in text
    assert not re.search(r"\d{4}-\d\d-\d\d", text)  # of no day: the same run is the same bytes
    for expected in ("a run", "20.00 dB", "1,234", "CAM_FRONT/1", "1 min 15 s", "minutes", "cores"):
        assert expected in words
    assert "LPIPS" not in text


def test_what_comes_from_outside_is_escaped():
    evil = '<script>alert("&")</script>'
    curve = ReportCurve(evil, np.arange(2), np.arange(2.0), unit=evil)
    report = RunReport(
        evil, {evil: evil}, (curve,), (_comparison(evil),), {evil: 1.0}, {evil: evil}, (evil,), {"cpu": evil}
    )
    page = report_page(report)
    assert "<script>alert" not in page
    assert page.count("&lt;script&gt;alert(&#34;&amp;&#34;)&lt;/script&gt;") >= 10
    assert page.count("<script>") == 1  # the page's own
    _Page(page)


def test_of_many_views_some_are_pictures_and_all_are_rows():
    comparisons = tuple(_comparison(f"view {i}", 0.01 * (1 + i)) for i in range(MAX_IMAGES + 6))
    page = _Page(report_page(RunReport("a run", {}, (), comparisons)))
    assert sum(source.startswith("data:image/jpeg") for source in page.sources) == 3 * MAX_IMAGES
    words = " ".join(page.words)
    assert all(f"view {i}" in words for i in range(len(comparisons)))


def test_pictures_are_small_and_figures_are_of_the_full_size():
    generator = np.random.default_rng(0)
    truth = generator.random((300, 1300, 3))
    rendered = np.clip(truth + generator.normal(0, 0.05, truth.shape), 0, 1)
    got = ImageComparison.measured("wide", rendered, truth)
    assert got.rendered.shape == got.truth.shape == (148, WIDEST_PX, 3)
    assert got.psnr_db == pytest.approx(-10 * np.log10(((rendered - truth) ** 2).mean()))
    assert got.error.mean() == pytest.approx(np.abs(rendered - truth).mean(), rel=1e-3)


def test_the_mask_is_grey_and_costs_nothing():
    truth = np.full((20, 40, 3), 0.5)
    mask = np.ones((20, 40), bool)
    mask[:, :20] = False
    got = ImageComparison.measured("masked", np.where(mask[..., None], truth + 0.1, 1.0), truth, mask)
    assert got.psnr_db == pytest.approx(20.0)
    assert np.isnan(got.error[:, :20]).all()
    assert got.error[:, 20:] == pytest.approx(0.1, abs=1e-6)
    picture = _decoded(error_map_uri(got.error)).astype(int)
    assert np.abs(picture[:, :12] - 128).max() < 12
    assert np.abs(picture[5, 30] - 128).max() > 40


def test_error_colors_grow_lighter_up_to_the_largest_error():
    shares = np.repeat(np.linspace(0, 1.2, 8), 16)
    picture = _decoded(error_map_uri(np.tile(shares * LARGEST_ERROR, (16, 1)).astype(np.float32)))
    light = picture.reshape(16, 8, 16, 3).mean(axis=(0, 2, 3))
    assert (np.diff(light[:7]) > 5).all()
    assert light[7] == pytest.approx(light[6], abs=12)


def test_lpips_is_in_the_table_where_it_was_measured():
    truth = np.full((20, 40, 3), 0.5)
    measured = ImageComparison.measured("a", truth + 0.1, truth, None, lambda rendered, truth, mask: 0.125)
    both = report_page(RunReport("run", {}, (), (measured, _comparison())))
    assert "0.125" in both and '<td class="number" data-value="nan">&ndash;</td>' in both


def _line(svg: str) -> np.ndarray:
    found = re.search(r'class="curve" points="([^"]*)"', svg)
    assert found is not None
    return np.array([[float(each) for each in pair.split(",")] for pair in found[1].split()])


def test_a_chart_keeps_order_and_extremes():
    x = np.arange(5000.0)
    y = np.sin(x / 300)
    y[2500] = 9.0
    svg = svg_chart(x, y, "step", "value")
    line = _line(svg)
    assert len(line) == 240
    assert (np.diff(line[:, 0]) > 0).all()
    assert len(svg) < 25_000
    spans = re.search(r'class="span" points="([^"]*)"', svg)
    assert spans is not None
    heights = [float(pair.split(",")[1]) for pair in spans[1].split()]
    assert min(heights) < line[:, 1].min() - 20  # the single high value is in the span
    assert np.argmin(heights) in (119, 120)


def test_a_chart_goes_up_where_values_do_and_leaves_out_what_is_not_a_number():
    svg = svg_chart(np.arange(4.0), np.array([1.0, 10.0, np.nan, 100.0]), "step", "loss", is_logarithmic=True)
    line = _line(svg)
    assert len(line) == 3 and {"1", "2", "5", "10", "20", "50", "100"} <= set(_Page(svg).words)
    assert line[0, 1] - line[1, 1] == pytest.approx(line[1, 1] - line[2, 1], abs=0.2)
    assert "no values" in svg_chart(np.array([1.0]), np.array([np.nan]), "step", "loss")
    _Page(svg_chart(np.array([3.0, 3.0]), np.array([2.0, 2.0]), "step", "loss"))


def test_ticks_are_round_and_inside():
    assert list(axis_ticks(0.0, 3000.0, 6)) == [0, 500, 1000, 1500, 2000, 2500, 3000]
    assert list(axis_ticks(17.9, 26.2, 5)) == [18, 20, 22, 24, 26]
    assert list(axis_ticks(4.0, 4.0, 5)) == [4.0]
    numbers = {212400.0: "212,400", -212400.0: "-212,400", 0.00001: "1.0e-5", 3.14159: "3.142", -2.5e6: "-2.5 M"}
    assert {value: format_number(value) for value in numbers} == numbers


def test_tables_and_figures_of_any_kind_stand_first_and_are_escaped():
    red = np.zeros((4, 6, 3), np.uint8)
    red[..., 0] = 255
    rows = (("a & b", 3, 0.51234), ("c", 4, None))
    table = ReportTable("Scores <1>", ("who", "objects", "score"), rows, 2, definitions=("score: < 1", "who: & co."))
    report = RunReport("a run", {}, figures=(ReportFigure("Curve", red, "why"),), tables=(table,), machine={})
    page = report_page(report)
    (source,) = (each for each in _Page(page).sources if "image/png" in each)
    np.testing.assert_array_equal(_decoded(source)[..., ::-1], red)
    assert "Scores &lt;1&gt;" in page
    assert '<td class="word">a &amp; b</td>' in page
    assert '<td class="number" data-value="3.0">3</td><td class="number" data-value="0.51234">0.51</td>' in page
    assert "&ndash;" in page
    assert '</table>\n<ul class="quiet"><li>score: &lt; 1</li><li>who: &amp; co.</li></ul>' in page
