"""What a single-file scene format is."""

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from ..gaussians import Gaussians


class Format(NamedTuple):
    """A way to keep Gaussians in one file."""

    suffix: str
    """End of the file's name, in lower case; the first row that matches counts."""
    read: Callable[[Path], Gaussians]
    write: Callable[[Gaussians, Path], None] | None
    """Writes to just this path, which is beside the file's place; None where we only read."""
    description: str
    keeps_harmonics: bool = True
    """Whether colours may depend on the direction that they are seen from."""
