"""How far a background job has come: the one thing that jobs say while they work."""

from typing import NamedTuple

import numpy as np
from jaxtyping import UInt8


class Progress(NamedTuple):
    """One step of a job; a job may be stopped wherever it yields one."""

    fraction: float
    """Work done so far, 0 to 1, never falling."""
    message: str
    """What is being done, for a person to read."""
    preview: UInt8[np.ndarray, "h w 3"] | None = None
    """A small picture of how it goes; of several, the newest is shown."""
