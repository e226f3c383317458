"""The page of a run: self-contained, escaped, bounded in size, with the measured figures."""

import base64
import re
from pathlib import Path

import cv2
import numpy as np
import pytest

from gsrain_engine.evaluation.image_metrics import WIDEST_PX, compare_images
from gsrain_engine.report.charts import (
    error_map_uri,
    format_number,
    svg_chart,
)
from gsrain_engine.report.page import (
    MAX_IMAGES,
    ReportCurve,
    ReportFigure,
    RunReport,
    report_page,
    write_report,
)
from gsrain_engine.report.table import Column, Table


def _decoded(source: str) -> np.ndarray:
    return cv2.imdecode(np.frombuffer(base64.b64decode(source.partition(",")[2]), np.uint8), cv2.IMREAD_COLOR)


def test_page_is_self_contained_and_has_the_figures(tmp_path: Path):
    steps, truth = np.arange(5), np.full((20, 40, 3), 0.5)
    curve = ReportCurve("loss", steps, 1.0 / (1 + steps), times_s=steps * 100.0, unit="of 1")
    views = [compare_images(f"view {i}", truth + 0.01 * i, truth) for i in range(1, MAX_IMAGES + 7)]
    report = RunReport("a run", {"steps": 5}, (curve,), tuple(views), {"training": 75.0}, {"Gaussians": "1,234"})
    file = tmp_path / "new" / "report.html"
    write_report(file, report)
    page = file.read_text(encoding="utf-8")
    assert list(file.parent.iterdir()) == [file]
    sources = re.findall(r'(?:src|href)="([^"]*)"', page)
    assert all(source.startswith("data:image/") for source in sources)
    assert sum(source.startswith("data:image/jpeg") for source in sources) == 3 * MAX_IMAGES
    assert "http" not in page and "url(" not in page
    assert not re.search(r"\d{4}-\d\d-\d\d", page)  # no date: the same run gives the same bytes
    for expected in ("a run", "40.00 dB", "1,234", *(f">{each.name}<" for each in views), "1 min 15 s", "minutes"):
        assert expected in page
    assert "LPIPS" not in page
    lpips = compare_images("a", truth + 0.1, truth, None, lambda rendered, truth, mask: 0.125)
    both = report_page(RunReport("run", {}, (), (lpips, views[0])))
    assert "0.125" in both and '<td class="number" data-value="nan">-</td>' in both


def test_all_text_is_escaped():
    evil = '<script>alert("&")</script>'
    red = np.zeros((4, 6, 3), np.uint8)
    red[..., 0] = 255
    curve = ReportCurve(evil, np.arange(2), np.arange(2.0), unit=evil)
    table = Table(
        evil, (Column(evil, definition=evil), Column("objects"), Column("score", ".2f")),
        ((evil, 3, 0.51234), ("c", 4, None)), evil,
    )  # fmt: skip
    view = compare_images(evil, np.zeros((20, 40, 3)), np.ones((20, 40, 3)))
    page = report_page(
        RunReport(
            evil, {evil: evil}, (curve,), (view,), {evil: 1.0}, {evil: evil}, (evil,), {"cpu": evil},
            figures=(ReportFigure(evil, red, evil),), tables=(table,),
        )
    )  # fmt: skip
    assert page.count("&lt;script&gt;alert(&#34;&amp;&#34;)&lt;/script&gt;") >= 16
    assert page.count("<script>") == 1  # the page's own
    drawings = [_decoded(source)[..., ::-1] for source in re.findall(r'src="(data:image/png[^"]*)"', page)]
    assert any(np.array_equal(each, red) for each in drawings)
    assert '<td class="number" data-value="3.0">3</td><td class="number" data-value="0.51234">0.51</td>' in page


def test_wide_images_are_reduced_after_they_are_measured():
    generator = np.random.default_rng(0)
    truth = generator.random((300, 1300, 3))
    rendered = np.clip(truth + generator.normal(0, 0.05, truth.shape), 0, 1)
    found = compare_images("wide", rendered, truth)
    assert found.rendered.shape == found.truth.shape == (148, WIDEST_PX, 3)
    assert found.psnr_db == pytest.approx(-10 * np.log10(((rendered - truth) ** 2).mean()))
    assert found.error.mean() == pytest.approx(np.abs(rendered - truth).mean(), rel=1e-3)


def test_masked_pixels_are_gray_and_not_measured():
    truth = np.full((20, 40, 3), 0.5)
    mask = np.ones((20, 40), bool)
    mask[:, :20] = False
    found = compare_images("masked", np.where(mask[..., None], truth + 0.1, 1.0), truth, mask)
    assert found.psnr_db == pytest.approx(20.0)
    assert np.isnan(found.error[:, :20]).all()
    assert found.error[:, 20:] == pytest.approx(0.1, abs=1e-6)
    picture = _decoded(error_map_uri(found.error)).astype(int)
    assert np.abs(picture[:, :12] - 128).max() < 12
    assert np.abs(picture[5, 30] - 128).max() > 40


def _points(svg: str, name: str) -> np.ndarray:
    found = re.search(rf'class="{name}" points="([^"]*)"', svg)
    assert found is not None
    return np.array([[float(each) for each in pair.split(",")] for pair in found[1].split()])


def test_chart_has_the_order_and_the_extremes_of_many_values():
    x = np.arange(5000.0)
    y = np.sin(x / 300)
    y[2500] = 9.0
    svg = svg_chart(x, y, "step", "value")
    line, heights = _points(svg, "curve"), _points(svg, "span")[:, 1]
    assert len(line) == 240 and (np.diff(line[:, 0]) > 0).all()
    assert len(svg) < 25_000
    assert min(heights) < line[:, 1].min() - 20  # the single high value is in the span
    assert np.argmin(heights) in (119, 120)


def test_logarithmic_chart_omits_what_is_not_a_number():
    svg = svg_chart(np.arange(4.0), np.array([1.0, 10.0, np.nan, 100.0]), "step", "loss", is_logarithmic=True)
    line = _points(svg, "curve")
    assert len(line) == 3 and all(f">{each}</text>" in svg for each in (1, 2, 5, 10, 20, 50, 100))
    assert line[0, 1] - line[1, 1] == pytest.approx(line[1, 1] - line[2, 1], abs=0.2)
    assert "no values" in svg_chart(np.array([1.0]), np.array([np.nan]), "step", "loss")
    constant = _points(svg_chart(np.array([3.0, 3.0]), np.array([2.0, 2.0]), "step", "loss"), "curve")
    assert np.isfinite(constant).all()
    numbers = {212400.0: "212,400", -212400.0: "-212,400", 0.00001: "1.0e-5", 3.14159: "3.142", -2.5e6: "-2.5 M"}
    assert {value: format_number(value) for value in numbers} == numbers
