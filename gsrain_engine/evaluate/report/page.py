"""The page of a run as HTML: what came of it first, how it was made last."""

from collections.abc import Iterable, Mapping
from importlib.resources import files

import numpy as np

from .charts import chart, escape, number
from .comparison import Comparison
from .pictures import LARGEST_ERROR, color_bar, drawing, error_picture, photograph
from .run_report import Curve, Figure, ReportTable, RunReport

MOST_PICTURES = 24
"""Of more views the best, the worst and those evenly between are shown; the table has them all."""


def report_page(report: RunReport) -> str:
    """Return the whole page, the same bytes for the same run: it tells no date. What comes from outside is escaped."""
    title, body = escape(report.title), "".join(_body(report))
    return (
        '<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{title}</title>\n<style>\n{_part('report.css')}</style>\n</head>\n<body>\n"
        f"{body}<script>\n{_part('report.js')}</script>\n</body>\n</html>\n"
    )


def _body(report: RunReport) -> Iterable[str]:
    yield f"<h1>{escape(report.title)}</h1>\n"
    yield f'<p class="quiet">{escape(str(report.machine.get("cpu", "")))}</p>\n'
    yield _tiles({**_means(report.comparisons, "held-out " if report.held_out else ""), **report.headlines})
    if report.problems:
        items = "".join(f"<li>{escape(problem)}</li>" for problem in report.problems)
        yield f'<div class="problems"><strong>Left out of the capture</strong><ul>{items}</ul></div>\n'
    if report.notes:
        items = "".join(f"<li>{escape(note)}</li>" for note in report.notes)
        yield f'<div class="problems"><strong>To know</strong><ul>{items}</ul></div>\n'
    yield from map(_figure, report.figures)
    yield from map(_plain_table, report.tables)
    if report.comparisons:
        yield _pictures(report.comparisons, report.held_out)
        yield f"<h2>Every {'held-out view' if report.held_out else 'picture'}</h2>\n{_table(report.comparisons)}"
    if report.curves:
        yield _charts(report.curves)
    if report.timings:
        yield f"<h2>Timings</h2>\n{_timings(report.timings)}"
    settings, machine = _facts(report.settings), _facts(report.machine)
    yield f'<div class="columns"><section><h2>Settings</h2>{settings}</section>'
    yield f"<section><h2>Machine</h2>{machine}</section></div>\n"


def _means(comparisons: tuple[Comparison, ...], which: str) -> dict[str, str]:
    if not comparisons:
        return {}
    rows = {
        f"{which}PSNR": f"{_mean(each.psnr_db for each in comparisons):.2f} dB",
        f"{which}SSIM": f"{_mean(each.ssim for each in comparisons):.3f}",
    }
    distances = [each.lpips for each in comparisons if each.lpips is not None]
    if distances:
        rows[f"{which}LPIPS"] = f"{_mean(distances):.3f}"
    return {**rows, f"{which}views" if which else "pictures": str(len(comparisons))}


def _tiles(figures: Mapping[str, str]) -> str:
    tiles = (f'<div class="tile"><b>{escape(str(v))}</b><span>{escape(k)}</span></div>' for k, v in figures.items())
    return f'<div class="tiles">{"".join(tiles)}</div>\n' if figures else ""


def _pictures(comparisons: tuple[Comparison, ...], held_out: bool) -> str:
    title, kinds = ("Held-out views", ("recorded", "rendered")) if held_out else ("Pictures", ("truth", "picture"))
    shown = _chosen(comparisons)
    note = "" if len(shown) == len(comparisons) else f": {len(shown)} of {len(comparisons)}, from the best to the worst"
    bar = (
        f'<div class="scale">mean absolute difference&nbsp; 0 <img src="{color_bar()}" alt="black to light yellow"> '
        f"≥ {LARGEST_ERROR:g} of 1; grey: not compared</div>"
    )
    return f"<h2>{title}{note}</h2>\n{bar}\n{''.join(_view(each, kinds) for each in shown)}"


def _chosen(comparisons: tuple[Comparison, ...]) -> list[Comparison]:
    if len(comparisons) <= MOST_PICTURES:
        return list(comparisons)
    ranked = sorted(comparisons, key=lambda each: -each.psnr_db)
    return [ranked[i] for i in np.linspace(0, len(ranked) - 1, MOST_PICTURES).round().astype(int)]


def _view(comparison: Comparison, kinds: tuple[str, str]) -> str:
    figures = f"PSNR {comparison.psnr_db:.2f} dB · SSIM {comparison.ssim:.3f}"
    figures += "" if comparison.lpips is None else f" · LPIPS {comparison.lpips:.3f}"
    sources = {
        kinds[0]: photograph(comparison.truth),
        kinds[1]: photograph(comparison.rendered),
        "difference": error_picture(comparison.error),
    }
    name = escape(comparison.name, quote=True)
    three = "".join(
        f'<figure><img src="{source}" alt="{name}, {kind}"><figcaption>{kind}</figcaption></figure>'
        for kind, source in sources.items()
    )
    return f'<section class="view"><h3>{name}<span>{figures}</span></h3><div class="three">{three}</div></section>\n'


def _table(comparisons: tuple[Comparison, ...]) -> str:
    with_lpips = any(each.lpips is not None for each in comparisons)
    titles = ["view", "PSNR (dB)", "SSIM", *(["LPIPS"] if with_lpips else []), "mean |difference|"]
    head = "".join(
        f'<th{_number_class(i)}><button type="button" title="Sort by this column">{escape(title)}</button></th>'
        for i, title in enumerate(titles)
    )
    rows = [_numbers(each, with_lpips) for each in comparisons]
    body = "".join(
        f"<tr><td>{escape(each.name)}</td>{''.join(_cell(value, digits) for value, digits in row)}</tr>"
        for each, row in zip(comparisons, rows, strict=True)
    )
    columns = zip(*rows, strict=True)
    means = "".join(_cell(_mean(value for value, _ in column), column[0][1]) for column in columns)
    foot = f"<tfoot><tr><td>mean</td>{means}</tr></tfoot>"
    return f'<table class="sortable"><thead><tr>{head}</tr></thead><tbody>{body}</tbody>{foot}</table>\n'


def _numbers(comparison: Comparison, with_lpips: bool) -> list[tuple[float, int]]:
    """Figures of a row, each with its decimals."""
    lpips = [(float("nan") if comparison.lpips is None else comparison.lpips, 4)] if with_lpips else []
    error = float(np.nanmean(comparison.error)) if np.isfinite(comparison.error).any() else float("nan")
    return [(comparison.psnr_db, 2), (comparison.ssim, 4), *lpips, (error, 4)]


def _cell(value: float, decimals: int) -> str:
    shown = "&ndash;" if np.isnan(value) else f"{value:.{decimals}f}"
    return f'<td class="number" data-value="{value}">{shown}</td>'


def _number_class(column: int) -> str:
    return ' class="number"' if column else ""


def _figure(figure: Figure) -> str:
    source = (photograph if figure.is_photograph else drawing)(figure.pixels)
    title, caption = escape(figure.title), escape(figure.caption)
    said = escape(figure.title, quote=True)
    return f'<h2>{title}</h2>\n<figure><img src="{source}" alt="{said}"><figcaption>{caption}</figcaption></figure>\n'


def _plain_table(table: ReportTable) -> str:
    words = [any(isinstance(row[i], str) for row in table.rows) for i in range(len(table.columns))]
    kinds = ["word" if each else "number" for each in words]
    head = "".join(
        f'<th class="{kind}"><button type="button" title="Sort by this column">{escape(each)}</button></th>'
        for each, kind in zip(table.columns, kinds, strict=True)
    )
    body = "".join(f"<tr>{''.join(_value(each, table.decimals) for each in row)}</tr>" for row in table.rows)
    caption = f'<p class="quiet">{escape(table.caption)}</p>\n' if table.caption else ""
    table_html = f'<table class="sortable"><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>\n'
    items = "".join(f"<li>{escape(each)}</li>" for each in table.definitions)
    definitions = f'<ul class="quiet">{items}</ul>\n' if items else ""
    return f"<h2>{escape(table.title)}</h2>\n{caption}{table_html}{definitions}"


def _value(value: str | float | None, decimals: int) -> str:
    if isinstance(value, str):
        return f'<td class="word">{escape(value)}</td>'
    number = float("nan") if value is None else float(value)
    return _cell(number, 0 if isinstance(value, int) else decimals)


_AXES = "".join(
    f'<input type="radio" class="axis-choice" name="axis" id="{key}"{state}><label for="{key}">{title}</label>'
    for key, state, title in (("by-step", " checked", "over steps"), ("by-time", "", "over time"))
)


def _charts(curves: tuple[Curve, ...]) -> str:
    choice = _AXES if any(curve.times_s is not None for curve in curves) else ""
    return f'<h2>Curves</h2>\n<div>{choice}<div class="charts">{"".join(map(_chart, curves))}</div></div>\n'


def _chart(curve: Curve) -> str:
    unit = f" <span>({escape(curve.unit)})</span>" if curve.unit else ""
    last = f" <span>· last {escape(number(float(curve.values[-1])))}</span>" if len(curve.values) else ""
    by_step = chart(curve.steps.astype(np.float64), curve.values, "step", curve.name, curve.is_logarithmic)
    if curve.times_s is None:
        return f'<section class="chart"><h3>{escape(curve.name)}{unit}{last}</h3>{by_step}</section>\n'
    in_minutes = len(curve.times_s) > 0 and curve.times_s.max() > 300
    times = curve.times_s / 60 if in_minutes else curve.times_s
    by_time = chart(times, curve.values, "minutes" if in_minutes else "seconds", curve.name, curve.is_logarithmic)
    both = f'<div class="over-steps">{by_step}</div><div class="over-time">{by_time}</div>'
    return f'<section class="chart"><h3>{escape(curve.name)}{unit}{last}</h3>{both}</section>\n'


def _timings(timings: Mapping[str, float]) -> str:
    longest, total = max(*timings.values(), 1e-9), sum(timings.values())
    rows = "".join(
        f'<tr><td>{escape(name)}</td><td class="number">{_duration(seconds)}</td>'
        f'<td><div class="bar"><i style="width:{100 * seconds / longest:.1f}%"></i></div></td></tr>'
        for name, seconds in timings.items()
    )
    foot = f'<tr><th>all</th><th class="number">{_duration(total)}</th><td></td></tr>'
    return f'<table class="timings"><tbody>{rows}{foot}</tbody></table>\n'


def _duration(seconds: float) -> str:
    if seconds < 60:
        return f"{seconds:.3g} s" if seconds < 9.95 else f"{seconds:.1f} s"
    minutes, rest = divmod(round(seconds), 60)
    return f"{minutes} min {rest:02d} s"


def _facts(facts: Mapping[str, object]) -> str:
    rows = (f"<tr><th>{escape(str(name))}</th><td>{escape(str(value))}</td></tr>" for name, value in facts.items())
    return f'<table class="facts"><tbody>{"".join(rows)}</tbody></table>'


def _mean(values: Iterable[float]) -> float:
    known = [value for value in values if not np.isnan(value)]
    return float(np.mean(known)) if known else float("nan")


def _part(name: str) -> str:
    return files("gsrain_engine.evaluate.report").joinpath(name).read_text(encoding="utf-8")
