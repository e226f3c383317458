"""What SD-Turbo's text encoder makes of a caption: worked out once, then kept."""

from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from typing import Any

from gsrain_engine.scene.atomic_files import whole_file
from gsrain_engine.untrusted.limits import check_file

from .architecture import TurboArchitecture
from .places import captions_file, text_encoder_folder

torch: Any = import_module("torch")

Tensor = Any


def caption_embeddings(
    texts: Sequence[str], base: Path, architecture: TurboArchitecture, cache: Path | None = None
) -> list[Tensor]:
    """Embeddings (1, tokens, features) of captions, from what is kept or from the text encoder.

    Args:
        texts: Captions.
        base: Folder of SD-Turbo; `text_encoder` and `tokenizer` in it are used for captions that aren't kept yet.
        architecture: Says the shape.
        cache: File of captions; None takes the person's own.

    Raises FileNotFoundError, with the first caption that is nowhere and what is missing, and ValueError for embeddings
    of another shape.
    """
    cache = captions_file() if cache is None else cache
    kept = _read(cache)
    missing = [text for text in dict.fromkeys(texts) if text not in kept]
    if missing:
        folder = text_encoder_folder(base)
        if folder is None:
            raise FileNotFoundError(
                f"no text encoder at {base} (text_encoder, tokenizer), and no caption {missing[0]!r} in {cache}: "
                "copy the folders of SD-Turbo there, or that file from a machine that has made a view rainy"
            )
        kept |= dict(zip(missing, encoded_captions(missing, base), strict=True))
        _write(cache, kept)
    for text in texts:
        if tuple(kept[text].shape) != architecture.caption_shape:
            shape = tuple(kept[text].shape)
            raise ValueError(f"{cache}: caption {text!r} is {shape}, the UNet takes {architecture.caption_shape}")
    return [kept[text] for text in texts]


def encoded_captions(texts: Sequence[str], base: Path) -> list[Tensor]:
    """Run the text encoder of a folder; raises ValueError where it can't be read or weights of it are missing."""
    transformers: Any = import_module("transformers")
    try:
        tokenizer: Any = transformers.AutoTokenizer.from_pretrained(base / "tokenizer", local_files_only=True)
        encoder, found = transformers.CLIPTextModel.from_pretrained(
            base / "text_encoder", local_files_only=True, use_safetensors=True, output_loading_info=True
        )
    except Exception as error:  # transformers fails in many ways; its words are the finding
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


def _read(cache: Path) -> dict[str, Tensor]:
    if not cache.is_file():
        return {}
    load: Any = import_module("safetensors.torch").load_file
    try:
        check_file(cache)
        return dict(load(cache))
    except Exception as error:  # its error class is not public
        raise ValueError(f"{cache}: not a readable file of captions: {error}") from error


def _write(cache: Path, captions: dict[str, Tensor]) -> None:
    save: Any = import_module("safetensors.torch").save_file
    cache.parent.mkdir(parents=True, exist_ok=True)
    with whole_file(cache) as beside:
        save({text: each.contiguous() for text, each in captions.items()}, beside)
