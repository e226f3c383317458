"""Interfaces of appearance transfer: clear views, rainy views, the transfer protocol and its settings."""

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float32, UInt8
from msgspec import Struct, structs

from ..scene.camera import Camera
from .settings import TransferSettings

Image = Float32[np.ndarray, "h w 3"]
Plane = Float32[np.ndarray, "h w"]

# Views. World frame (meters, z up).


@dataclass(frozen=True, slots=True, eq=False)
class ClearView:
    """Image of a dry scene with its per-pixel geometry. The arrays are never written to."""

    name: str
    camera: Camera
    """World frame; no lens distortion; same size as the image."""
    time_s: float
    image: Image
    """Display color (sRGB), 0..1."""
    depth: Plane
    """Meters along the view axis at pixel centers; 0 in the sky and at unknown pixels."""
    normals: Image
    """Unit surface normals in the world, towards the eye; 0 at unknown pixels."""
    sky: Plane
    """Share of sky, 0..1."""
    vehicles: Plane
    """Share of vehicles, 0..1; 0 at unknown pixels."""
    sensor: str = ""
    """Camera name within a rig; empty for a single camera."""
    has_pose: bool = True
    """True if the camera pose is known; other views can only be matched to this one with a pose."""
    known_share: float = 1.0
    """Share of the image below the sky whose depth was measured or rendered; the rest of the depth is estimated."""

    @property
    def has_surfaces(self) -> bool:
        """True if enough depth is known to distinguish road, cars and walls.

        Lidar reaches a share of 0.7 and more, a few thousand triangulated points 0.2 to 0.4.
        """
        return self.known_share >= 0.5 and bool((self.depth > 0).any())

    def __post_init__(self) -> None:
        size = (self.camera.height, self.camera.width)
        for name in ("image", "depth", "normals", "sky", "vehicles"):
            if (found := getattr(self, name).shape[:2]) != size:
                raise ValueError(f"view {self.name!r}: {name} is {found}, its camera says {size}")


class NetworkInput(Struct, frozen=True, kw_only=True, omit_defaults=True):
    """Size, framing and guide of a network's input for one view."""

    network_px: tuple[int, int]
    """Width and height of the whole view."""
    framing: str
    """stretch or proportions."""
    normals: str
    """Source of the normals; none without a guide."""
    conditioning: str
    """Content of the fourth channel: up, luma or none."""
    tiles: int = 1
    """Number of overlapping pieces in which the view goes through the network."""

    @property
    def words(self) -> str:
        """Sentence without a period."""
        (width, height), guide = self.network_px, guide_words(self.normals, self.conditioning)
        tiles = f" in {self.tiles} tiles" if self.tiles > 1 else ""
        return f"the network saw {width}x{height} px{tiles} ({self.framing}), {guide}"


@dataclass(frozen=True, slots=True, eq=False)
class FramedView:
    """Pixels of a view as they went into a network."""

    input: NetworkInput
    image: UInt8[np.ndarray, "h w 3"]
    """Display color."""
    guide: UInt8[np.ndarray, "h w"] | None = None
    """The fourth channel, 0..255 for -1..1; None without it."""


@dataclass(frozen=True, slots=True, eq=False)
class RainyView:
    """Result of a transfer for one view."""

    clear: ClearView
    image: Image
    """Display color (sRGB), 0..1, same size as the clear image."""
    film: Plane | None = None
    """Share of water reflection, 0..1; it depends on the view, so other views need not agree on these pixels."""
    left_out: str = ""
    """Steps the transfer skipped for this view, with the reason, as the end of a sentence; empty if none."""
    framed: FramedView | None = None
    """Input of the network; None for transfers without one."""


class SkippedCounts:
    """Counter of the steps that a transfer skipped, over all views."""

    def __init__(self) -> None:
        self._views, self._reasons = 0, Counter[str]()

    def add(self, view: RainyView) -> None:
        self._views += 1
        self._reasons.update(filter(None, [view.left_out]))

    @property
    def sentences(self) -> tuple[str, ...]:
        """One sentence per reason, with the number of views."""
        return tuple(
            f"{count} of {self._views} {'view' if self._views == 1 else 'views'}: {reason}."
            for reason, count in self._reasons.items()
        )


@runtime_checkable
class Transfer(Protocol):
    """Model that makes views look rainy."""

    @property
    def name(self) -> str:
        """As in `gsrain transfer --method`."""
        ...

    def transferred(self, views: Sequence[ClearView]) -> Iterator[RainyView]:
        """Yield each view once as a rainy view, in order of completion.

        `views` may be lazy, so hold no more of them than the model needs. Equal views must give identical bytes.
        """
        ...


def guide_words(normals: str, conditioning: str) -> str:
    """Describe the fourth channel of a network's input."""
    return "RGB only" if "none" in (normals, conditioning) else f"normals from {normals} as {conditioning}"


@runtime_checkable
class NetworkTransfer(Protocol):
    """Transfer by a network, which describes its input."""

    def network_input(self, view: ClearView) -> NetworkInput:
        """Describe the network's input for a view."""
        ...


class TrainingRecord(Struct, frozen=True, kw_only=True):
    """Training of weights, as far as a transfer has to repeat it; stored in the header of their file."""

    conditioning: Literal["up", "luma", "none"]
    normals: Literal["depth", "dsine", "marigold", "none"]
    framing: Literal["stretch", "crop"]
    width_px: int
    height_px: int
    seed: int = 0
    steps: int = 0
    held_out: str = ""
    """Identity of the pictures that were held out for testing; empty if unknown."""
    base: str = ""
    """Fingerprint of the base weights, `cyclegan_turbo.model.base_fingerprint`; empty if unknown."""

    @property
    def words(self) -> str:
        """Line that describes the training."""
        guide = guide_words(self.normals, self.conditioning)
        size = f"{self.width_px}x{self.height_px} px ({self.framing})"
        return ", ".join(filter(None, [guide, size, f"{self.steps:,} steps" if self.steps else ""]))


def follow_training(settings: TransferSettings, record: TrainingRecord | None, weights: object) -> TransferSettings:
    """Fill in what is not set as the weights were trained; without a record, normals from depth, up, proportions kept.

    Raises ValueError, which names `weights`, for settings that contradict the training, unless `override` is set.
    """
    usual = {"normals": "depth", "guide": "up", "framing": "proportions"}
    trained: dict[str, str] = usual
    if record is not None:
        framing = "stretch" if record.framing == "stretch" else "proportions"
        normals = "none" if record.conditioning == "none" else record.normals
        guide = usual["guide"] if record.conditioning == "none" else record.conditioning
        trained = {"normals": normals, "guide": guide, "framing": framing}
        if not settings.override:
            for name, value in trained.items():
                asked = getattr(settings, name)
                if asked is not None and asked != value:
                    option = "conditioning" if name == "guide" else name
                    raise ValueError(f"{weights}: trained with {option} {value}, not {asked}; --override insists on it")
    return structs.replace(
        settings, **{name: value for name, value in trained.items() if getattr(settings, name) is None}
    )
