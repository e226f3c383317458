"""How CycleGAN-Turbo is run over views: one value, which a command or a panel fills in."""

from typing import Annotated, Literal

from msgspec import Meta, Struct

from gsrain_engine.appearance.attention.settings import MutualAttention
from gsrain_engine.appearance.normals.grey_guide import GuideKind

NormalsFrom = Literal["depth", "dsine", "marigold", "none"]


class RunSettings(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Sizes, guides and neighbours."""

    side_px: Annotated[
        int | None,
        Meta(
            ge=8,
            title="Side",
            description="The network sees pictures brought to this shorter side, none enlarged. None: as they are.",
            extra={"unit": "px"},
        ),
    ] = 512
    """The paper trains at 512 x 512."""
    tile_px: Annotated[
        int | None,
        Meta(
            ge=64,
            multiple_of=64,
            title="Tile",
            description="Larger pictures go through in overlapping tiles of this side. None: in one piece.",
            extra={"unit": "px"},
        ),
    ] = None
    overlap_px: Annotated[
        int, Meta(ge=0, title="Overlap", description="Of neighbouring tiles, at least.", extra={"unit": "px"})
    ] = 128
    detail: Annotated[
        bool,
        Meta(
            title="Keep detail",
            description="Where the network sees a picture in small, add back the fine detail of the clear picture.",
        ),
    ] = True
    normals: Annotated[
        NormalsFrom, Meta(title="Normals", description="Who tells the surface normals: the views' depth, or a network.")
    ] = "depth"
    guide: Annotated[
        GuideKind, Meta(title="Guide", description="How normals become one channel: up-ness in the world, or luma.")
    ] = "up"
    mutual: Annotated[
        MutualAttention | None, Meta(title="Mutual attention", description="None: each view for itself.")
    ] = MutualAttention()
