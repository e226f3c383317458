"""Kernels find no index outside of an array, whatever their numbers are: NaN, infinity, 0, 1e308."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from repository import REPOSITORY, is_compiled

_COMPILED = re.compile(r"^@(kernel|numba\.njit)\(", re.MULTILINE)
_FILES = sorted(file for file in (REPOSITORY / "gsrain_engine").rglob("*.py") if _COMPILED.search(file.read_text()))
_TO_INTEGER = {"int", "np.int32", "np.int64", "np.uint32", "np.uint64"}
_NO_NUMBERS_OF_DATA = {"len", "range"}


def _kernels(file: Path) -> Iterator[ast.FunctionDef]:
    for node in ast.walk(ast.parse(file.read_text())):
        if isinstance(node, ast.FunctionDef) and is_compiled(node):
            yield node


def _assigned(kernel: ast.FunctionDef) -> dict[str, list[ast.expr]]:
    """Values that a kernel gives its names."""
    found: dict[str, list[ast.expr]] = {}
    for node in ast.walk(kernel):
        if isinstance(node, ast.For):  # over whole numbers
            pairs = [(node.target, ast.Constant(0))]
        elif isinstance(node, ast.Assign):
            pairs = [(target, node.value) for target in node.targets]
        else:
            continue
        for target, value in pairs:
            if isinstance(target, ast.Tuple) and isinstance(value, ast.Tuple):
                pairs += zip(target.elts, value.elts, strict=True)
            elif isinstance(target, ast.Name):
                found.setdefault(target.id, []).append(value)
    return found


def _clamps(value: ast.expr, names: dict[str, list[ast.expr]], depth: int = 0) -> list[ast.Call]:
    """Calls of min and max that decide a value, those of the names in it included."""
    if isinstance(value, ast.Name) and depth < 2:
        return [clamp for each in names.get(value.id, ()) for clamp in _clamps(each, names, depth + 1)]
    if isinstance(value, ast.Call) and ast.unparse(value.func) in ("min", "max"):
        return [value]
    if isinstance(value, ast.BinOp):
        return [*_clamps(value.left, names, depth), *_clamps(value.right, names, depth)]
    if isinstance(value, ast.Call) and ast.unparse(value.func) not in _TO_INTEGER | _NO_NUMBERS_OF_DATA:
        return [clamp for each in value.args for clamp in _clamps(each, names, depth)]
    return []


def _may_be_nan(value: ast.expr, names: dict[str, list[ast.expr]]) -> bool:
    """Return whether a value may be NaN, as far as one sees: min(a, b) and max(a, b) are a where b is NaN."""
    if isinstance(value, ast.Constant):
        return False
    if isinstance(value, ast.Call):
        called = ast.unparse(value.func)
        if called in ("min", "max"):
            return _may_be_nan(value.args[0], names)
        return called not in _NO_NUMBERS_OF_DATA and any(_may_be_nan(each, names) for each in value.args)
    if isinstance(value, ast.BinOp):
        return _may_be_nan(value.left, names) or _may_be_nan(value.right, names)
    if isinstance(value, ast.UnaryOp):
        return _may_be_nan(value.operand, names)
    if isinstance(value, ast.Name) and value.id.isupper():
        return False
    if isinstance(value, ast.Name) and value.id in names:
        return any(_may_be_nan(each, {}) for each in names[value.id])
    return ".shape[" not in ast.unparse(value)


def _loses_bound(clamp: ast.expr, names: dict[str, list[ast.expr]]) -> bool:
    """Return whether a bound does not hold for NaN, since it comes second."""
    if not isinstance(clamp, ast.Call) or ast.unparse(clamp.func) not in ("min", "max"):
        return False
    value, bound = clamp.args
    return _loses_bound(value, names) or (_may_be_nan(value, names) and not _may_be_nan(bound, names))


@pytest.mark.parametrize("file", _FILES, ids=lambda file: str(file.relative_to(REPOSITORY / "gsrain_engine")))
def test_bounds_of_an_index_hold_for_nan_too(file):
    """`max(0, x)` is 0 where x is NaN; `max(x, 0)` is NaN, and its integer outside of any array."""
    wrong = []
    for kernel in _kernels(file):
        names = _assigned(kernel)
        for node in ast.walk(kernel):
            if isinstance(node, ast.Call) and ast.unparse(node.func) in _TO_INTEGER and node.args:
                for clamp in _clamps(node.args[0], names):
                    if _loses_bound(clamp, names):
                        wrong.append(f"{kernel.name}, line {node.lineno}: {ast.unparse(clamp)}")
    assert not wrong, "the bound comes first: " + "; ".join(dict.fromkeys(wrong))
