"""Where CLIP's vision model, by which discriminators see, is looked for, and how to get it. Needs no torch."""

import os
from pathlib import Path

from gsrain_engine.appearance.cyclegan_turbo.places import data_folder, hub_snapshots

PLACE = "GSRAIN_CLIP"
"""Environment variable with the folder of CLIP ViT-B/32 in the layout of transformers."""

_HUB_NAME = "openai/clip-vit-base-patch32"
_OWN = "clip-vit-base-patch32"


def clip_places() -> tuple[Path, ...]:
    """Folders in which it may lie: that of GSRAIN_CLIP if set, else the data folder and Hugging Face's cache."""
    own = os.environ.get(PLACE)
    return (Path(own),) if own else (data_folder() / _OWN, *hub_snapshots(_HUB_NAME))


def find_clip(folder: Path | None = None) -> Path:
    """Find the folder: the given one, or the first place that has it.

    Raises FileNotFoundError, with where it was looked for and how to get it.
    """
    places = clip_places() if folder is None else (folder,)
    for place in places:
        if (place / "config.json").is_file():
            return place
    looked = " and ".join(map(str, places))
    raise FileNotFoundError(
        f"no CLIP ViT-B/32 (config.json) at {looked}: hf download {_HUB_NAME} --local-dir {data_folder() / _OWN} "
        f"(600 MB; huggingface-cli download in older versions), or set {PLACE}"
    )
