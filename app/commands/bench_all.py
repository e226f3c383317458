"""`gsrain bench`: all that there is to time, on two scenes."""

from contextlib import redirect_stdout
from typing import Annotated

from cyclopts import Parameter

from .arguments import JsonFileOrScreen, words_go_to, write_numbers


def bench_all(
    *,
    scenes: Annotated[
        str,
        Parameter(help="Names with commas between: random-200k (SH degree 0), random-3m (degree 3), street, or files."),
    ] = "random-200k,street",
    json: JsonFileOrScreen = None,
) -> None:
    """Time this machine: frames in rain and without, loading, recolouring. The commands time one, with options."""
    from .outputs import check_writable

    check_writable(json)
    from .bench import render  # the engine loads only for this
    from .bench_loading import loading
    from .bench_recoloring import recoloring

    with redirect_stdout(words_go_to(json)):
        numbers = {
            "render": render(scenes=scenes),
            "loading": loading(scenes=scenes),
            "recoloring": recoloring(scenes=scenes),
        }
    write_numbers(json, numbers)
