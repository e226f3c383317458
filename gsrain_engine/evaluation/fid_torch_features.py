"""The Inception extractor of FID in torch: its network, built without initialization, and its weight files."""

import os
import zipfile
from collections.abc import Callable, Mapping
from functools import partial
from importlib import import_module
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
import platformdirs
from jaxtyping import Float32, UInt8

from ..safe_io.limits import open_file
from .fid_features import Extractor, ExtractorChoice, resized
from .lpips_weights import SUFFIXES, hash_of, read_arrays

torch: Any = import_module("torch")
Tensor = Any
_SIZE_PX = 299


def open_inception(choice: ExtractorChoice) -> Extractor:
    """Return "FID": the 2048 features of Inception before its classifier, of images at 299x299 (`resized`).

    Weights are those of pytorch-fid (.pth, or converted to .safetensors or .npz) in our own network, or NVIDIA's
    TorchScript, as in clean-fid; both derive from one TensorFlow file. A TorchScript file contains a program that
    torch.jit.load runs: it has no access to files and processes, but may exhaust memory or time, and its output is not
    checked. It runs only if `allows_torchscript` is set; plain arrays are safer. Raises ValueError for another file,
    and FileNotFoundError with download instructions.
    """
    if choice.device != "cpu" and not torch.cuda.is_available():
        raise ValueError(f"device {choice.device}: torch sees no CUDA device")
    file = choice.weights or inception_weights_file()
    if not file.is_file():
        raise FileNotFoundError(f"{file}: no such file")
    digest, is_script = hash_of(file), is_torchscript(file)
    if is_script and not choice.allows_torchscript:
        raise ValueError(
            f"{file}: is TorchScript, which brings a program of its own; take .pth or .safetensors, or allow it by "
            "--torchscript where you trust its source"
        )
    network = _torchscript_layers(file) if is_script else build_with_weights(Inception, inception_weights(file))
    network = network.to(choice.device)

    def features(image: UInt8[np.ndarray, "h w 3"]) -> Float32[np.ndarray, " d"]:
        values = torch.from_numpy(resized(image, _SIZE_PX, _SIZE_PX)).permute(2, 0, 1)[None].to(choice.device)
        with torch.no_grad():
            return network((values - 128) / 128 if is_script else values).reshape(-1).float().cpu().numpy()

    kind = "TorchScript" if is_script else "weights"
    known = ", as published by pytorch-fid" if digest.startswith(_PUBLISHED) else ""
    return Extractor(
        metric="FID",
        described=f"Inception-v3 of 2015 ({kind} {digest[:8]}{known}), {_SIZE_PX}x{_SIZE_PX} px",
        features=2048,
        key=f"inception-{digest[:16]}",
        function=features,
    )


def _torchscript_layers(file: Path) -> Any:
    """The layers of NVIDIA's file; like clean-fid, callers apply TensorFlow's scaling before them."""
    try:
        return torch.jit.load(str(file), map_location="cpu").eval().layers
    except (RuntimeError, AttributeError) as error:
        raise ValueError(f"{file}: not the TorchScript of Inception: {str(error).splitlines()[0]}") from None


# Inception weights

INCEPTION_PLACE = "GSRAIN_INCEPTION_WEIGHTS"
"""Environment variable with a file of Inception's weights, or a folder with one."""

_CLASSES = 1008
_PUBLISHED = "6726825d"  # first digits of the SHA-256 of pytorch-fid's file, as in its name


def inception_weights_file() -> Path:
    """Return this machine's Inception weights file; raises FileNotFoundError with download instructions."""
    own = os.environ.get(INCEPTION_PLACE)
    place = Path(own) if own else platformdirs.user_data_path("gsrain", appauthor=False) / "inception"
    if place.is_file():
        return place
    files = [file for file in sorted(place.glob("*nception*")) if file.suffix in SUFFIXES] if place.is_dir() else []
    if not files:
        raise FileNotFoundError(
            f"no weights of Inception (for FID) at {place}: set {INCEPTION_PLACE} to "
            "pt_inception-2015-12-05-6726825d.pth (of pytorch-fid's release fid_weights), or choose --extractor "
            "pixels16, which needs no weights and whose distance is no FID"
        )
    return next((file for file in files if not is_torchscript(file)), files[0])


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
    classes = arrays.get("fc.weight")
    if classes is not None and len(classes) != _CLASSES:
        raise ValueError(
            f"{source}: Inception of {len(classes)} classes, such as torchvision's; FID is defined with that of "
            f"{_CLASSES} (pt_inception-2015-12-05)"
        )
    if any(name.startswith("AuxLogits.") for name in arrays):
        raise ValueError(f"{source}: Inception with AuxLogits, such as torchvision's; FID's has none")
    expected = {name: tuple(each.shape) for name, each in build_without_weights(Inception).state_dict().items()}
    unused = ("num_batches_tracked", "fc.weight", "fc.bias")
    found = {name: array for name, array in arrays.items() if not name.endswith(unused)}
    for name, shape in expected.items():
        if name not in found:
            raise ValueError(f"{source}: not the weights of Inception: {name} is missing")
        if found[name].shape != shape:
            raise ValueError(f"{source}: not the weights of Inception: {name} is {found[name].shape}, expected {shape}")
    too_much = sorted(set(found) - set(expected))
    if too_much:
        raise ValueError(f"{source}: not the weights of Inception: it has no {too_much[0]}")
    return {name: np.ascontiguousarray(array, np.float32) for name, array in found.items()}


# Inception network
# Szegedy et al. 2016 (Inception v3) as Heusel et al. 2017 took it from TensorFlow's files of 2015-12-05, with the parts
# named as in the published weights. It differs from torchvision's in three ways: average pools exclude the padding from
# the mean (blocks A, C and E), the last block uses max pooling, and there are 1008 classes.

Shape = tuple[int, int, tuple[int, int], int, tuple[int, int]]
"""Channels in and out, size, stride and padding (height, width) of a convolution."""

Branch = list[str | dict[str, Shape]]
"""Steps of a branch: a pool, or parallel convolutions by name, whose outputs are concatenated."""


class Inception(torch.nn.Module):
    """Features of images (b, 3, 299, 299) of display values 0..255: (b, 2048), the mean over the last block."""

    def __init__(self) -> None:
        super().__init__()
        for name, shape in _STEM.items():
            self.add_module(name, _Convolution(shape))
        for name, branches in _BLOCKS.items():
            self.add_module(name, _Block(branches))

    def forward(self, pictures: Tensor) -> Tensor:
        """Return features of images; TensorFlow's scaling of 2015 is (v - 128) / 128."""
        flow = (pictures - 128) / 128
        for name in _STEM:
            flow = getattr(self, name)(flow)
            if name in _POOLED_AFTER:
                flow = torch.nn.functional.max_pool2d(flow, 3, 2)
        for name in _BLOCKS:
            flow = getattr(self, name)(flow)
        return flow.mean(dim=(2, 3))


class _Convolution(torch.nn.Module):
    def __init__(self, shape: Shape) -> None:
        super().__init__()
        inward, outward, size, stride, padding = shape
        self.conv = torch.nn.Conv2d(inward, outward, size, stride, padding, bias=False)
        self.bn = FrozenNorm(outward)

    def forward(self, flow: Tensor) -> Tensor:
        return self.bn(self.conv(flow)).relu()


class _Block(torch.nn.Module):
    """Branches from the same input, whose outputs are concatenated."""

    def __init__(self, branches: list[Branch]) -> None:
        super().__init__()
        self._branches = branches
        for step in chain.from_iterable(branches):
            if not isinstance(step, str):
                for name, shape in step.items():
                    self.add_module(name, _Convolution(shape))

    def forward(self, flow: Tensor) -> Tensor:
        return torch.cat([self._through(branch, flow) for branch in self._branches], 1)

    def _through(self, branch: Branch, flow: Tensor) -> Tensor:
        for step in branch:
            if isinstance(step, str):
                flow = _POOLS[step](flow)
            else:
                flow = torch.cat([getattr(self, name)(flow) for name in step], 1)
        return flow


_POOLS: dict[str, Any] = {
    "average": partial(torch.nn.functional.avg_pool2d, kernel_size=3, stride=1, padding=1, count_include_pad=False),
    "maximum": partial(torch.nn.functional.max_pool2d, kernel_size=3, stride=1, padding=1),
    "halving": partial(torch.nn.functional.max_pool2d, kernel_size=3, stride=2),
}


def _shape(inward: int, outward: int, height: int = 1, width: int = 0, stride: int = 1, pad: bool = True) -> Shape:
    width = width or height
    return inward, outward, (height, width), stride, (height // 2, width // 2) if pad and stride == 1 else (0, 0)


_STEM: dict[str, Shape] = {
    "Conv2d_1a_3x3": _shape(3, 32, 3, stride=2),
    "Conv2d_2a_3x3": _shape(32, 32, 3, pad=False),
    "Conv2d_2b_3x3": _shape(32, 64, 3),
    "Conv2d_3b_1x1": _shape(64, 80),
    "Conv2d_4a_3x3": _shape(80, 192, 3, pad=False),
}
_POOLED_AFTER = ("Conv2d_2b_3x3", "Conv2d_4a_3x3")


def _block_a(inward: int, pooled: int) -> list[Branch]:
    return [
        [{"branch1x1": _shape(inward, 64)}],
        [{"branch5x5_1": _shape(inward, 48)}, {"branch5x5_2": _shape(48, 64, 5)}],
        [
            {"branch3x3dbl_1": _shape(inward, 64)},
            {"branch3x3dbl_2": _shape(64, 96, 3)},
            {"branch3x3dbl_3": _shape(96, 96, 3)},
        ],
        ["average", {"branch_pool": _shape(inward, pooled)}],
    ]


def _block_c(inward: int, inner: int) -> list[Branch]:
    return [
        [{"branch1x1": _shape(inward, 192)}],
        [
            {"branch7x7_1": _shape(inward, inner)},
            {"branch7x7_2": _shape(inner, inner, 1, 7)},
            {"branch7x7_3": _shape(inner, 192, 7, 1)},
        ],
        [
            {"branch7x7dbl_1": _shape(inward, inner)},
            {"branch7x7dbl_2": _shape(inner, inner, 7, 1)},
            {"branch7x7dbl_3": _shape(inner, inner, 1, 7)},
            {"branch7x7dbl_4": _shape(inner, inner, 7, 1)},
            {"branch7x7dbl_5": _shape(inner, 192, 1, 7)},
        ],
        ["average", {"branch_pool": _shape(inward, 192)}],
    ]


def _block_e(inward: int, pool: str) -> list[Branch]:
    return [
        [{"branch1x1": _shape(inward, 320)}],
        [
            {"branch3x3_1": _shape(inward, 384)},
            {"branch3x3_2a": _shape(384, 384, 1, 3), "branch3x3_2b": _shape(384, 384, 3, 1)},
        ],
        [
            {"branch3x3dbl_1": _shape(inward, 448)},
            {"branch3x3dbl_2": _shape(448, 384, 3)},
            {"branch3x3dbl_3a": _shape(384, 384, 1, 3), "branch3x3dbl_3b": _shape(384, 384, 3, 1)},
        ],
        [pool, {"branch_pool": _shape(inward, 192)}],
    ]


_BLOCKS: dict[str, list[Branch]] = {
    "Mixed_5b": _block_a(192, 32),
    "Mixed_5c": _block_a(256, 64),
    "Mixed_5d": _block_a(288, 64),
    "Mixed_6a": [
        [{"branch3x3": _shape(288, 384, 3, stride=2)}],
        [
            {"branch3x3dbl_1": _shape(288, 64)},
            {"branch3x3dbl_2": _shape(64, 96, 3)},
            {"branch3x3dbl_3": _shape(96, 96, 3, stride=2)},
        ],
        ["halving"],
    ],
    "Mixed_6b": _block_c(768, 128),
    "Mixed_6c": _block_c(768, 160),
    "Mixed_6d": _block_c(768, 160),
    "Mixed_6e": _block_c(768, 192),
    "Mixed_7a": [
        [{"branch3x3_1": _shape(768, 192)}, {"branch3x3_2": _shape(192, 320, 3, stride=2)}],
        [
            {"branch7x7x3_1": _shape(768, 192)},
            {"branch7x7x3_2": _shape(192, 192, 1, 7)},
            {"branch7x7x3_3": _shape(192, 192, 7, 1)},
            {"branch7x7x3_4": _shape(192, 192, 3, stride=2)},
        ],
        ["halving"],
    ],
    "Mixed_7b": _block_e(1280, "average"),
    "Mixed_7c": _block_e(2048, "maximum"),
}


class FrozenNorm(torch.nn.Module):
    """Batch normalization with given statistics, with torch's parameter names; epsilon is TensorFlow's, 0.001."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        for name in ("weight", "bias", "running_mean", "running_var"):
            self.register_buffer(name, torch.zeros(channels))

    def forward(self, flow: Tensor) -> Tensor:
        scales = (self.running_mean, self.running_var, self.weight, self.bias)
        return torch.nn.functional.batch_norm(flow, *scales, eps=1e-3)


def build_without_weights(make: Callable[[], Any]) -> Any:
    """Build a network on the meta device: names and shapes without values."""
    with torch.device("meta"):
        return make()


def build_with_weights(make: Callable[[], Any], arrays: Mapping[str, np.ndarray]) -> Any:
    """Build a network from exactly these arrays, by name; raises RuntimeError if names or shapes differ."""
    network = build_without_weights(make)
    network.load_state_dict({name: torch.from_numpy(array.copy()) for name, array in arrays.items()}, assign=True)
    return network.requires_grad_(False).eval()
