"""One rendered picture, as plain arrays."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32, UInt8

Color = tuple[float, float, float]
"""Red, green, blue as display values (sRGB-encoded), 0 to 1."""


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """A picture before it is brought to a screen: premultiplied display colour, nothing clamped."""

    rgba: Float32[np.ndarray, "h w 4"]
    """Premultiplied display colour (sRGB-encoded) and alpha, top row first."""
    depth: Float32[np.ndarray, "h w"] | None = None
    """Expected depth of the scene along the view axis in metres (rain left out); 0 where there is nothing."""

    def over(self, background: Color = (0.0, 0.0, 0.0)) -> Float32[np.ndarray, "h w 3"]:
        """Lay the picture over a plain background."""
        alpha = self.rgba[..., 3:]
        return self.rgba[..., :3] + (1 - alpha) * np.asarray(background, np.float32)

    def to_uint8(self, background: Color = (0.0, 0.0, 0.0)) -> UInt8[np.ndarray, "h w 3"]:
        """8-bit picture over a plain background, rounded to nearest."""
        shown = self.over(background)
        np.clip(shown, 0, 1, out=shown)  # in place: every video frame comes through here
        shown *= 255
        return np.rint(shown, out=shown).astype(np.uint8)
