"""What every appearance transfer is: clear views in, rainy views out."""

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float32
from msgspec import Meta, Struct

from ..scene.camera import Camera

# § A view before its transfer: the picture, and what is known about each pixel. World frame (metres, z up).


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
        return self.known_share >= _MIN_KNOWN and self.has_depth

    @property
    def has_depth(self) -> bool:
        """Whether the distance of any pixel is known."""
        return bool((self.depth > 0).any())

    def __post_init__(self) -> None:
        size = (self.camera.height, self.camera.width)
        for name in ("image", "depth", "normals", "sky", "vehicles"):
            if (found := getattr(self, name).shape[:2]) != size:
                raise ValueError(f"view {self.name!r}: {name} is {found}, its camera says {size}")


@dataclass(frozen=True, slots=True, eq=False)
class RainyView:
    """A view as a transfer made it."""

    clear: ClearView
    image: Float32[np.ndarray, "h w 3"]
    """Display colour (sRGB), 0..1, of the clear picture's size."""
    film: Float32[np.ndarray, "h w"] | None = None
    """Share of what water mirrors, 0..1: it moves with the eye, so that other views rightly disagree about it."""
    left_out: str = ""
    """What the transfer could not do for this view and why, as the end of a sentence; empty where it did all."""


class SkippedCounts:
    """Counts what a transfer could not do, over all views."""

    def __init__(self) -> None:
        self._views, self._reasons = 0, Counter[str]()

    def add(self, view: RainyView) -> None:
        self._views += 1
        if view.left_out:
            self._reasons[view.left_out] += 1

    @property
    def sentences(self) -> tuple[str, ...]:
        """Return one sentence a reason, with the number of views."""
        return tuple(
            f"{count} of {self._views} {'view' if self._views == 1 else 'views'}: {reason}."
            for reason, count in self._reasons.items()
        )


@runtime_checkable
class Transfer(Protocol):
    """A model that makes views look rainy."""

    @property
    def name(self) -> str:
        """As in `gsrain transfer --method`."""
        ...

    def transferred(self, views: Sequence[ClearView]) -> Iterator[RainyView]:
        """Make views rainy, one by one, in the order in which they are done; each comes out once.

        `views` may be lazy, each worked out when it is asked for: hold on to no more of them than the model needs.
        The same views give the same bytes.
        """
        ...


_MIN_KNOWN = 0.5
"""Of the depth below the sky: a lidar's beams reach 0.7 and more, a few thousand triangulated points 0.2 to 0.4."""

# § What a person can choose about a transfer.


class TransferSettings(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What a person can choose about a transfer; each method takes what concerns it."""

    wetness: Annotated[float, Meta(ge=0, le=1, title="Wetness")] = 1.0
    """0 changes nothing, 1 is soaked: what a scene's wet colours are made for, since wetness then blends them in."""
    seed: Annotated[
        int, Meta(ge=0, le=2**31 - 1, title="Seed", description="Of what is left to chance: where puddles stand.")
    ] = 0
    weights: Annotated[Path | None, Meta(title="Weights", description="File with the weights of a learned method.")] = (
        None
    )
    images: Annotated[
        Path | None, Meta(title="Pictures", description="Folder with pictures that another program has made.")
    ] = None
    base: Annotated[Path | None, Meta(title="SD-Turbo", description="Its folder; none: see gsrain doctor.")] = None
    normals: Annotated[
        Literal["depth", "dsine", "marigold", "none"],
        Meta(title="Normals", description="Who tells a learned method which way surfaces face; none: nobody."),
    ] = "depth"
    normals_weights: Annotated[
        Path | None, Meta(title="Weights for normals", description="File of DSINE, or folder of Marigold.")
    ] = None
    normals_checkout: Annotated[
        Path | None, Meta(title="DSINE's program", description="A person's own copy of it; non-commercial use only.")
    ] = None
    guide: Annotated[
        Literal["up", "luma"],
        Meta(title="Guide", description="How normals become the fourth channel: up-ness, or luma as in the paper."),
    ] = "up"
    mutual_attention: Annotated[
        bool, Meta(title="Mutual attention", description="Let each view attend to its neighbours (eq. 16-19).")
    ] = True
    neighbours: Annotated[
        int, Meta(ge=0, le=16, title="Neighbours", description="So many other views each one attends to.")
    ] = 2
    side_px: (
        Annotated[
            int,
            Meta(
                ge=64,
                le=4096,
                title="Side",
                description="A learned method sees pictures brought to this shorter side.",
                extra={"unit": "px", "none": "as they are"},
            ),
        ]
        | None
    ) = 512
    tile_px: (
        Annotated[
            int,
            Meta(
                ge=64,
                le=4096,
                multiple_of=64,
                title="Tile",
                description="Larger pictures go through it in overlapping tiles of this side.",
                extra={"unit": "px", "none": "in one piece", "usual": 512},
            ),
        ]
        | None
    ) = None
    device: Annotated[
        Literal["auto", "cpu", "cuda"], Meta(title="Device", description="Where a learned method runs.")
    ] = "auto"
    precision: Annotated[
        Literal["float32", "float16", "bfloat16"],
        Meta(title="Precision", description="Of a learned method's numbers; halves are faster on GPUs, and coarser."),
    ] = "float32"
