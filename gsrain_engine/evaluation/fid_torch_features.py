"""The Inception extractor of FID in torch, with its weight files."""

import os
import zipfile
from collections.abc import Callable, Mapping
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import platformdirs
from jaxtyping import Float32, UInt8

from ..safe_io.limits import open_file
from . import networks
from .fid_features import Extractor, ExtractorChoice, resized
from .lpips_weights import SUFFIXES, hash_of, read_arrays
from .networks import build_with_weights

torch: Any = import_module("torch")
_SHORT, _KEY = 8, 16  # digits of a hash in descriptions and in cache keys


def open_inception(choice: ExtractorChoice) -> Extractor:
    """Return "FID": the 2048 features of Inception before its classifier, of images at 299x299 (`resized`).

    Weights are those of pytorch-fid (.pth, or converted to .safetensors or .npz) in our own network, or NVIDIA's
    TorchScript, as in clean-fid; both derive from one TensorFlow file. A TorchScript file contains a program that
    torch.jit.load runs: it has no access to files and processes, but may exhaust memory or time, and its output is not
    checked. It runs only if `allows_torchscript` is set; plain arrays are safer. Raises ValueError for another file,
    and FileNotFoundError with download instructions.
    """
    check_device(choice.device)
    file = choice.weights or inception_weights_file()
    if not file.is_file():
        raise FileNotFoundError(f"{file}: no such file")
    digest, size = hash_of(file), networks.INCEPTION_SIZE_PX
    if not is_torchscript(file):
        network, kind = build_with_weights(networks.Inception, inception_weights(file)), "weights"
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
        features=networks.INCEPTION_FEATURES,
        key=f"inception-{digest[:_KEY]}",
        function=_runner(network, size, choice.device),
    )


def check_device(device: str) -> None:
    """Raise ValueError if torch can't use a device."""
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
    """The layers of NVIDIA's file after TensorFlow's scaling, called as in clean-fid."""

    def __init__(self, layers: Any) -> None:
        self._layers = layers

    def to(self, device: str) -> "_Scaled":
        return _Scaled(self._layers.to(device))

    def __call__(self, pictures: Any) -> Any:
        return self._layers((pictures - 128) / 128)


# Inception weights

INCEPTION_PLACE = "GSRAIN_INCEPTION_WEIGHTS"
"""Environment variable with a file of Inception's weights, or a folder with one."""

INCEPTION_CLASSES = 1008
_PUBLISHED = "6726825d"  # first digits of the SHA-256 of pytorch-fid's file, as in its name

_HOW_INCEPTION = (
    f"set {INCEPTION_PLACE} to pt_inception-2015-12-05-6726825d.pth (of pytorch-fid's release fid_weights), or choose "
    "--extractor pixels16, which needs no weights and whose distance is no FID"
)


def inception_weights_file() -> Path:
    """Return this machine's Inception weights file; raises FileNotFoundError with download instructions."""
    own = os.environ.get(INCEPTION_PLACE)
    place = Path(own) if own else platformdirs.user_data_path("gsrain", appauthor=False) / "inception"
    if place.is_file():
        return place
    files = [file for file in sorted(place.glob("*nception*")) if file.suffix in SUFFIXES] if place.is_dir() else []
    if not files:
        raise FileNotFoundError(f"no weights of Inception (for FID) at {place}: {_HOW_INCEPTION}")
    plain = [file for file in files if not is_torchscript(file)]
    return (plain or files)[0]


def is_published_inception(digest: str) -> bool:
    """Return whether a SHA-256 matches the one in the name of pytorch-fid's file."""
    return digest.startswith(_PUBLISHED)


def is_torchscript(file: Path) -> bool:
    """Return whether a file is TorchScript, from the names in its archive, without running it."""
    try:
        stream = open_file(file)
    except OSError:
        return False
    with stream:
        if not zipfile.is_zipfile(stream):
            return False
        with zipfile.ZipFile(stream) as archive:
            return any("/code/" in name or name.endswith("constants.pkl") for name in archive.namelist())


def inception_weights(file: Path) -> dict[str, np.ndarray]:
    """Read Inception's weights by the names of `networks.Inception`; raises as `matched_inception` does."""
    return matched_inception(read_arrays(file), str(file))


def matched_inception(arrays: Mapping[str, np.ndarray], source: str) -> dict[str, np.ndarray]:
    """Return exactly the arrays that Inception requires, with checked shapes.

    Raises ValueError with the source for other content; torchvision's ImageNet weights, which have the same names and
    shapes but different features, are detected by their number of classes.
    """
    from .networks import (
        Inception,
        build_without_weights,  # torch is an extra
    )

    classes = arrays.get("fc.weight")
    if classes is not None and len(classes) != INCEPTION_CLASSES:
        raise ValueError(
            f"{source}: Inception of {len(classes)} classes, such as torchvision's; FID is defined with that of "
            f"{INCEPTION_CLASSES} (pt_inception-2015-12-05)"
        )
    if any(name.startswith("AuxLogits.") for name in arrays):
        raise ValueError(f"{source}: Inception with AuxLogits, such as torchvision's; FID's has none")
    wanted = {name: tuple(each.shape) for name, each in build_without_weights(Inception).state_dict().items()}
    unused = ("num_batches_tracked", "fc.weight", "fc.bias")
    given = {name: array for name, array in arrays.items() if not name.endswith(unused)}
    for name, shape in wanted.items():
        if name not in given:
            raise ValueError(f"{source}: not the weights of Inception: {name} is missing")
        if given[name].shape != shape:
            raise ValueError(f"{source}: not the weights of Inception: {name} is {given[name].shape}, expected {shape}")
    too_much = sorted(set(given) - set(wanted))
    if too_much:
        raise ValueError(f"{source}: not the weights of Inception: it has no {too_much[0]}")
    return {name: np.ascontiguousarray(array, np.float32) for name, array in given.items()}
