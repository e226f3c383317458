"""News of this version in a few lines: the group "In short" of the newest section of CHANGELOG.md."""

from typing import NamedTuple

from ..presets import shipped_path

_GROUP = "In short"


class News(NamedTuple):
    """Changes of a version."""

    heading: str
    """Version and date, or "Unreleased"."""
    lines: tuple[str, ...]
    """Plain sentences."""


def read_news() -> News:
    """Read the changes; raises `OSError` if their file is missing."""
    return news_in(shipped_path("CHANGELOG.md").read_text("utf-8"))


def news_in(changes: str) -> News:
    """Return the group "In short" of the first section of a list of changes; no lines if it has none."""
    section = changes.partition("\n## ")[2].partition("\n## ")[0]
    heading, _, text = section.partition("\n")
    items = text.partition(f"\n{_GROUP}\n")[2].partition("\n\n")[0].split("\n* ")
    lines = (" ".join(each.removeprefix("* ").split()).replace("*", "").replace("`", "") for each in items)
    return News(heading.strip(), tuple(filter(None, lines)))
