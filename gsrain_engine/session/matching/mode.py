"""What is shown of a match: the other view as seen from here, the difference, or what became of each pixel."""

from typing import Literal, get_args

Mode = Literal["picture", "difference", "pixels"]
MODES: tuple[Mode, ...] = get_args(Mode)
