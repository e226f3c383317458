"""Which pictures a transfer is trained on: one value, which is a part of the training's YAML file."""

from typing import Annotated, Literal

from msgspec import Meta, Struct


class PictureSource(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Pictures of one data set, by what its own labels say of the weather."""

    path: Annotated[str, Meta(title="Path", description="Any capture, data set or folder of pictures.")]
    weather: Annotated[
        Literal["any", "clear", "rainy"],
        Meta(title="Weather", description="Only pictures that the data set labels so; any: all there are."),
    ] = "any"
    daytime: Annotated[bool, Meta(title="Daytime", description="Leave out what is labelled as night or twilight.")] = (
        True
    )
    count: Annotated[
        Annotated[int, Meta(ge=1)] | None,
        Meta(title="Count", description="So many, spread evenly over its sequences; none: all."),
    ] = None


class PictureSettings(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Two sets of pictures that show no place twice, how they are framed, and what guides the encoder beside them."""

    clear: Annotated[tuple[PictureSource, ...], Meta(min_length=1, title="Clear", description="In dry weather.")]
    rainy: Annotated[tuple[PictureSource, ...], Meta(min_length=1, title="Rainy", description="In rain.")]
    test_share: Annotated[
        float, Meta(ge=0, lt=1, title="Test share", description="Share of each source that is never trained on.")
    ] = 0.2
    width_px: Annotated[int, Meta(ge=16, le=4096, multiple_of=8, title="Width", extra={"unit": "px"})] = 512
    height_px: Annotated[int, Meta(ge=16, le=4096, multiple_of=8, title="Height", extra={"unit": "px"})] = 512
    framing: Annotated[
        Literal["stretch", "crop"],
        Meta(title="Framing", description="stretch: as the paper, whatever the proportions. crop: their middle."),
    ] = "stretch"
    guide: Annotated[
        Literal["up", "luma", "none"],
        Meta(title="Guide", description="Fourth channel of the encoder: up-ness of surfaces, their luma, or none."),
    ] = "up"
    normals: Annotated[
        str, Meta(title="Normals", description="Who tells them where a picture has no depth: dsine, marigold, none.")
    ] = "none"
    normals_weights: Annotated[
        str | None, Meta(title="Weights for normals", description="File or folder that the estimator needs.")
    ] = None
    normals_checkout: Annotated[
        str | None, Meta(title="Checkout for normals", description="The person's own copy of DSINE's program.")
    ] = None
    seed: Annotated[int, Meta(ge=0, le=2**31 - 1, title="Seed", description="Which pictures are for testing.")] = 0
