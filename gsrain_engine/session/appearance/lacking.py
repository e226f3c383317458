"""What a transfer lacks to be opened: told beside its settings, before a worker is started for nothing."""

from gsrain_engine.appearance.cyclegan_turbo.places import find_base, find_weights
from gsrain_engine.appearance.methods import Method
from gsrain_engine.appearance.transfer_settings import TransferSettings

from ..jobs.torch_extra import HOW_TO_GET_DIFFUSION, has_torch


def lacking(method: Method, settings: TransferSettings) -> str | None:
    """Say in one sentence what is missing, and how to get it; None where all is there."""
    if method.needs_torch and not has_torch():
        return f"{method.title} needs torch, which is not installed: {HOW_TO_GET_DIFFUSION}"
    if method.needs == "images" and settings.images is None:
        return f"{method.title}: choose a folder of pictures first."
    for place in (getattr(settings, name) for name in ("weights", "images", "base") if name in method.uses):
        if place is not None and not place.exists():
            return f"{place}: is not there; choose another place."
    try:
        if "weights" in method.uses and settings.weights is None:
            find_weights()
        if "base" in method.uses:
            find_base(settings.base)
    except FileNotFoundError as missing:
        return f"{method.title}: {missing}"
    return None
