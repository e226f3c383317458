"""The extractor of FID: Inception, in torch."""

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


# § Weights of Inception: where they are looked for, and whether they are the right ones.

INCEPTION_PLACE = "GSRAIN_INCEPTION_WEIGHTS"
"""Environment variable with a file of Inception's weights, or a folder with one."""

INCEPTION_CLASSES = 1008

_PUBLISHED = "6726825d"
"""What the SHA-256 of pytorch-fid's file starts with, as its name says."""

_HOW_INCEPTION = (
    f"set {INCEPTION_PLACE} to pt_inception-2015-12-05-6726825d.pth (of pytorch-fid's release fid_weights), or choose "
    "--extractor pixels16, which needs no weights and whose distance is no FID"
)


def inception_weights_file() -> Path:
    """Return the file of Inception's weights on this machine; raises FileNotFoundError, with how to get one."""
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
    """Whether a file's SHA-256 is that which pytorch-fid's file has in its name."""
    return digest.startswith(_PUBLISHED)


def is_torchscript(file: Path) -> bool:
    """Whether a file is TorchScript, told by the names in its archive: nothing in it is run."""
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
    """Read Inception's weights by the names of `inception.Inception`; raises as `matched_inception` does."""
    return matched_inception(read_arrays(file), str(file))


def matched_inception(arrays: Mapping[str, np.ndarray], source: str) -> dict[str, np.ndarray]:
    """Return exactly the arrays that Inception takes, each of the right shape.

    Raises ValueError, which names the source, for something else; ImageNet weights of torchvision, which have the same
    names and shapes and give other features, are told by their classes.
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
