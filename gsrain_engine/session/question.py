"""What the session asks a person, and what happens on each answer."""

from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True)
class Answer:
    """One button."""

    label: str
    run: Callable[[], None]
    help: str = ""
    """One sentence: what happens then."""


@dataclass(frozen=True)
class Question:
    """A question that has to be answered before anything else."""

    title: str
    text: str
    answers: tuple[Answer, ...]
    """The first is what Enter means, the last, which changes nothing, what Escape means."""


def nothing() -> None:
    """Do nothing: what Cancel means."""
