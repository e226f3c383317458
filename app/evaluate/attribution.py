"""Shares of the factors of rain, printed as a table."""

from collections.abc import Sequence

from gsrain_engine.evaluation.attribution.factors import title_of
from gsrain_engine.evaluation.attribution.results import WHOLE, Attribution, Interval, method_of

from ..console import Console, table_of


def print_shares(found: Sequence[Attribution], console: Console) -> None:
    """Print a row per factor, and one for the whole effect, of each subject and intensity; objects are left out."""
    found = [each for each in found if each.measure.object is None]
    measures = list(dict.fromkeys(each.measure for each in found))
    columns = ",".join(["mm/h", *(text for each in measures for text in (each.title, "of it"))])
    table = table_of(f"{','.join(found[0].subject)},factor", columns, wraps=True)
    for title in dict.fromkeys(each.title for each in found):
        own = {each.measure: each for each in found if each.title == title}
        first = next(iter(own.values()))
        for name in (*first.factors, WHOLE):
            cells: list[str] = []
            for measure in measures:
                each = own.get(measure)
                share = Interval(0.0, 0.0, 0.0) if each is None else each.whole if name == WHOLE else each.shares[name]
                whole = 0.0 if each is None else each.whole.mean
                cells += [share.text, f"{100 * share.mean / whole:.0f} %"] if each is not None and whole else ["0", ""]
            label = WHOLE if name == WHOLE else title_of(name)
            rain = f"{first.intensity_mm_h:g}"
            table.add_row(*first.subject.values(), label, rain, *cells, end_section=name == WHOLE)
    console.print(table)
    console.print(f"{method_of(found)}Change from the clear scene, ± 95 % over the seeds.", style="dim")
