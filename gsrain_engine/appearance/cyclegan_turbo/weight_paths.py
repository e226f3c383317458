"""CycleGAN-Turbo's files on the user's machine: paths, download instructions, training records. Needs no torch."""

import os
from collections.abc import Mapping
from importlib import import_module
from pathlib import Path
from typing import Any

import msgspec
import platformdirs

from ...safe_io.limits import check_file, read_file
from ...safe_io.text_files import printable_line
from ..base import TrainingRecord

BASE_VARIABLE = "GSRAIN_SD_TURBO"
"""Environment variable with a folder of SD-Turbo in diffusers' layout."""
WEIGHTS_VARIABLE = "GSRAIN_TRANSFER_WEIGHTS"
PUBLISHED_URL = "https://www.cs.cmu.edu/~img2img-turbo/models/clear2rainy.pkl"
_HUB_NAME = "stabilityai/sd-turbo"
_PARTS = ("unet", "vae")
_SUFFIXES = (".safetensors", ".pkl", ".pt", ".pth")


def data_folder() -> Path:
    """User folder for files that GSRAIN can use but doesn't ship."""
    return platformdirs.user_data_path("gsrain", appauthor=False)


def base_model_folders() -> tuple[Path, ...]:
    """Folders to search for SD-Turbo: GSRAIN_SD_TURBO if set, else the data folder and Hugging Face's cache."""
    own = os.environ.get(BASE_VARIABLE)
    return (Path(own),) if own else (data_folder() / "sd-turbo", *hub_snapshots(_HUB_NAME))


def is_base_model(folder: Path) -> bool:
    """True if a folder has UNet and autoencoder in diffusers' layout."""
    return all((folder / part / "config.json").is_file() for part in _PARTS)


def find_base_model(folder: Path | None = None) -> Path:
    """Find SD-Turbo's folder: the given one, or the first of `base_model_folders` that has it.

    Raises FileNotFoundError with the folders searched and download instructions.
    """
    places = base_model_folders() if folder is None else (folder,)
    for place in places:
        if is_base_model(place):
            return place
    looked = places if folder is not None or os.environ.get(BASE_VARIABLE) else (*places, _hub_cache(_HUB_NAME))
    where = " and ".join(map(str, looked))
    raise FileNotFoundError(f"no SD-Turbo (unet/config.json, vae/config.json) at {where}: {base_model_instructions()}")


def find_whole_base_model(folder: Path | None = None) -> Path:
    """Find SD-Turbo's folder as `find_base_model` does; raises FileNotFoundError if a part lacks its weights too."""
    found = find_base_model(folder)
    check_base_complete(found)
    return found


def check_base_complete(base: Path) -> None:
    """Raise FileNotFoundError if a part of SD-Turbo has a configuration but no weights, naming the folder."""
    for part in _PARTS:
        if not any((base / part).glob("diffusion_pytorch_model*.safetensors")):
            missing = f"{base / part}: no weights (diffusion_pytorch_model.safetensors)"
            raise FileNotFoundError(f"{missing}: {base_model_instructions()}")


def base_model_instructions() -> str:
    kinds = " ".join(f"--include '{kind}'" for kind in ("*.json", "*.txt", "*model.safetensors"))
    return (
        f"hf download {_HUB_NAME} {kinds} --local-dir {data_folder() / 'sd-turbo'} (5 GB, under the license of "
        f"Stability AI; older versions of the tool are called huggingface-cli), or name its folder by --base or "
        f"{BASE_VARIABLE}"
    )


def find_transfer_weights() -> Path:
    """Find transfer weights: the file or folder of GSRAIN_TRANSFER_WEIGHTS, else a folder of the user's.

    In a folder it is clear2rainy.pkl, else the first by name. Raises FileNotFoundError with download instructions.
    """
    place = Path(os.environ.get(WEIGHTS_VARIABLE) or data_folder() / "transfer")
    if place.is_file():
        return place
    files = sorted(file for file in place.glob("*") if file.suffix in _SUFFIXES)
    if files:
        return min(files, key=lambda file: file.name != "clear2rainy.pkl")
    raise FileNotFoundError(
        f"no transfer weights at {place}: put {PUBLISHED_URL} there, or name a file by --weights or {WEIGHTS_VARIABLE}"
    )


def text_encoder_folder(base: Path) -> Path | None:
    """Folder of the text encoder next to UNet and autoencoder; None if it or its tokenizer is missing."""
    found = (base / "text_encoder" / "config.json").is_file() and (base / "tokenizer").is_dir()
    return base / "text_encoder" if found else None


def captions_file() -> Path:
    """Cache file for embeddings of captions, so that the text encoder is needed only once."""
    return platformdirs.user_cache_path("gsrain", appauthor=False) / "captions" / "sd-turbo.safetensors"


def hub_snapshots(name: str) -> list[Path]:
    """Snapshots of a model in Hugging Face's cache, that of "main" first."""
    main = _hub_cache(name) / "refs" / "main"
    named = read_file(main, 1 << 10).decode("utf-8").strip() if main.is_file() else ""
    return sorted((_hub_cache(name) / "snapshots").glob("*"), key=lambda folder: (folder.name != named, folder.name))


def _hub_cache(name: str) -> Path:
    home = Path(os.environ.get("HF_HOME", Path.home() / ".cache" / "huggingface"))
    return Path(os.environ.get("HF_HUB_CACHE", home / "hub")) / f"models--{name.replace('/', '--')}"


# Record of the training, in the header of a weights file

TRAINING = "training"
"""Header field with the `TrainingRecord`."""
RANDOM_BASE = "random_base_seed"
"""Header field with the seed of random base weights, in tests."""


def read_record(path: Path) -> TrainingRecord | None:
    """Read the record of the training from the header of a file of ours; None for other files.

    Raises ValueError for a damaged record.
    """
    return record_in(_header(path), path)


def has_random_base(path: Path) -> bool:
    """True for a file of weights upon random ones, for a test, which needs no SD-Turbo. Raises as `read_record`."""
    return RANDOM_BASE in _header(path)


def _header(path: Path) -> dict[str, str]:
    if path.suffix != ".safetensors":
        return {}
    safetensors: Any = import_module("safetensors")
    try:
        check_file(path)
        with safetensors.safe_open(path, framework="np") as file:
            return dict(file.metadata() or {})
    except (safetensors.SafetensorError, OSError) as error:
        raise ValueError(f"{path}: not a readable .safetensors: {printable_line(error)}") from None


def record_in(metadata: Mapping[str, str], path: Path) -> TrainingRecord | None:
    """Record in the header of a file of ours; None if it has none. Raises ValueError if it is damaged."""
    if TRAINING not in metadata:
        return None
    try:
        return msgspec.json.decode(metadata[TRAINING], type=TrainingRecord)
    except msgspec.DecodeError as error:
        raise ValueError(f"{path}: the record of its training is damaged: {error}") from None
