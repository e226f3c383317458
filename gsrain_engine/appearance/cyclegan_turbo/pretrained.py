"""A CycleGAN-Turbo ready for use or for training: SD-Turbo from a person's disk with a transfer's weights in it."""

import logging
from importlib import import_module
from pathlib import Path
from typing import Any

from .architecture import ARCHITECTURES, TurboArchitecture, check_base, sd_turbo
from .captions import caption_embeddings
from .delta import take_in
from .lora import LoraRanks
from .model import CAPTIONS, CycleGanTurbo, assembled, build
from .places import find_base, how_to_get_base
from .weights import open_weights

torch: Any = import_module("torch")

log = logging.getLogger(__name__)


def open_model(
    weights: Path | None,
    base: Path | None = None,
    *,
    normals: bool = True,
    lora: LoraRanks | None = None,
    weather: str = "rainy",
) -> CycleGanTurbo:
    """SD-Turbo with weights in it, in float32 on the processor; nothing is downloaded.

    Args:
        weights: A file that `open_weights` takes; None for SD-Turbo as it is, to be trained.
        base: Folder of SD-Turbo; None looks where `places.base_places` says.
        normals: Whether the encoders take a fourth channel; one that weights lack changes nothing. Weights that were
            made with one always get it, and zeros in it where there are no guides.
        lora: For training: keeps additions apart, in peft adapters of these ranks.
        weather: Which part of a WeatherEdit checkpoint.

    Raises FileNotFoundError, with how to get what is missing, and ValueError for files that don't fit.
    """
    file = None if weights is None else open_weights(weights)
    normals = normals or (file is not None and file.takes_guides)
    if file is not None and file.random_base_seed is not None:
        log.warning("%s: trained upon random weights, for a test: the pictures will mean nothing", weights)
        model = build(ARCHITECTURES[file.architecture](), normals, lora, file.random_base_seed)
    else:
        architecture = sd_turbo() if file is None else ARCHITECTURES[file.architecture]()
        texts = CAPTIONS if file is None else file.texts(weather)
        model = read_base(find_base(base), architecture, normals=normals, lora=lora, texts=texts)
    if file is not None:
        take_in(model, file.delta(model, weather))
    return model


def read_base(
    folder: Path,
    architecture: TurboArchitecture | None = None,
    *,
    normals: bool = True,
    lora: LoraRanks | None = None,
    texts: tuple[str, str] | None = CAPTIONS,
) -> CycleGanTurbo:
    """SD-Turbo from a folder in diffusers' layout, checked to be the wanted architecture and to be complete.

    `texts` are the captions for a2b and b2a; None where they come with the transfer's weights.
    Raises FileNotFoundError and ValueError, which name the file and what is wrong.
    """
    architecture = sd_turbo() if architecture is None else architecture
    check_base(folder, architecture)
    diffusers: Any = import_module("diffusers")
    unet = _part(diffusers.UNet2DConditionModel, folder / "unet")
    vae = _part(diffusers.AutoencoderKL, folder / "vae")
    if texts is None:
        captions = torch.zeros(2, *architecture.caption_shape)
    else:
        captions = torch.stack(caption_embeddings(texts, folder, architecture))
    model = assembled(architecture, unet, vae, captions, normals=normals, lora=lora)
    model.texts = CAPTIONS if texts is None else texts
    return model


def _part(kind: Any, folder: Path) -> Any:
    """One network; a weight that is missing would be random, so that is an error."""
    files = list(folder.glob("*.safetensors"))
    if not files:
        raise FileNotFoundError(f"{folder}: no weights (diffusion_pytorch_model.safetensors): {how_to_get_base()}")
    variant = "fp16" if all("fp16" in file.name for file in files) else None
    try:
        part, found = kind.from_pretrained(
            folder, local_files_only=True, use_safetensors=True, variant=variant, output_loading_info=True,
            torch_dtype=torch.float32,
        )  # fmt: skip
    except OSError as error:
        first = str(error).split("\n")[0]
        raise ValueError(f"{folder}: weights that can't be read, perhaps not wholly downloaded: {first}") from error
    for fault, names in (("missing", found["missing_keys"]), ("unknown", found["unexpected_keys"])):
        if names:
            others = f" and {len(names) - 1} more are" if len(names) > 1 else " is"
            raise ValueError(f"{folder}: {min(names)!r}{others} {fault}")
    return part
