"""CycleGAN-Turbo ready to run, from what a person has chosen: weights, device, normals, neighbours."""

import logging
from importlib import import_module
from typing import TYPE_CHECKING, Any

from gsrain_engine.appearance.attention.settings import MutualAttention
from gsrain_engine.appearance.normals.estimators import open_estimator

from .places import find_weights
from .pretrained import open_model
from .settings import RunSettings
from .transfer import CycleGanTurboTransfer

if TYPE_CHECKING:
    from gsrain_engine.appearance.transfer_settings import TransferSettings

torch: Any = import_module("torch")

log = logging.getLogger(__name__)


def open_cyclegan_turbo(settings: "TransferSettings") -> CycleGanTurboTransfer:
    """Load SD-Turbo with a transfer's weights from the person's disk, and what is to tell normals.

    Raises FileNotFoundError, with how to get what is missing, and ValueError for files and settings that don't fit
    each other.
    """
    weights = settings.weights or find_weights()
    wants_normals = settings.normals != "none"
    model = open_model(weights, settings.base, normals=wants_normals)
    if wants_normals and model.guide == "mask":
        raise ValueError(f"{weights}: its fourth channel takes a mask of classes, not normals: run it without normals")
    if wants_normals and not model.guide:
        log.info("%s: trained without normals, which are left out", weights)
    from_network = settings.normals in ("dsine", "marigold") and bool(model.guide)
    device = chosen_device(settings.device)
    estimator = (
        open_estimator(settings.normals, settings.normals_weights, settings.normals_checkout, device)
        if from_network
        else None
    )
    run = RunSettings(
        side_px=settings.side_px,
        tile_px=settings.tile_px,
        normals=settings.normals if model.guide else "none",
        guide=settings.guide,
        mutual=MutualAttention(neighbours=settings.neighbours) if settings.mutual_attention else None,
    )
    model = model.to(device, getattr(torch, settings.precision))
    return CycleGanTurboTransfer(model, run, estimator)


def chosen_device(name: str) -> str:
    """Return "cpu" or "cuda"; "auto" takes a GPU where there is one. Raises ValueError where "cuda" has none."""
    if name == "auto":
        return "cuda" if torch.cuda.is_available() else "cpu"
    if name == "cuda" and not torch.cuda.is_available():
        raise ValueError("device cuda: torch finds no GPU here")
    return name
