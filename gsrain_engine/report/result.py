"""Result of a job: what it has made, and its numbers as a table, a figure and files."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Generic, TypeVar

import numpy as np
from jaxtyping import UInt8
from PIL import Image

from ..safe_io.files import whole_file
from .numbers import write_json
from .page import ReportFigure, RunReport, write_report
from .table import Table

Made = TypeVar("Made")


@dataclass(frozen=True, eq=False, kw_only=True)
class RunResult(Generic[Made]):
    """Product of a job, and its numbers."""

    made: Made
    """Such as a scene, or the path of a file or folder."""
    table: Table
    numbers: Mapping[str, Any]
    """Values for JSON."""
    lines: tuple[str, ...] = ()
    """Sentences about it."""
    draw: Callable[[], UInt8[np.ndarray, "h w 3"]] = field(repr=False)
    """Draws the figure."""
    page: RunReport | None = field(default=None, repr=False)
    """Report of the run; None makes one of the table and the figure."""

    @property
    def figure(self) -> Image.Image:
        """An image of what was made; drawn anew each time."""
        return Image.fromarray(self.draw())

    def save(self, folder: Path | str) -> list[str]:
        """Write table.csv, figure.png, numbers.json and report.html into a folder; returns these names."""
        place = Path(folder)
        place.mkdir(parents=True, exist_ok=True)
        figure = self.figure
        self.table.write_csv(place / "table.csv")
        with whole_file(place / "figure.png") as partial:
            figure.save(partial, "png")
        write_json(place / "numbers.json", self.numbers)
        drawn = ReportFigure(self.table.title, np.asarray(figure), is_photograph=True)
        page = self.page or RunReport(self.table.title, {}, figures=(drawn,), notes=self.lines, tables=(self.table,))
        write_report(place / "report.html", page)
        return ["table.csv", "figure.png", "numbers.json", "report.html"]
