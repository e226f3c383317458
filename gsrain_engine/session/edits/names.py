"""Names of members: no two layers share one, nor do two actors."""

import re
from collections.abc import Collection


def unique_name(name: str, taken: Collection[str]) -> str:
    """Return `name`, or with the first number that makes it unique: "road", "road 2", "road 3"."""
    if name not in taken:
        return name
    stem = re.sub(r" \d+$", "", name) or name
    number = 2
    while f"{stem} {number}" in taken:
        number += 1
    return f"{stem} {number}"
