"""The checkout that is tested."""

import ast
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parent.parent


def is_compiled(function: ast.FunctionDef | ast.AsyncFunctionDef) -> bool:
    """Return whether Numba compiles a function: as a kernel, or as a part of some."""
    return any(ast.unparse(each).startswith(("kernel(", "numba.njit(")) for each in function.decorator_list)
