"""What every back end does: draw scene and rain, hand out the picture."""

import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float32, UInt8

from ..rain.simulation import RainFrame
from ..scene.camera import Camera
from ..scene.scene import DrawItem

# § Ways to look into a scene: its picture, or what the picture is made of.

RenderMode = Literal["splats", "points", "ellipsoids", "depth", "normals", "opacity", "overdraw", "layers"]
"""
splats: the picture. All others show the scene alone, without rain:
points: each Gaussian an opaque dot of one pixel's standard deviation, in its own colour;
ellipsoids: the surface on which a Gaussian's alpha is 1/4, solid and shaded like a ball;
depth: expected depth as a heat colour of its logarithm, `NEAREST_M` to `FARTHEST_M`;
normals: each Gaussian's shortest axis, turned to the camera, as the colour 0.5 + 0.5 n of world axes;
opacity: each Gaussian's largest alpha, 0 to 1, as a heat colour;
overdraw: how many fragments a pixel is made of, 0 to `MAX_FRAGMENTS`, as a heat colour;
layers: each layer and actor in a colour of its own.
"""

# § What the last frame was made of, and how long each stage of it took.


@dataclass(slots=True)
class RenderStatistics:
    """What the last frame was made of."""

    gaussians: int = 0
    splats_drawn: int = 0
    drops_drawn: int = 0
    """Drops that became streaks; each is one to four Gaussians."""
    haze_drawn: int = 0
    """Haze Gaussians that were handed to the renderer."""
    stages_ms: dict[str, float] = field(default_factory=dict[str, float])
    """Wall time a stage: project, sort, draw (GPU work included, since each stage waits for its result)."""


# § One rendered picture, as plain arrays.

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


@runtime_checkable
class Renderer(Protocol):
    """Draws one picture at a time. `SplatRenderer` does it with OpenGL, `CpuRenderer` without."""

    @property
    def name(self) -> str:
        """What this back end is called on the command line."""
        ...

    @property
    def statistics(self) -> RenderStatistics:
        """What the last picture was made of."""
        ...

    def draw(
        self,
        parts: Sequence[DrawItem],
        camera: Camera,
        rain: RainFrame | None = None,
        *,
        with_depth: bool = False,
        look: RenderMode = "splats",
    ) -> None:
        """Draw parts and rain as one depth-ordered compositing; `read` hands out the picture.

        `camera` is in the world (metres). Depth is the scene's own: rain takes no part in it. `look` shows something
        else than the picture, without rain.
        """
        ...

    def read(self) -> Frame:
        """Hand out the last picture, with depth if it was drawn."""
        ...


NEAREST_M, FARTHEST_M = 0.5, 200.0
"""Ends of the depth's colours: of small captures and of streets each octave has a colour of its own."""

MAX_FRAGMENTS = 256
"""Upper end of the colours of overdraw."""


class Stopwatch:
    """Adds the wall time of a `with` block to a stage, in milliseconds."""

    def __init__(self, stages: dict[str, float], stage: str) -> None:
        self._stages, self._stage = stages, stage

    def __enter__(self) -> None:
        self._start = time.perf_counter()

    def __exit__(self, *_: object) -> None:
        self._stages[self._stage] += 1000 * (time.perf_counter() - self._start)
