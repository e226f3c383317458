"""What checks arguments and array shapes while tests run: beartype, with an int accepted for a float as in PEP 484."""

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
    jaxtyping.jaxtyped = lambda *, typechecker: functools.partial(_checked_at_first, typechecker)


def _checked_at_first(typechecker, function_or_class):
    unchecked = function_or_class
    if not isinstance(unchecked, type):
        checked = _jaxtyped(unchecked, typechecker=typechecker)
        return _at_first(checked, unchecked) if isinstance(unchecked, FunctionType) else checked
    make = unchecked.__init__
    checked = _jaxtyped(unchecked, typechecker=typechecker)
    if checked.__init__ is not make:  # a dataclass
        checked.__init__ = _at_first(checked.__init__, make)
    return checked


def _at_first(checked, unchecked):
    test, calls = 0, 0

    @functools.wraps(checked)
    def called(*args, **kwargs):
        nonlocal test, calls
        if test != _present.test:
            test, calls = _present.test, 0
        calls += 1
        return (checked if calls <= CHECKED_CALLS else unchecked)(*args, **kwargs)

    return called
