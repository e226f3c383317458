"""Asks a person whether Python code that a file names may run; the answer is remembered by its content."""

import sys
from collections.abc import Callable
from typing import Annotated, TypeVar

from cyclopts import Parameter

from gsrain_engine.scene.trusted_code import Code, UntrustedCodeError, remember
from gsrain_engine.scene.trusted_code import trust as trust_now

from ..console import print

_Result = TypeVar("_Result")

Trust = Annotated[
    bool,
    Parameter(
        help="Run Python code that the file names (agents, programs of estimators) without asking. It can do all that "
        "you can: look at it before.",
        negative="",
    ),
]


def with_trust(load: Callable[[], _Result], trust: bool) -> _Result:
    """Return what `load` returns, and let a person decide where it meets Python code that nobody has allowed.

    With `trust` such code may run this time. Else a person in a terminal is asked, and his yes is remembered for this
    very content. Raises `UntrustedCodeError` where there is nobody to ask, or the answer is no.
    """
    try:
        return load()
    except UntrustedCodeError as error:
        if trust:
            trust_now(each.digest for each in error.codes)
        elif _is_allowed(error):
            remember(error.codes)
        else:
            raise
    return load()


def _is_allowed(error: UntrustedCodeError) -> bool:
    """Ask a person in a terminal; the default is no."""
    if not all(stream is not None and stream.isatty() for stream in (sys.stdin, sys.stderr)):  # pyright: ignore
        return False
    print(f"{error.named_by} names Python code, which would run with all your rights:", file=sys.stderr)
    for code in error.codes:
        print(f"  {_described(code)}", file=sys.stderr)
    print("Run it? The answer is remembered for these very contents. [y/N]", file=sys.stderr)
    return sys.stdin.readline().strip().lower() in ("y", "yes")


def _described(code: Code) -> str:
    others = code.others
    listed = ", ".join(others[:4]) + (f" and {len(others) - 4} more" if len(others) > 4 else "")
    return f"{code.path} (SHA-256 {code.digest})" + (f", with {listed}" if others else "")
