"""Values compared by identity, and what is found for scenes once and kept until another scene is opened."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, ParamSpec, TypeVar

_Parameters = ParamSpec("_Parameters")
_Result = TypeVar("_Result")
_CACHES: list[Any] = []


@dataclass(frozen=True, slots=True, eq=False)
class Identity:
    """Equal to another one exactly where both hold the very same object; holds on to it, so that its id stays taken."""

    of: object

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Identity) and self.of is other.of

    def __hash__(self) -> int:
        return id(self.of)


def scene_cache(maxsize: int) -> Callable[[Callable[_Parameters, _Result]], Callable[_Parameters, _Result]]:
    """Decorate a function of scenes, or of Gaussians: its last `maxsize` results are kept until `forget_scenes`."""

    def decorate(function: Callable[_Parameters, _Result]) -> Callable[_Parameters, _Result]:
        cached = lru_cache(maxsize)(function)
        _CACHES.append(cached)
        return cached  # pyright: ignore[reportReturnType]

    return decorate


def forget_scenes() -> None:
    """Let go of all that `scene_cache` keeps: results hold on to the scenes that they were found for."""
    for each in _CACHES:
        each.cache_clear()
