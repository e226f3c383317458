"""A fine-tuning that is over in a second: two looks of small pictures, and networks of one level."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from gsrain_engine.appearance.cyclegan_turbo.model import TurboArchitecture, tiny
from gsrain_engine.appearance.finetune.dataset import open_images
from gsrain_engine.appearance.finetune.run import start_finetuning
from gsrain_engine.appearance.finetune.settings import FinetuningSettings, load_finetuning
from gsrain_engine.appearance.finetune.step import FinetuneTrainer

SIDE_PX = 16


def small() -> TurboArchitecture:
    """`tiny` with one level in place of four: the same kinds of layers."""
    full = tiny()
    unet = dict(full.unet) | {
        "attention_head_dim": [2],
        "block_out_channels": [8],
        "down_block_types": ["CrossAttnDownBlock2D"],
        "up_block_types": ["CrossAttnUpBlock2D"],
        "mid_block_type": None,
        "layers_per_block": 1,
    }
    vae = dict(full.vae) | {
        "block_out_channels": [8],
        "down_block_types": ["DownEncoderBlock2D"],
        "up_block_types": ["UpDecoderBlock2D"],
    }
    return replace(full, unet=unet, vae=vae)


def write_pictures(folder: Path, count: int = 5) -> tuple[Path, Path]:
    """Write bright colorful pictures, and dark gray ones of other places; returns the two folders."""
    random = np.random.default_rng(7)
    for look in ("clear", "rainy"):
        (folder / look).mkdir(parents=True)
        for i in range(count):
            blocks = np.kron(random.random((4, 4, 3)), np.ones((SIDE_PX // 4, SIDE_PX // 4, 1)))
            image = 0.35 + 0.6 * blocks if look == "clear" else 0.05 + 0.4 * blocks.mean(2, keepdims=True).repeat(3, 2)
            Image.fromarray((image * 255).astype(np.uint8)).save(folder / look / f"{i}.png")
    return folder / "clear", folder / "rainy"


def small_settings(folder: Path, **changes: Any) -> FinetuningSettings:
    """Settings of the shipped `tiny` with small pictures, which are written where they are not there.

    On the CPU, which alone promises the same bytes in every run.
    """
    if not (folder / "clear").is_dir():
        write_pictures(folder)
    sources = {look: [{"path": str(folder / look)}] for look in ("clear", "rainy")}
    pictures = sources | {"width_px": SIDE_PX, "height_px": SIDE_PX}
    default = {"pictures": pictures, "lora": {"unet": 4, "vae": 4}, "sampled_every": 0, "saved_every": 0, "samples": 1}
    default["device"] = "cpu"
    return load_finetuning("tiny", **(default | changes))


def small_start(settings: FinetuningSettings) -> FinetuneTrainer:
    return start_finetuning(settings, open_images(settings.pictures).train)
