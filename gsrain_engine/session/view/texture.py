"""A picture that the window has on the GPU, for panels to show."""

from typing import NamedTuple


class Texture(NamedTuple):
    """First row on top."""

    name: int
    """What OpenGL calls it."""
    width: int
    height: int
