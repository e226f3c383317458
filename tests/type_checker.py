"""Checks of arguments and array shapes while tests run: beartype, with an int accepted for a float as in PEP 484."""

import dataclasses
import functools
from types import FunctionType, SimpleNamespace

import jaxtyping
from beartype import BeartypeConf, beartype

CHECKED_CALLS = 10
"""So many calls of each function are checked in a test: later ones of a loop look alike, and checks take their time."""

check = beartype(conf=BeartypeConf(is_pep484_tower=True))
_jaxtyped = jaxtyping.jaxtyped
_present = SimpleNamespace(test=0)


def begin_test():
    """Check each function's calls anew."""
    _present.test += 1


def check_first_calls():
    """Let jaxtyping's import hook check the first calls of a function in each test, not all."""

    def jaxtyped(*context, typechecker=None):
        return _jaxtyped(*context) if context else functools.partial(_checked_at_first, typechecker)

    jaxtyping.jaxtyped = jaxtyped


def _checked_at_first(typechecker, decorated):
    if isinstance(decorated, FunctionType):
        return _at_first(typechecker, decorated)
    if not isinstance(decorated, type):
        return _jaxtyped(decorated, typechecker=typechecker)
    if dataclasses.is_dataclass(decorated) and "__init__" in vars(decorated):
        decorated.__init__ = _at_first(typechecker, decorated.__init__)
    return decorated


def _at_first(typechecker, function):
    checked, test, calls = None, 0, 0

    @functools.wraps(function)
    def called(*args, **kwargs):
        nonlocal checked, test, calls
        if test != _present.test:
            test, calls = _present.test, 0
        calls += 1
        if calls > CHECKED_CALLS:
            return function(*args, **kwargs)
        if checked is None:  # making it takes longer than most of what it checks
            checked = _jaxtyped(function, typechecker=typechecker)
        return checked(*args, **kwargs)

    return called
