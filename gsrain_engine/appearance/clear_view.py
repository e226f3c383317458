"""A view before its transfer: the picture, and what is known about each pixel. World frame (metres, z up)."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32

from gsrain_engine.scene.camera import Camera

_LEAST_KNOWN = 0.5
"""Of the depth below the sky: a lidar's beams reach 0.7 and more, a few thousand triangulated points 0.2 to 0.4."""


@dataclass(frozen=True, slots=True, eq=False)
class ClearView:
    """One picture in dry weather. Treat the arrays as values: nobody writes into them."""

    name: str
    camera: Camera
    """In the world; without lens distortion, of the picture's size."""
    time_s: float
    image: Float32[np.ndarray, "h w 3"]
    """Display colour (sRGB), 0..1."""
    depth: Float32[np.ndarray, "h w"]
    """Metres along the view axis at pixel centres; 0 where it is not known, and in the sky."""
    normals: Float32[np.ndarray, "h w 3"]
    """Unit surface normals in the world, towards the eye; 0 where they are not known."""
    sky: Float32[np.ndarray, "h w"]
    """Share of sky, 0..1."""
    vehicles: Float32[np.ndarray, "h w"]
    """Share of vehicles, 0..1; 0 where it is not known."""
    sensor: str = ""
    """Which camera of a rig it is; empty where there is only one."""
    has_pose: bool = True
    """Whether it is known where the camera stood: only then can other views show the same place."""

    known_share: float = 1.0
    """Part of the picture below the sky whose depth was measured or drawn; the rest of the depth is a guess."""

    @property
    def has_surfaces(self) -> bool:
        """Whether it is known what is where: else road, car and wall can't be told apart."""
        return self.known_share >= _LEAST_KNOWN and self.has_depth

    @property
    def has_depth(self) -> bool:
        """Whether the distance of any pixel is known."""
        return bool((self.depth > 0).any())

    def __post_init__(self) -> None:
        size = (self.camera.height, self.camera.width)
        for name in ("image", "depth", "normals", "sky", "vehicles"):
            if (found := getattr(self, name).shape[:2]) != size:
                raise ValueError(f"view {self.name!r}: {name} is {found}, its camera says {size}")
