"""What a person can choose about a transfer."""

from pathlib import Path
from typing import Annotated, Literal

from msgspec import Meta, Struct


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
