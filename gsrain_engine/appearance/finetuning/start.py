"""Puts a fine-tuning together: pictures, model, discriminators, and what they are measured with."""

import logging
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float32

from gsrain_engine.appearance.cyclegan_turbo.architecture import tiny
from gsrain_engine.appearance.cyclegan_turbo.lora import LoraRanks
from gsrain_engine.appearance.cyclegan_turbo.model import build
from gsrain_engine.appearance.cyclegan_turbo.pretrained import open_model

from .clip_features import ClipFeatures
from .discriminator import Discriminator
from .early_warning import EarlyWarning, counted, look_distance
from .iteration import Training
from .losses import Perceptual
from .picture_order import PictureOrder
from .pictures.picture import Picture, UnpairedPictures
from .settings import FinetuningSettings

torch: Any = import_module("torch")

logger = logging.getLogger("gsrain")

_TINY_CHANNELS = 32
_DISTANCE_PX = 64


def chosen_device(name: str) -> str:
    """Device of a setting. Raises ValueError where CUDA is asked for and not there."""
    has_cuda = bool(torch.cuda.is_available())
    if name == "cuda" and not has_cuda:
        raise ValueError("device cuda: no CUDA device is there; take cpu or auto")
    return "cuda" if name != "cpu" and has_cuda else "cpu"


def start_finetuning(
    settings: FinetuningSettings, pictures: UnpairedPictures, perceptual: Perceptual | None = None
) -> Training:
    """Build everything, from the seed where it is new.

    Raises:
        FileNotFoundError: Where SD-Turbo, CLIP or the weights to start from are missing, with how to get them.
        ValueError: Where one of them is of another architecture, or CUDA isn't there.
    """
    device = chosen_device(settings.device)
    guided = settings.pictures.guide != "none"
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(settings.seed)
        model = _model(settings, guided).to(device)
        features, channels = _features(settings), _TINY_CHANNELS if settings.architecture == "tiny" else 256
        judges = [Discriminator(features.to(device), settings.augmentations, channels).to(device) for _ in range(2)]
    if perceptual is None and (settings.losses.cycle_lpips or settings.losses.identity_lpips):
        logger.warning(
            "LPIPS has no weights here: its losses, most of the recipe, are OFF, and what comes out will be blurred; "
            "`gsrain doctor` says how to get them"
        )
    order = PictureOrder(pictures, settings.seed, guided, device)
    return Training(model, (judges[0], judges[1]), order, settings, perceptual)


def start_warning(settings: FinetuningSettings, pictures: UnpairedPictures) -> EarlyWarning:
    """Measure how far apart the two looks are, for the early warning."""
    distance = look_distance(_small(pictures.source), _small(pictures.target))
    return EarlyWarning(distance, settings.losses.gan, settings.warned_after)


def _model(settings: FinetuningSettings, guided: bool) -> Any:
    ranks = LoraRanks(settings.lora.unet, settings.lora.vae)
    if settings.architecture == "tiny" and settings.start is None:
        return build(tiny(), normals=guided, lora=ranks, seed=settings.seed)
    start, base = (None if each is None else Path(each) for each in (settings.start, settings.base))
    model = open_model(start, base, normals=guided, lora=ranks)
    if model.architecture.name != settings.architecture:
        raise ValueError(
            f"{start}: is of architecture {model.architecture.name}, the settings say {settings.architecture}"
        )
    return model


def _features(settings: FinetuningSettings) -> ClipFeatures:
    if settings.architecture == "tiny" and settings.clip is None:
        return ClipFeatures.tiny()
    return ClipFeatures.read(None if settings.clip is None else Path(settings.clip))


def _small(pictures: tuple[Picture, ...]) -> Iterator[Float32[np.ndarray, "_ _ 3"]]:
    """Some of the pictures, thinned: their colours are what counts."""
    for i in counted(pictures):
        image = pictures[i].read()[0]
        step = max(1, max(image.shape) // _DISTANCE_PX)
        yield image[::step, ::step]
