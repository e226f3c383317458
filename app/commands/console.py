"""A console for tables of names: nothing in it is cut or folded, however narrow the terminal says it is."""

from rich.console import Console

_COLUMNS = 100_000
"""More than any table of names has: rich cuts what is wider than its console."""


def wide_console() -> Console:
    """Return a console that prints names whole and as they are; lines longer than the terminal are for it to wrap."""
    return Console(soft_wrap=True, highlight=False, markup=False, width=_COLUMNS)
