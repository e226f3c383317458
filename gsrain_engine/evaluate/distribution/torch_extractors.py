"""The extractor of FID: Inception, in torch."""

from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float32, UInt8

from ..weight_file import hash_of
from . import inception
from .extractor import Extractor, ExtractorChoice
from .frozen_network import filled
from .network_weights import inception_weights, inception_weights_file, is_published_inception, is_torchscript
from .resizing import resized

torch: Any = import_module("torch")

_SHORT, _KEY = 8, 16
"""Digits of a hash that a person reads, and that tell kept features apart."""


def open_inception(choice: ExtractorChoice) -> Extractor:
    """Return "FID": the 2048 features of Inception before its classes, of pictures at 299x299 (`resized`).

    Weights are those of pytorch-fid (.pth, or converted to .safetensors or .npz) in our own network, or NVIDIA's
    TorchScript, which clean-fid takes; both stem from one TensorFlow file. A TorchScript file brings its own program,
    which torch.jit.load runs: torch keeps it from files and processes, but it may use up memory or time, and gives
    whatever it gives. It is only run where `allows_torchscript` says so; plain arrays are the better choice.

    Raises ValueError for another file, and FileNotFoundError, with how to get one.
    """
    check_device(choice.device)
    file = choice.weights or inception_weights_file()
    if not file.is_file():
        raise FileNotFoundError(f"{file}: no such file")
    digest, size = hash_of(file), inception.SIZE_PX
    if not is_torchscript(file):
        network, kind = filled(inception.Inception, inception_weights(file)), "weights"
    elif choice.allows_torchscript:
        network, kind = _torchscript_layers(file), "TorchScript"
    else:
        raise ValueError(
            f"{file}: is TorchScript, which brings a program of its own; take .pth or .safetensors, or allow it by "
            "--torchscript where you trust its source"
        )
    known = ", as published by pytorch-fid" if is_published_inception(digest) else ""
    return Extractor(
        metric="FID",
        described=f"Inception-v3 of 2015 ({kind} {digest[:_SHORT]}{known}), {size}x{size} px",
        features=inception.FEATURES,
        key=f"inception-{digest[:_KEY]}",
        function=_runner(network, size, choice.device),
    )


def check_device(device: str) -> None:
    """Raise ValueError where torch can't compute on a device."""
    if device != "cpu" and not torch.cuda.is_available():
        raise ValueError(f"device {device}: torch sees no CUDA device")


def _runner(
    network: Any, size_px: int, device: str
) -> Callable[[UInt8[np.ndarray, "h w 3"]], Float32[np.ndarray, " d"]]:
    placed = network.to(device)

    def features(image: UInt8[np.ndarray, "h w 3"]) -> Float32[np.ndarray, " d"]:
        sized = torch.from_numpy(resized(image, size_px, size_px)).permute(2, 0, 1)[None].to(device)
        with torch.no_grad():
            return placed(sized).reshape(-1).float().cpu().numpy()

    return features


def _torchscript_layers(file: Path) -> "_Scaled":
    try:
        return _Scaled(torch.jit.load(str(file), map_location="cpu").eval().layers)
    except (RuntimeError, AttributeError) as error:
        raise ValueError(f"{file}: not the TorchScript of Inception: {str(error).splitlines()[0]}") from None


class _Scaled:
    """The layers of NVIDIA's file behind TensorFlow's scaling, as clean-fid calls them."""

    def __init__(self, layers: Any) -> None:
        self._layers = layers

    def to(self, device: str) -> "_Scaled":
        return _Scaled(self._layers.to(device))

    def __call__(self, pictures: Any) -> Any:
        return self._layers((pictures - 128) / 128)
