"""Many names in one sentence: what is wrong with several files or views, without a page of lines."""

from collections.abc import Sequence

_AT_MOST = 3


def some_names(names: Sequence[str]) -> str:
    """Return the first few names and how many there are more: "a, b, c and 4 more"."""
    more = len(names) - _AT_MOST
    return ", ".join(names[:_AT_MOST]) + (f" and {more} more" if more > 0 else "")
