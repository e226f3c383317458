"""Loading of CycleGAN-Turbo: SD-Turbo from disk, transfer weights, and cached caption embeddings."""

import logging
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from typing import Any

from ...safe_io.files import whole_file
from ...safe_io.limits import check_file
from . import model as turbo
from .lora import LoraRanks
from .model import ARCHITECTURES, CAPTIONS, CycleGanTurbo, TurboArchitecture, sd_turbo
from .weight_paths import base_model_instructions, captions_file, find_base_model, text_encoder_folder
from .weights import apply_adapter_weights, first_of, open_weights

torch: Any = import_module("torch")
Tensor = Any
log = logging.getLogger(__name__)


def open_model(
    weights: Path | None,
    base: Path | None = None,
    *,
    normals: bool = True,
    lora: LoraRanks | None = None,
    override: bool = False,
) -> CycleGanTurbo:
    """Load SD-Turbo with transfer weights, in float32 on the CPU; nothing is downloaded.

    Args:
        weights: File for `open_weights`; None for plain SD-Turbo, to be trained.
        base: Folder of SD-Turbo; None searches `weight_paths.base_model_folders`.
        normals: Add a fourth channel to the encoders; without trained weights it has no effect. Weights trained with
            one always get it, with zeros for missing guides.
        lora: Ranks of separate peft adapters, for training.
        override: Accept another base than that of the weights' training.

    Raises FileNotFoundError with download instructions, and ValueError for files that don't fit.
    """
    file = None if weights is None else open_weights(weights)
    normals = normals or (file is not None and file.takes_guides)
    if file is not None and file.random_base_seed is not None:
        log.warning("%s: trained upon random weights, for a test: the pictures will mean nothing", weights)
        model = turbo.build_random_model(ARCHITECTURES[file.architecture](), normals, lora, file.random_base_seed)
    else:
        architecture = sd_turbo() if file is None else ARCHITECTURES[file.architecture]()
        texts = CAPTIONS if file is None else file.texts
        folder = find_base_model(base)
        model = read_base(folder, architecture, normals=normals, lora=lora, texts=texts)
        if file is not None and file.record is not None and not override and file.record.base not in ("", model.base):
            raise ValueError(
                f"{weights}: trained upon another SD-Turbo ({file.record.base}) than {folder} ({model.base}); "
                "gsrain transfer --override insists on it"
            )
    if file is not None:
        apply_adapter_weights(model, file.delta(model, override=override))
        model.record = file.record
    return model


def read_base(
    folder: Path,
    architecture: TurboArchitecture,
    *,
    normals: bool = True,
    lora: LoraRanks | None = None,
    texts: tuple[str, str] | None = CAPTIONS,
) -> CycleGanTurbo:
    """Load SD-Turbo from a folder in diffusers' layout, checked for architecture and completeness.

    `texts` are the captions for a2b and b2a; None if the transfer weights include their embeddings.
    Raises FileNotFoundError and ValueError with the file and the fault.
    """
    turbo.check_base(folder, architecture)
    diffusers: Any = import_module("diffusers")
    unet = _part(diffusers.UNet2DConditionModel, folder / "unet")
    vae = _part(diffusers.AutoencoderKL, folder / "vae")
    if texts is None:
        captions = torch.zeros(2, *architecture.caption_shape)
    else:
        captions = torch.stack(caption_embeddings(texts, folder, architecture))
    fingerprint = turbo.base_fingerprint(unet, vae)  # assembling changes them
    model = turbo.assemble_model(architecture, unet, vae, captions, normals=normals, lora=lora)
    model.base = fingerprint
    model.texts = CAPTIONS if texts is None else texts
    return model


def _part(kind: Any, folder: Path) -> Any:
    """Load one network; a missing weight would be random, so it is an error."""
    files = list(folder.glob("*.safetensors"))
    if not files:
        raise FileNotFoundError(
            f"{folder}: no weights (diffusion_pytorch_model.safetensors): {base_model_instructions()}"
        )
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
            raise ValueError(f"{folder}: {first_of(names)} {fault}")
    return part


# Caption embeddings


def caption_embeddings(texts: Sequence[str], base: Path, architecture: TurboArchitecture) -> list[Tensor]:
    """Embeddings (1, tokens, features) of captions, from the user's cache or from the text encoder.

    `base` is the folder of SD-Turbo, whose `text_encoder` and `tokenizer` encode captions that are not cached. Raises
    FileNotFoundError with the first missing caption and the missing files, and ValueError for embeddings of another
    shape.
    """
    cache = captions_file()
    safetensors: Any = import_module("safetensors.torch")
    found: dict[str, Tensor] = {}
    if cache.is_file():
        try:
            check_file(cache)
            found = dict(safetensors.load_file(cache))
        except Exception as error:  # safetensors' error class is not public
            raise ValueError(f"{cache}: not a readable file of captions: {error}") from error
    missing = [text for text in dict.fromkeys(texts) if text not in found]
    if missing:
        if text_encoder_folder(base) is None:
            raise FileNotFoundError(
                f"no text encoder at {base} (text_encoder, tokenizer), and no caption {missing[0]!r} in {cache}: "
                "copy the folders of SD-Turbo there, or that file from a machine that has made a view rainy"
            )
        found |= dict(zip(missing, encoded_captions(missing, base), strict=True))
        cache.parent.mkdir(parents=True, exist_ok=True)
        with whole_file(cache) as temporary:
            safetensors.save_file({text: each.contiguous() for text, each in found.items()}, temporary)
    for text in texts:
        if (shape := tuple(found[text].shape)) != architecture.caption_shape:
            raise ValueError(f"{cache}: caption {text!r} is {shape}, the UNet takes {architecture.caption_shape}")
    return [found[text] for text in texts]


def encoded_captions(texts: Sequence[str], base: Path) -> list[Tensor]:
    """Run the text encoder of a folder; raises ValueError if it can't be read or lacks weights."""
    transformers: Any = import_module("transformers")
    try:
        tokenizer: Any = transformers.AutoTokenizer.from_pretrained(base / "tokenizer", local_files_only=True)
        encoder, found = transformers.CLIPTextModel.from_pretrained(
            base / "text_encoder", local_files_only=True, use_safetensors=True, output_loading_info=True
        )
    except Exception as error:  # transformers raises many types
        first = str(error).split("\n")[0]
        raise ValueError(f"{base}: its text encoder can't be read, perhaps not wholly downloaded: {first}") from error
    if found["missing_keys"]:
        first = min(found["missing_keys"])
        raise ValueError(f"{base / 'text_encoder'}: {first!r} and perhaps more weights are missing")
    longest = encoder.config.max_position_embeddings
    length = min(tokenizer.model_max_length, longest)
    tokens = tokenizer(list(texts), max_length=length, padding="max_length", truncation=True, return_tensors="pt")
    with torch.no_grad():
        states = encoder.eval().float()(input_ids=tokens.input_ids).last_hidden_state
    return [state.clone() for state in states.split(1)]
