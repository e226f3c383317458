"""Writes the tables of pages that are made from the program: python -m docs.tables. A test compares them."""

import re
from collections.abc import Callable
from pathlib import Path

from app.main import app, benchmarks, evaluations, view
from docs import api_page
from gsrain_engine import plugins
from gsrain_engine.plugins import EntryPointGroup, find_extensions
from gsrain_engine.scene.formats import FORMATS, Format
from ui.commands.table import BENCHMARKS, EVALUATIONS, SHELL_COMMANDS
from ui.panels.registry import BUILT_IN_PANELS, DockSide, Panel

DOCS = Path(__file__).resolve().parent
_TABLES = re.compile(r"(?<=<!-- tables -->\n).*?(?=<!-- end of tables -->)", re.DOTALL)
_SIDES: dict[DockSide, str] = {
    "left": "## Left: the scene",
    "left bottom": "Below them, what is done with a part of it:",
    "right": "## Right: rain, and the work on the scene",
    "right bottom": "Below them, the rain in numbers, and the vehicle's cameras:",
    "bottom": "## Bottom: time",
}


def formats() -> str:
    """Return the table of scene formats, with those that this program adds as extensions."""
    known = *FORMATS, *(each.load(Format) for each in find_extensions(plugins.SCENE_FORMATS) if each.is_own)
    rows = [f"| `{each.suffix}` | {'yes' if each.write else 'no'} | {each.description} |" for each in known]
    return "\n".join(["", "| file | written | contents |", "|---|---|---|", *rows, "", ""])


def commands() -> str:
    """Return the table of all commands, each with its sentence of the help."""
    rows = [("gsrain [SCENE]", (view.__doc__ or "").strip())]
    rows += [(f"gsrain {name}", summary) for name, (_, summary) in SHELL_COMMANDS.items()]
    rows += [(f"gsrain {name}", summary) for name, summary in _extras(plugins.COMMANDS).items()]
    compared = {name: summary for name, (_, summary) in EVALUATIONS.items()} | _extras(plugins.EVALUATIONS)
    timed = {name: summary for name, (_, summary) in BENCHMARKS.items()}
    for group, members in ((evaluations, compared), (benchmarks, timed)):
        rows.append((f"gsrain {group.name[0]}", group.help))
        rows += [(f"gsrain {group.name[0]} {name}", summary) for name, summary in members.items()]
    lines = [f"| `{command}` | {summary.partition(chr(10) * 2)[0]} |" for command, summary in rows]
    return "\n".join(["", "| command | does |", "|---|---|", *lines, "", ""])


def _extras(point: EntryPointGroup) -> dict[str, str]:
    """Return the commands of this program's plug-ins, each with its sentence of the help."""
    return {each.name: each.summary for each in find_extensions(point) if each.package == app.name[0]}


def panels() -> str:
    """Return the panels of each side of the window in two columns; in one at the bottom, where they are wide."""
    parts: list[str] = []
    for side, heading in _SIDES.items():
        there = [each for each in BUILT_IN_PANELS if each.side == side]
        columns = 1 if side == "bottom" else 2
        parts += ["", heading]
        for start in range(0, len(there), columns):
            row = there[start : start + columns]
            cells = [[_picture(each) for each in row], ["---"] * len(row), [_described(each) for each in row]]
            parts += ["", *(f"| {' | '.join(line)} |" for line in cells)]
    return "\n".join([*parts, "", ""])


def _picture(panel: Panel) -> str:
    file = f"images/panel_{panel.title.lower().replace(' ', '_')}.jpg"
    return f"![{panel.title}](../{file})" if (DOCS / file).is_file() else ""


def _described(panel: Panel) -> str:
    return f"**{panel.title}.** {panel.help} [More]({panel.page})"


PAGES: dict[str, Callable[[], str]] = {
    "../README.md": commands,
    "formats.md": formats,
    "guide/panels.md": panels,
    "python.md": api_page.tables,
}


def updated(page: str) -> str:
    """Return the text of a page with its tables anew."""
    return _TABLES.sub(lambda _: PAGES[page](), (DOCS / page).read_text(encoding="utf-8"))


if __name__ == "__main__":
    for name in PAGES:
        (DOCS / name).write_text(updated(name), encoding="utf-8")
        print(f"wrote {DOCS / name}")
