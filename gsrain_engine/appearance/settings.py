"""Settings of an appearance transfer."""

from pathlib import Path
from typing import Annotated, Literal

from msgspec import Meta

from ..settings import Settings

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
