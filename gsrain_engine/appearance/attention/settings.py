"""What mutual self-attention lets views take from each other: one value, which a command or a panel fills in."""

from typing import Annotated, Literal

from msgspec import Meta, Struct


class MutualAttention(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Which views attend to which others (eq. 16-19), and in which layers of the network."""

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
    """At 64 px a token covers more than an object: places in another view mean little there."""
    most_scores: Annotated[
        int,
        Meta(ge=1, title="Most scores", description="Attention scores held at once; queries come in chunks below it."),
    ] = 2**26
    """256 MB in float32."""
