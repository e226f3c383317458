"""Normal estimators DSINE (Bae and Davison 2024) and Marigold (Ke et al. 2024), run from local weights.

DSINE runs from the user's checkout: its license (Imperial College) allows only non-commercial use and no
redistribution, so neither code nor weights are part of this program.
"""

from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from ..safe_io.limits import check_zip_expansion, open_file
from ..scene.camera import Camera
from .base import Image
from .dsine_checkout import dsine_module

torch: Any = import_module("torch")
SIDE_PX = 32  # input width and height must be multiples of this
_MEAN, _DEVIATION = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)  # ImageNet statistics of display color, 0..1


@dataclass(frozen=True, slots=True, eq=False)
class DsineNormals:
    """DSINE's module: `module(image, intrins=(1, 3, 3))` returns a list whose last item is (1, 3 or more, h, w).

    Its normals have axes x right, y down, z forward and point away from the eye.
    """

    module: Any
    device: str = "cpu"

    def normals(self, image: Image, camera: Camera) -> Image:
        """Return unit world normals (z up) towards the eye, from a display image (0..1)."""
        height, width = image.shape[:2]
        left, top = -width % SIDE_PX // 2, -height % SIDE_PX // 2
        right, bottom = -width % SIDE_PX - left, -height % SIDE_PX - top
        picture = torch.from_numpy(np.ascontiguousarray(image)).permute(2, 0, 1)[None].to(self.device)
        # Pad with black before the colors are normalized, so that the border reads as black pixels.
        padded = torch.nn.functional.pad(picture, (left, right, top, bottom))
        mean, deviation = (torch.tensor(v, device=self.device)[:, None, None] for v in (_MEAN, _DEVIATION))
        # DSINE's pixel centers lie at whole numbers, ours at halves.
        cx, cy = camera.cx - 0.5 + left, camera.cy - 0.5 + top
        intrinsics = torch.tensor([[[camera.fx, 0, cx], [0, camera.fy, cy], [0, 0, 1]]], device=self.device)
        with torch.inference_mode():
            output = self.module((padded - mean) / deviation, intrins=intrinsics)[-1]
        found = output[0, :3, top : top + height, left : left + width].permute(1, 2, 0).double().cpu().numpy()
        unit = found / np.maximum(np.linalg.norm(found, axis=-1, keepdims=True), 1e-9)
        return from_right_down_outward(unit, camera)


def open_dsine(checkout: Path, weights: Path, device: str = "cpu") -> DsineNormals:
    """Build DSINE from a checkout and load its weights.

    Raises ValueError if the folder is not DSINE's code, the file is not its weights, or `geffnet` is not installed.
    """
    try:
        with open_file(weights) as stream:
            check_zip_expansion(stream, weights)
            state = torch.load(stream, map_location="cpu", weights_only=True)["model"]
        state = {key.removeprefix("module."): value for key, value in state.items()}
    except Exception as error:  # torch raises many types for a file of another kind
        raise ValueError(f"{weights}: not DSINE's weights ({type(error).__name__}: {error})") from None
    module = dsine_module(checkout, estimates_uncertainty=any(key.startswith("kappa_head.") for key in state))
    try:
        module.load_state_dict(state, strict=True)
    except RuntimeError as error:
        raise ValueError(f"{weights}: these weights are not for the program in {checkout}: {error}") from None
    module.pixel_coords = module.pixel_coords.to(device)
    return DsineNormals(module.eval().to(device), device)


# Marigold. Its axes: x right, y up, z back.

diffusers: Any = import_module("diffusers")


@dataclass(frozen=True, slots=True, eq=False)
class MarigoldNormals:
    """`MarigoldNormalsPipeline` that always starts from the same noise."""

    pipeline: Any
    seed: int = 0

    def normals(self, image: Image, camera: Camera) -> Image:
        """Return unit world normals (z up) towards the eye, from a display image (0..1)."""
        noise = torch.Generator(device="cpu").manual_seed(self.seed)
        self.pipeline.set_progress_bar_config(disable=True)
        found = self.pipeline(np.ascontiguousarray(image), generator=noise, output_type="np").prediction[0]
        return from_right_up_backward(found.astype(np.float64), camera)


def open_marigold(folder: Path, device: str = "cpu") -> MarigoldNormals:
    """Open a pipeline in diffusers' layout without downloads. Raises ValueError for a folder of another kind."""
    try:
        pipeline = diffusers.MarigoldNormalsPipeline.from_pretrained(str(folder), local_files_only=True)
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise ValueError(f"{folder}: not a MarigoldNormalsPipeline in diffusers' layout: {error}") from None
    return MarigoldNormals(pipeline if device == "cpu" else pipeline.to(device, torch.float16))


# Axis conventions of the models. World normals point towards the eye.


def from_right_down_outward(normals: Float[np.ndarray, "h w 3"], camera: Camera) -> Image:
    """Turn normals in camera axes (x right, y down, z forward) away from the eye into world normals towards it."""
    return (-(normals @ camera.world_to_camera[:3, :3])).astype(np.float32)


def from_right_up_backward(normals: Float[np.ndarray, "h w 3"], camera: Camera) -> Image:
    """Turn normals with x right, y up, z towards the eye, which point towards the eye, into world normals.

    Marigold's convention (Ke et al. 2024): a wall that faces the camera has (0, 0, 1), the ground (0, 1, 0).
    """
    return ((normals * [1, -1, -1]) @ camera.world_to_camera[:3, :3]).astype(np.float32)
