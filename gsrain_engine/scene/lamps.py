"""Lamps of a scene: sources that light drops and medium, mounted on the scene, on its ego vehicle or on an actor."""

from collections.abc import Sequence
from typing import Annotated, NamedTuple

import numpy as np
from jaxtyping import Bool, Float64
from msgspec import Meta

from ..settings import Settings

Vector = tuple[float, float, float]
MAX_LAMPS = 64
"""Lamps that light a picture: the strongest at the camera."""


class Lamp(Settings, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A lamp with a cone of light."""

    name: str = ""
    position: Vector
    """In units and axes of the scene; of a mounted lamp, of its actor, or of the ego vehicle (meters, x forward)."""
    direction: Vector = (0.0, 0.0, -1.0)
    color: Annotated[tuple[float, float, float], Meta(description="Linear light; a factor on the intensity.")] = (
        1.0,
        1.0,
        1.0,
    )
    intensity_m2: Annotated[float, Meta(ge=0, le=1e9)] = 1.0
    """Irradiance times squared distance on the axis; a white wall under the irradiance pi is display white."""
    inner_deg: Annotated[float, Meta(ge=0, le=180)] = 180.0
    """Angle from the axis up to which the intensity is full."""
    outer_deg: Annotated[float, Meta(ge=0, le=180)] = 180.0
    """Angle from the axis beyond which there is no light; the cosine blends smoothly in between."""
    mount: str = "scene"
    """`scene`, `ego`, or the id of an actor."""

    def __post_init__(self) -> None:
        super().__post_init__()
        numbers = (*self.position, *self.direction, *self.color)
        if not np.isfinite(numbers).all() or not 1e-9 < np.linalg.norm(self.direction) < 1e9:
            raise ValueError(f"lamp {self.name!r} needs finite numbers and a direction")
        if min(self.color) < 0:
            raise ValueError(f"lamp {self.name!r}: color must not be negative, got {list(self.color)}")
        if self.inner_deg > self.outer_deg:
            raise ValueError(f"lamp {self.name!r}: inner_deg {self.inner_deg:g} is above outer_deg {self.outer_deg:g}")


class LitLamps(NamedTuple):
    """Lamps at one time, in the world (meters, z up)."""

    positions_m: Float64[np.ndarray, "n 3"]
    directions: Float64[np.ndarray, "n 3"]
    """Unit axes."""
    intensities: Float64[np.ndarray, "n 3"]
    """Linear light: on the axis, the irradiance at a distance d is I / d^2; pi on a white wall is display white."""
    cos_inner: Float64[np.ndarray, " n"]
    cos_outer: Float64[np.ndarray, " n"]
    """No light below; a smoothstep of the cosine leads to `cos_inner`."""

    def brightest(self, place: Float64[np.ndarray, "3"], count: int = MAX_LAMPS) -> "LitLamps":
        """Keep the lamps that are strongest at a place, in their order."""
        if len(self.positions_m) <= count:
            return self
        squared = np.sum((self.positions_m - place) ** 2, axis=1)
        chosen = np.sort(np.argsort(-self.intensities.sum(axis=1) / np.maximum(squared, 1.0), kind="stable")[:count])
        return LitLamps(*(each[chosen] for each in self))


def lit_lamps(placed: Sequence[tuple[Lamp, Float64[np.ndarray, "4 4"]]]) -> LitLamps:
    """Lamps in the world; each comes with the similarity from its mount to the world."""
    lamps = [lamp for lamp, _ in placed]
    poses = np.array([pose for _, pose in placed], np.float64).reshape(-1, 4, 4)
    own = np.array([lamp.position for lamp in lamps], np.float64).reshape(-1, 3)
    axes = np.array([lamp.direction for lamp in lamps], np.float64).reshape(-1, 3)
    colors = np.array([lamp.color for lamp in lamps], np.float64).reshape(-1, 3)
    turned = np.einsum("nij,nj->ni", poses[:, :3, :3], axes)
    cones = np.radians([(lamp.inner_deg, lamp.outer_deg) for lamp in lamps]).reshape(-1, 2)
    return LitLamps(
        np.einsum("nij,nj->ni", poses[:, :3, :3], own) + poses[:, :3, 3],
        turned / np.linalg.norm(turned, axis=1, keepdims=True),
        colors * np.array([lamp.intensity_m2 for lamp in lamps], np.float64)[:, None],
        np.cos(cones[:, 0]),
        np.cos(cones[:, 1]),
    )


# Lamps of streets

LANTERN_M2 = 250.0
"""Intensity of a lantern: an irradiance of 6 at its foot, of which asphalt returns a sixth of a camera's white."""
LANTERN_COLOR = (1.0, 0.66, 0.33)
LANTERN_INNER_DEG, LANTERN_OUTER_DEG = 48.0, 88.0
LANTERN_HEIGHT_M = 6.465
"""Height of a lantern's lamp over its foot."""
LAMP_REACH_M = 60.0
"""Maximum distance from a lantern to what it lights."""
SIGNAL_M2 = 12.0
"""Intensity of a signal of 200 mm, dimmed by night: 120 cd, with 10 cd for 1 m2."""
LEAF_SHARES = 0.15, 0.55, 0.24
"""Of the light on a leaf: what others scatter to it; and by the cosine, what it returns, and what comes through it."""


def facing_share(cosine: Float64[np.ndarray, " n"], leaf: Bool[np.ndarray, " n"]) -> Float64[np.ndarray, " n"]:
    """Cosine law; leaves let light through, and scatter it between them."""
    scattered, returned, through = LEAF_SHARES
    of_leaf = scattered + returned * np.maximum(cosine, 0) + through * np.maximum(-cosine, 0)
    return np.where(leaf, of_leaf, np.maximum(cosine, 0))
