"""Shares of the factors of rain, printed as a table."""

from collections.abc import Mapping, Sequence
from typing import Any

from gsrain_engine.evaluation.attribution.factors import title_of
from gsrain_engine.evaluation.attribution.results import WHOLE, method_of

from ..console import Console, table_of

_MAX_MEASURES = 3


def print_shares(found: Sequence[Mapping[str, Any]], subject: Sequence[str], console: Console) -> None:
    """Print the shares of the first three measures: for each subject and intensity a row per factor, then the whole.

    `found` are attributions as in JSON, `subject` the names of their columns that say what was measured; objects are
    left out.
    """
    groups: dict[tuple[str, ...], dict[str, Mapping[str, Any]]] = {}
    for each in found:
        if each["object"] is None:
            key = *(str(each[name]) for name in subject), f"{each['intensity_mm_h']:g}"
            groups.setdefault(key, {})[each["title"]] = each
    measures = list(dict.fromkeys(title for own in groups.values() for title in own))[:_MAX_MEASURES]
    columns = [column for title in measures for column in (f"change of {title}", "of it")]
    table = table_of(",".join((*subject, "factor")), ",".join(("mm/h", *columns)), wraps=True)
    for key, own in groups.items():
        factors = [share["factor"] for share in next(iter(own.values()))["shares"]]
        for number, title in enumerate((*map(title_of, factors), WHOLE)):
            cells: list[str] = []
            for measure in measures:
                each = own.get(measure)
                rows = [] if each is None else [*each["shares"], each["whole"] | {"part_of_whole": 1.0}]
                share = rows[number] if rows else None
                cells += ["", ""] if share is None else [_interval(share), _part(share["part_of_whole"])]
            table.add_row(*key[:-1], title, key[-1], *cells, end_section=title == WHOLE)
    console.print(table)
    console.print(f"{method_of(found[0])}Changes from the clear scene, ± 95 % over the seeds.", style="dim")


def _interval(share: Mapping[str, float | None]) -> str:
    mean, low, high = share["mean"], share["low"], share["high"]
    return f"{mean:+.3f}" if low is None or high is None else f"{mean:+.3f} ±{(high - low) / 2:.3f}"


def _part(part: float | None) -> str:
    return f"{100 * part:.0f} %" if part else ""
