"""What CycleGAN-Turbo is built of, as a value: configurations of SD-Turbo's three networks, and a small stand-in."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gsrain_engine.untrusted.limits import read_file
from gsrain_engine.untrusted.plain_values import MOST_BYTES


@dataclass(frozen=True, slots=True)
class TurboArchitecture:
    """Configurations as diffusers and transformers write them, and the noise schedule of the one step."""

    name: str
    """Stands in the header of our weights: "sd-turbo" or "tiny"."""
    unet: Mapping[str, Any]
    """Of UNet2DConditionModel."""
    vae: Mapping[str, Any]
    """Of AutoencoderKL, with three channels."""
    text: Mapping[str, Any]
    """Of CLIPTextModel."""
    betas: tuple[float, float] = (0.00085, 0.012)
    """Variances of the noise at the first and the last of `noise_steps`; their roots grow in equal steps between."""
    noise_steps: int = 1000

    @property
    def side_multiple(self) -> int:
        """Picture sides must be multiples of this, in pixels."""
        return 2 ** (len(self.vae["block_out_channels"]) - 1)

    @property
    def caption_shape(self) -> tuple[int, int, int]:
        """Of what the UNet takes for a caption: 1, tokens, features."""
        return 1, self.text["max_position_embeddings"], self.unet["cross_attention_dim"]


def sd_turbo() -> TurboArchitecture:
    """Architecture of stabilityai/sd-turbo, which is that of Stable Diffusion 2.1 (base)."""
    unet = {
        "attention_head_dim": [5, 10, 20, 20],
        "block_out_channels": [320, 640, 1280, 1280],
        "cross_attention_dim": 1024,
        "sample_size": 64,
        "use_linear_projection": True,
    }
    vae = _vae([128, 256, 512, 512], layers=2, groups=32) | {"sample_size": 768}
    text = {
        "vocab_size": 49408,
        "hidden_size": 1024,
        "intermediate_size": 4096,
        "num_hidden_layers": 23,
        "num_attention_heads": 16,
        "max_position_embeddings": 77,
        "hidden_act": "gelu",
    }
    return TurboArchitecture("sd-turbo", unet, vae, text)


def tiny() -> TurboArchitecture:
    """Stand-in of the same classes, blocks and layer names: a forward pass takes a fraction of a second."""
    unet = {
        "attention_head_dim": [2, 2, 4, 4],
        "block_out_channels": [8, 8, 16, 16],
        "cross_attention_dim": 16,
        "norm_num_groups": 4,
        "sample_size": 8,
        "use_linear_projection": True,
    }
    text = {
        "vocab_size": 64,
        "hidden_size": 16,
        "intermediate_size": 32,
        "num_hidden_layers": 2,
        "num_attention_heads": 2,
        "max_position_embeddings": 77,
        "hidden_act": "gelu",
    }
    return TurboArchitecture("tiny", unet, _vae([8, 8, 16, 16], layers=1, groups=4), text)


ARCHITECTURES = {"sd-turbo": sd_turbo, "tiny": tiny}
"""By the names that our weights carry."""


def check_base(folder: Path, architecture: TurboArchitecture) -> None:
    """Raise ValueError where a folder in diffusers' layout holds another architecture, naming file and field.

    Only what is written down is compared: a field that the file leaves out has its class's default value there.
    """
    for part, wanted in (("unet", architecture.unet), ("vae", architecture.vae)):
        _check(folder / part / "config.json", dict(wanted))
    schedule = {
        "prediction_type": "epsilon",
        "beta_schedule": "scaled_linear",
        "beta_start": architecture.betas[0],
        "beta_end": architecture.betas[1],
        "num_train_timesteps": architecture.noise_steps,
    }
    _check(folder / "scheduler" / "scheduler_config.json", schedule)


def _check(file: Path, wanted: Mapping[str, Any]) -> None:
    try:
        found: Any = json.loads(read_file(file, MOST_BYTES).decode("utf-8"))
    except OSError as error:
        raise FileNotFoundError(f"{file}: no such file; a folder of SD-Turbo in diffusers' layout has it") from error
    except ValueError as error:
        raise ValueError(f"{file}: not readable JSON: {error}") from error
    if not isinstance(found, dict):
        raise ValueError(f"{file}: a JSON object is wanted here")
    for key, value in wanted.items():
        if key not in ("sample_size",) and key in found and found[key] != value:
            raise ValueError(f"{file}: {key} is {found[key]!r}, but CycleGAN-Turbo builds on SD-Turbo with {value!r}")


def _vae(channels: list[int], *, layers: int, groups: int) -> dict[str, Any]:
    return {
        "block_out_channels": channels,
        "down_block_types": ["DownEncoderBlock2D"] * len(channels),
        "up_block_types": ["UpDecoderBlock2D"] * len(channels),
        "layers_per_block": layers,
        "norm_num_groups": groups,
        "latent_channels": 4,
        "scaling_factor": 0.18215,
    }
