"""Extractors that are networks: Inception for FID, and others for distances under names of their own."""

import hashlib
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float32, UInt8

from ..lpips import Lpips
from ..lpips_weights import LpipsWeights, Network, find_lpips_weights, read_lpips_weights
from ..weight_file import hash_of
from . import efficientnet_lite, inception
from .extractor import Extractor, ExtractorChoice
from .frozen_network import filled
from .network_weights import (
    efficientnet_weights,
    efficientnet_weights_file,
    inception_weights,
    inception_weights_file,
    is_published_inception,
    is_torchscript,
)
from .resizing import resized

torch: Any = import_module("torch")

_LPIPS_SIZE_PX = 224
_SHORT, _KEY = 8, 16
"""Digits of a hash that a person reads, and that tell kept features apart."""

_TITLES: dict[Network, str] = {"vgg": "VGG16", "alex": "AlexNet"}


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


def open_efficientnet(choice: ExtractorChoice) -> Extractor:
    """Return "FD-EfficientNet-Lite0": its 1280 features before the classes, of pictures at 224x224 (`resized`).

    Raises as `open_inception` does.
    """
    check_device(choice.device)
    file = choice.weights or efficientnet_weights_file()
    weights = efficientnet_weights(file)
    digest, size = hash_of(file), efficientnet_lite.SIZE_PX
    return Extractor(
        metric="FD-EfficientNet-Lite0",
        described=f"EfficientNet-Lite0 (weights {digest[:_SHORT]}), {size}x{size} px",
        features=efficientnet_lite.FEATURES,
        key=f"efficientnet-lite0-{digest[:_KEY]}",
        function=_runner(filled(efficientnet_lite.EfficientNetLite0, weights), size, choice.device),
    )


def open_lpips_network(choice: ExtractorChoice, network: Network) -> Extractor:
    """Return "FD-VGG16" (512 features) or "FD-AlexNet" (256): means over the last convolution that LPIPS looks at.

    Of pictures at 224x224 (`resized`), with the person's weights of LPIPS. Raises as `open_inception` does.
    """
    check_device(choice.device)
    weights = find_lpips_weights(network) if choice.weights is None else read_lpips_weights(choice.weights)
    if weights.network != network:
        raise ValueError(f"{choice.weights}: holds {_TITLES[weights.network]}, not {_TITLES[network]}")
    model, digest = Lpips(weights).to(choice.device), _digest(weights)

    def features(image: UInt8[np.ndarray, "h w 3"]) -> Float32[np.ndarray, " d"]:
        sized = torch.from_numpy(resized(image, _LPIPS_SIZE_PX, _LPIPS_SIZE_PX) / np.float32(255))
        with torch.no_grad():
            return model.features(sized.to(choice.device))[-1].mean(dim=(1, 2)).cpu().numpy()

    title, size = _TITLES[network], f"{_LPIPS_SIZE_PX}x{_LPIPS_SIZE_PX}"
    return Extractor(
        metric=f"FD-{title}",
        described=f"{title} (weights {digest[:_SHORT]}), {size} px",
        features=len(weights.biases[-1]),
        key=f"{title.lower()}-{digest[:_KEY]}",
        function=features,
    )


def _digest(weights: LpipsWeights) -> str:
    """Hash of the convolutions: files of several layouts hold the same ones."""
    found = hashlib.sha256()
    for array in (*weights.kernels, *weights.biases):
        found.update(array.tobytes())
    return found.hexdigest()


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
