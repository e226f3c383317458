"""The transfers that there are, one row each; none is loaded before it is asked for."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from .transfer import Transfer
from .transfer_settings import TransferSettings

if TYPE_CHECKING:
    from .wet.surroundings import Surroundings


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
              "neighbours", "side_px", "precision", "device"),
    ),
    Method(
        "images", "Pictures", "Pictures that another program has made of the same views.", _images, needs="images",
        uses=("images",),
    ),
)  # fmt: skip
