"""Whether torch is there, which heavy jobs need and which is an extra: asked without loading it."""

from functools import cache
from importlib.util import find_spec

HOW_TO_GET_TORCH = "pip install 'gsrain[jobs]'"
HOW_TO_GET_DIFFUSION = "pip install 'gsrain[diffusion]'"
"""Torch, and what a diffusion model takes besides."""


@cache
def has_torch() -> bool:
    return find_spec("torch") is not None


def require_torch(what: str, how: str = HOW_TO_GET_TORCH) -> None:
    """Raise ValueError, which says that `what` needs torch and how to get it, where it is missing."""
    if not has_torch():
        raise ValueError(f"{what} needs torch, which is not installed: {how}")
