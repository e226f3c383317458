"""Interfaces of appearance transfer: clear views, rainy views, the transfer protocol and its settings."""

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float32, UInt8
from msgspec import Meta, Struct, structs

from ..scene.camera import Camera
from ..settings import Settings

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


_Side = Annotated[
    int,
    Meta(ge=64, le=4096, title="Side", description="A learned method sees pictures brought to this shorter side.",
         extra={"unit": "px", "none": "as they are", "commands": "transfer"}),
]  # fmt: skip
_Tile = Annotated[
    int,
    Meta(ge=64, le=4096, multiple_of=64, title="Tile",
         description="Larger pictures go through it in overlapping tiles of this side.",
         extra={"unit": "px", "none": "in one piece", "usual": 512, "commands": "transfer*"}),
]  # fmt: skip


class TransferSettings(Settings, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """User settings of a transfer; each method uses only its own fields."""

    # fmt: off
    wetness: Annotated[float, Meta(
        ge=0, le=1, title="Wetness", extra={"commands": "transfer"},
        description="Of the wet look: 0 dry, 1 soaked, from which gsrain recolor makes wet colors.")] = 1.0
    seed: Annotated[int, Meta(
        ge=0, le=2**31 - 1, title="Seed", extra={"commands": "transfer"},
        description="Of what is left to chance: positions of puddles and clouds.")] = 0
    weights: Annotated[Path | None, Meta(
        title="Weights", extra={"commands": "transfer"},
        description="File with the weights of a learned method.")] = None
    images: Annotated[Path | None, Meta(
        title="Pictures", extra={"commands": "transfer"},
        description="Folder with pictures that another program has made.")] = None
    base: Annotated[Path | None, Meta(
        title="SD-Turbo", extra={"commands": "transfer"},
        description="Folder of SD-Turbo, the base of cyclegan-turbo; none: see gsrain doctor.")] = None
    normals: Annotated[Literal["depth", "dsine", "marigold", "none"] | None, Meta(
        title="Normals", extra={"commands": "transfer", "none": "as trained"},
        description="Source of the surface normals for a learned method; none: no normals.")] = None
    normals_weights: Annotated[Path | None, Meta(
        title="Weights for normals", extra={"commands": "transfer"},
        description="File of DSINE (none: see gsrain doctor), or folder of Marigold.")] = None
    normals_checkout: Annotated[Path | None, Meta(
        title="DSINE's program", extra={"commands": "transfer"},
        description="Your own copy of DSINE's program; non-commercial use only; none: see gsrain doctor.")] = None
    guide: Annotated[Literal["up", "luma"] | None, Meta(
        title="Guide", extra={"option": "conditioning", "commands": "transfer", "none": "as trained"},
        description="How normals become the fourth channel: their upward component, or luma as in the paper.")] = None
    framing: Annotated[Literal["stretch", "proportions"] | None, Meta(
        title="Framing", extra={"commands": "transfer*", "none": "as trained"},
        description="stretch: pictures have the size of the training's, whatever their proportions.")] = None
    override: Annotated[bool, Meta(
        title="Override", extra={"commands": "transfer*"},
        description="Run weights otherwise than they were trained.")] = False
    mutual_attention: Annotated[bool, Meta(
        title="Mutual attention", extra={"option": "cross-view-attention mutual-attention", "commands": "transfer"},
        description="Let each view attend to its neighbors (eq. 16-19).")] = True
    neighbours: Annotated[int, Meta(
        ge=0, le=16, title="Neighbors", extra={"option": "neighbors", "commands": "transfer*"},
        description="Number of other views that each view attends to.")] = 2
    side_px: _Side | None = 512
    tile_px: _Tile | None = None
    device: Annotated[Literal["auto", "cpu", "cuda"], Meta(
        title="Device", extra={"commands": "transfer"}, description="Device that a learned method runs on.")] = "auto"
    precision: Annotated[Literal["float32", "float16", "bfloat16"], Meta(
        title="Precision", extra={"commands": "transfer*"},
        description="Of a learned method's numbers; halves are faster on GPUs, and coarser.")] = "float32"
    # fmt: on


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
