"""The command line: which commands there are, and how bad input ends (one line, exit code 2)."""

import logging
import sys
from importlib import metadata

from cyclopts import App, CycloptsError
from rich.console import Console

from gsrain_engine.scene.errors import SceneFormatError

from .commands.convert import convert
from .commands.doctor import doctor
from .commands.info import info
from .commands.render import render
from .commands.street import street
from .commands.view import view

BAD_INPUT, INTERRUPTED = 2, 130

app = App(
    name="gsrain",
    help="Calibrated rain in captured 3D Gaussian Splatting scenes. Without a command: open the window.",
    version=metadata.version("gsrain"),
    help_format="plaintext",
)
app.default(view)
for command in (render, info, convert, street, doctor):
    app.command(command)


def run(arguments: list[str]) -> int:
    """Run one command; returns the exit code."""
    logging.basicConfig(level=logging.INFO, format="%(message)s", stream=sys.stderr)
    errors = Console(stderr=True, soft_wrap=True, highlight=False, markup=False)
    try:
        code = app(arguments, exit_on_error=False, print_error=False, result_action="return_value")
    except CycloptsError as error:
        errors.print(f"gsrain: {_one_line(str(error))}")
        return BAD_INPUT
    except (SceneFormatError, ValueError, OSError, MemoryError) as error:
        errors.print(f"gsrain: {_one_line(str(error))}")
        return BAD_INPUT
    except KeyboardInterrupt:
        errors.print("gsrain: stopped")
        return INTERRUPTED
    return code if isinstance(code, int) else 0


def _one_line(message: str) -> str:
    return " ".join(message.split())
