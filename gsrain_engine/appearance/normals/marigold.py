"""Normals by Marigold (Ke et al. 2024), from a folder on the person's disk. Axes: turned from x right, y up, z back."""

from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float32

from gsrain_engine.scene.camera import Camera

from .axes import from_right_up_backward

torch: Any = import_module("torch")
diffusers: Any = import_module("diffusers")


@dataclass(frozen=True, slots=True, eq=False)
class MarigoldNormals:
    """A `MarigoldNormalsPipeline` that always starts from the same noise."""

    pipeline: Any
    seed: int = 0

    def normals(self, image: Float32[np.ndarray, "h w 3"], camera: Camera) -> Float32[np.ndarray, "h w 3"]:
        """Return unit world normals (z up) towards the eye of a display picture, 0..1."""
        noise = torch.Generator(device="cpu").manual_seed(self.seed)
        self.pipeline.set_progress_bar_config(disable=True)
        found = self.pipeline(np.ascontiguousarray(image), generator=noise, output_type="np").prediction[0]
        return from_right_up_backward(found.astype(np.float64), camera)


def open_marigold(folder: Path, device: str = "cpu") -> MarigoldNormals:
    """Open a pipeline in diffusers' layout; nothing is downloaded. Raises ValueError where the folder is another."""
    try:
        pipeline = diffusers.MarigoldNormalsPipeline.from_pretrained(str(folder), local_files_only=True)
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise ValueError(f"{folder}: not a MarigoldNormalsPipeline in diffusers' layout: {error}") from None
    return MarigoldNormals(pipeline if device == "cpu" else pipeline.to(device, torch.float16))
