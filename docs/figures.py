"""Writes the figures of pages that a command prints: python -m docs.figures. A test compares them."""

import json
import re
import shlex
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

from app.main import run

ROOT = Path(__file__).resolve().parents[1]
Numbers = dict[str, Any]


class Figure(NamedTuple):
    """A figure in the text of a page."""

    page: str
    place: str
    """Pattern of its place; the figure is the group."""
    text: Callable[[Numbers], str]
    """Figure from what the command writes by `--json`."""


def _rate(numbers: Numbers) -> str:
    return f"{numbers['measured_mm_h']:.2f} ± {numbers['standard_error_mm_h']:.2f}"


def _counted(numbers: Numbers) -> str:
    return f"{numbers['density_m3']:.0f}, {numbers['shape']:.2f}, {numbers['scale_mm']:.3g} mm"


def _paper_counted(numbers: Numbers) -> str:
    rate = f"carry {numbers['implied_mm_h']:.2f} mm/h; counted: {_rate(numbers).replace('±', '+-')} mm/h"
    return f"{rate}, {numbers['shape']:.2f}, {numbers['scale_mm']:.3f} mm, {numbers['density_m3']:.0f}"


def _visible(numbers: Numbers) -> str:
    (of,) = numbers["visible_distance"]
    size = f"960 x 640 (f = {of['focal_px']:.0f} px)"
    return f"{of['large_drop_m']:.2f} m at {size}, and haze beyond phi f D = {of['large_drop_haze_m']:.2f} m"


def _streaks(numbers: Numbers) -> str:
    *first, last = (f"{each['visible_streaks']:,}" for each in numbers["cells"])
    return f"{', '.join(first)} and {last}"


def _table_row(rate: str) -> tuple[Figure, ...]:
    return (
        Figure("docs/paper.md", rf"--preset {re.escape(rate)} --drop-density table`.*?counted: (.*?) \|", _counted),
    )


FIGURES: dict[str, tuple[Figure, ...]] = {
    "gsrain disdrometer --rain 8.5 --area 0.5 --seconds 60": (
        Figure("README.md", r"A virtual disdrometer checks it: (.*?) mm/h for 8\.5", _rate),
        Figure("README.md", r"gsrain disdrometer --rain 8\.5 --area 0\.5 --seconds 60 +# (.*?) mm/h", _rate),
    ),
    "gsrain disdrometer --preset paper --seconds 60": (
        Figure("docs/paper.md", r"set: the same, which (.*?) \|", _paper_counted),
    ),
    **{f"gsrain disdrometer --preset {rate} --drop-density table": _table_row(rate) for rate in ("1.2", "8.5", "12.0")},
    "gsrain render street --preset paper --backend cpu -o paper.png": (
        Figure("docs/paper.md", r"97\.5 % of the drops don't reach: (.*?); f D", _visible),
    ),
    "gsrain render street --sheet 1.2,8.5,12 --wet --backend cpu -o sheet.png": (
        Figure("docs/paper.md", r"\| ([\d,]+, [\d,]+ and [\d,]+) streaks can be seen", _streaks),
    ),
}
"""By the command that has their numbers; each says the same on every machine."""


def numbers_of(command: str, folder: Path) -> Numbers:
    """Run a command in a folder, where it leaves its output, and return its numbers."""
    words = [str(folder / word) if word.endswith(".png") else word for word in shlex.split(command)[1:]]
    if run([*words, "--json", str(folder / "numbers.json")]):
        raise RuntimeError(f"{command} has failed")
    return json.loads((folder / "numbers.json").read_text("utf-8"))


def written(figure: Figure) -> str:
    """Return a figure as its page has it. Raises `ValueError` unless its place is there once."""
    return _place(figure, (ROOT / figure.page).read_text("utf-8"))[1]


def _place(figure: Figure, text: str) -> re.Match[str]:
    found = list(re.finditer(figure.place, text))
    if len(found) != 1:
        raise ValueError(f"{figure.page}: {len(found)} places of {figure.place}")
    return found[0]


def main() -> None:
    """Write all figures."""
    for command, figures in FIGURES.items():
        with tempfile.TemporaryDirectory() as folder:
            numbers = numbers_of(command, Path(folder))
        for figure in figures:
            page = ROOT / figure.page
            text = page.read_text("utf-8")
            start, end = _place(figure, text).span(1)
            page.write_text(text[:start] + figure.text(numbers) + text[end:], "utf-8")
            print(f"{figure.page}: {figure.text(numbers)}")


if __name__ == "__main__":
    main()
