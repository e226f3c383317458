"""Settings of CycleGAN-Turbo's inference and cross-view attention, and the tile window."""

from dataclasses import dataclass
from typing import Annotated, Literal

from msgspec import Meta, Struct

from ..normals import GuideKind


class CrossViewAttention(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Choice of neighbors that views attend to (eq. 16-19), and of the network's layers."""

    neighbours: Annotated[
        int, Meta(ge=0, le=16, title="Neighbours", description="So many other views each one looks at; 0 is none.")
    ] = 2
    among: Annotated[
        Literal["all", "cameras", "time"],
        Meta(title="Among", description="cameras: of the same moment. time: of the same camera. all: both."),
    ] = "all"
    order: Annotated[
        Literal["outward", "together"],
        Meta(
            title="Order",
            description="outward: an anchor view first, then each looks at views already done. "
            "together: the views of a group all look at each other.",
        ),
    ] = "outward"
    group: Annotated[
        int, Meta(ge=1, le=64, title="Group", description="So many views go through the network at once when together.")
    ] = 3
    layers: Annotated[
        tuple[str, ...],
        Meta(title="Layers", description='Names of self-attention layers with wildcards, like "up_blocks.*".'),
    ] = ("*",)
    px_per_token: Annotated[
        tuple[int, ...],
        Meta(title="Pixels per token", description="Only layers whose tokens are so wide; SD-Turbo has 8 to 64."),
    ] = (8, 16, 32)
    """At 64 px a token covers more than an object, so correspondences mean little."""
    most_scores: Annotated[
        int,
        Meta(ge=1, title="Most scores", description="Attention scores held at once; queries come in chunks below it."),
    ] = 2**26
    """256 MB in float32."""


@dataclass(frozen=True, slots=True)
class TileWindow:
    """Rectangle of an image in pixels; the whole image if it isn't cut into tiles."""

    top: int
    left: int
    height: int
    width: int
    frame: tuple[int, int]
    """Height and width of the whole image."""

    @classmethod
    def whole(cls, height: int, width: int) -> "TileWindow":
        return cls(0, 0, height, width, (height, width))

    @property
    def is_whole(self) -> bool:
        return (self.height, self.width) == self.frame

    def in_tokens(self, height: int, width: int) -> "TileWindow":
        """Return the window in tokens, for a map whose part for this window has `height` x `width` tokens.

        Raises ValueError if the window doesn't start at a token or tokens don't divide the image evenly.
        """
        if self.is_whole:
            return TileWindow.whole(height, width)
        scaled = [
            value * tokens / pixels
            for value, tokens, pixels in (
                (self.top, height, self.height),
                (self.left, width, self.width),
                (self.frame[0], height, self.height),
                (self.frame[1], width, self.width),
            )
        ]
        if any(value != int(value) for value in scaled):
            raise ValueError(f"{self} does not fall on whole tokens of a map of {height} x {width}")
        top, left, frame_height, frame_width = (int(value) for value in scaled)
        return TileWindow(top, left, height, width, (frame_height, frame_width))


NormalsFrom = Literal["depth", "dsine", "marigold", "none"]


class RunSettings(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Sizes, guides and neighbors of an inference run."""

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
        CrossViewAttention | None, Meta(title="Mutual attention", description="None: each view for itself.")
    ] = CrossViewAttention()
