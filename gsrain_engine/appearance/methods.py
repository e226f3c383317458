"""The transfers that there are, one row each; none is loaded before it is asked for."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from msgspec import Meta, Struct

from .transfer import Transfer

if TYPE_CHECKING:
    from .wet.surroundings import Surroundings


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
                description="A learned method sees pictures brought to this shorter side; none: as they are.",
                extra={"unit": "px"},
            ),
        ]
        | None
    ) = 512
    tile_px: (
        Annotated[
            int,
            Meta(
                ge=64,
                multiple_of=64,
                title="Tile",
                description="Larger pictures go through it in overlapping tiles of this side; none: in one piece.",
                extra={"unit": "px"},
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


@dataclass(frozen=True, slots=True)
class Method:
    """One transfer in the table."""

    name: str
    title: str
    """For a person to read."""
    help: str
    opens: Callable[[TransferSettings, "Surroundings"], Transfer]
    needs_torch: bool = False
    needs: str | None = None
    """Field of the settings without which it can't be opened."""
    uses: tuple[str, ...] = ()
    """Fields of the settings that concern it, in the order in which a panel shows them."""


def open_transfer(name: str, settings: TransferSettings, surroundings: "Surroundings") -> Transfer:
    """Make a transfer ready.

    Args:
        name: One of `METHODS`.
        settings: What a person has chosen.
        surroundings: What the wet method asks for what water mirrors.

    Raises:
        ValueError: For another name, and where the settings lack what the method needs.
    """
    method = method_of(name)
    if method.needs is not None and getattr(settings, method.needs) is None:
        raise ValueError(f"--method {name} needs --{method.needs}")
    return method.opens(settings, surroundings)


def method_of(name: str) -> Method:
    """Find a method by its name; raises ValueError, which lists what there is, for another one."""
    for each in METHODS:
        if each.name == name:
            return each
    raise ValueError(f"no transfer method {name!r}, only {', '.join(each.name for each in METHODS)}")


def _wet(settings: TransferSettings, surroundings: "Surroundings") -> Transfer:
    from .wet.settings import WetSettings
    from .wet.transfer import WetTransfer

    return WetTransfer(WetSettings(wetness=settings.wetness, seed=settings.seed), surroundings)


def _cyclegan_turbo(settings: TransferSettings, surroundings: "Surroundings") -> Transfer:
    from .cyclegan_turbo.opening import open_cyclegan_turbo  # torch is an extra

    return open_cyclegan_turbo(settings)


def _images(settings: TransferSettings, surroundings: "Surroundings") -> Transfer:
    from .stand_in import PictureStandIn

    assert settings.images is not None
    return PictureStandIn(settings.images)


METHODS = (
    Method("wet", "Wet look", "Computed from light, depth and normals; needs no weights.", _wet, uses=("seed",)),
    Method(
        "cyclegan-turbo", "CycleGAN-Turbo", "The paper's diffusion model; needs its weights and torch.",
        _cyclegan_turbo, needs_torch=True,
        uses=("weights", "base", "normals", "normals_weights", "normals_checkout", "guide", "mutual_attention",
              "neighbours", "side_px", "tile_px", "precision", "device"),
    ),
    Method(
        "images", "Pictures", "Pictures that another program has made of the same views.", _images, needs="images",
        uses=("images",),
    ),
)  # fmt: skip
