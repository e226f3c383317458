"""What a data set reader returns: pictures, the cameras that took them, and what else is known about each."""

from collections.abc import Iterator
from dataclasses import dataclass, fields

import numpy as np
from jaxtyping import Bool, Float32, Float64, UInt8

from gsrain_engine.scene.camera import Camera


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """One picture of a capture, with its camera in the world (metres, z up)."""

    name: str
    camera: Camera
    image: UInt8[np.ndarray, "h w 3"]
    """Display colour (sRGB)."""
    time_s: float = 0.0
    depth: Float32[np.ndarray, "h w"] | None = None
    """Metres along the view axis at pixel centres; 0 where nothing was measured (the sky)."""
    normals: Float32[np.ndarray, "h w 3"] | None = None
    """Unit surface normals in the world, towards the camera; 0 where there is none."""
    labels: UInt8[np.ndarray, "h w"] | None = None
    """Semantic classes; 0 where there is none."""
    mask: Bool[np.ndarray, "h w"] | None = None
    """Which pixels show the static scene and may be learned from; None means all."""

    def __post_init__(self) -> None:
        size = (self.camera.height, self.camera.width)
        for name in ("image", "depth", "normals", "labels", "mask"):
            array = getattr(self, name)
            if array is not None and array.shape[:2] != size:
                raise ValueError(f"view {self.name!r}: {name} is {array.shape[:2]}, its camera says {size}")


@dataclass(frozen=True, slots=True, eq=False)
class Capture:
    """Views of one place. Treat the arrays as values: nobody writes into them."""

    name: str
    views: tuple[View, ...]
    points_m: Float64[np.ndarray, "p 3"] | None = None
    """Points on surfaces (lidar, COLMAP) in the world, where the data set has them."""
    point_colors: UInt8[np.ndarray, "p 3"] | None = None
    """Display colour of each point."""

    def __post_init__(self) -> None:
        names = [view.name for view in self.views]
        doubled = {name for name in names if names.count(name) > 1}
        if doubled:
            raise ValueError(f"capture {self.name!r} has several views named {sorted(doubled)[0]!r}")

    def __len__(self) -> int:
        return len(self.views)

    def __iter__(self) -> Iterator[View]:
        return iter(self.views)

    def __getitem__(self, index: int) -> View:
        return self.views[index]

    @property
    def has(self) -> frozenset[str]:
        """Which optional fields every view has: depth, normals, labels, mask."""
        optional = [f.name for f in fields(View) if f.name in ("depth", "normals", "labels", "mask")]
        return frozenset(name for name in optional if all(getattr(view, name) is not None for view in self.views))
