"""The Inception extractor of FID in torch: its network, built without initialization, and its weight files."""

import os
import zipfile
from collections.abc import Callable, Mapping
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import platformdirs
from jaxtyping import Float32, UInt8

from ..safe_io.limits import file_sha256, open_file
from .fid_features import Extractor, ExtractorChoice, resized
from .lpips_weights import SUFFIXES, read_arrays

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
    digest, is_script = file_sha256(file), is_torchscript(file)
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
    """Read exactly the arrays that `Inception` requires, by their names, with checked shapes.

    Raises ValueError with the file for other content; torchvision's ImageNet weights, which have the same names and
    shapes but different features, are detected by their number of classes.
    """
    arrays = read_arrays(file)
    classes = arrays.get("fc.weight")
    if classes is not None and len(classes) != _CLASSES:
        raise ValueError(
            f"{file}: Inception of {len(classes)} classes, such as torchvision's; FID is defined with that of "
            f"{_CLASSES} (pt_inception-2015-12-05)"
        )
    if any(name.startswith("AuxLogits.") for name in arrays):
        raise ValueError(f"{file}: Inception with AuxLogits, such as torchvision's; FID's has none")
    expected = {name: tuple(each.shape) for name, each in build_without_weights(Inception).state_dict().items()}
    unused = ("num_batches_tracked", "fc.weight", "fc.bias")
    found = {name: array for name, array in arrays.items() if not name.endswith(unused)}
    for name, shape in expected.items():
        if name not in found:
            raise ValueError(f"{file}: not the weights of Inception: {name} is missing")
        if found[name].shape != shape:
            raise ValueError(f"{file}: not the weights of Inception: {name} is {found[name].shape}, expected {shape}")
    too_much = sorted(set(found) - set(expected))
    if too_much:
        raise ValueError(f"{file}: not the weights of Inception: it has no {too_much[0]}")
    return {name: np.ascontiguousarray(array, np.float32) for name, array in found.items()}


# Inception network
# Szegedy et al. 2016 (Inception v3) as Heusel et al. 2017 took it from TensorFlow's files of 2015-12-05, with the parts
# named as in the published weights. It differs from torchvision's in three ways: average pools exclude the padding from
# the mean (blocks A, C and E), the last block uses max pooling, and there are 1008 classes.


class Convolution(NamedTuple):
    """A convolution of the network, with its name in the published weights."""

    name: str
    channels: int
    """Of the output; the input has those of the step before."""
    height: int = 1
    width: int = 0
    """0: as the height."""
    stride: int = 1
    pads: bool = True
    """Keep the size if the stride is 1."""


Branch = list[str | Convolution | list[Convolution]]
"""Steps of a branch: a pool, a convolution, or parallel convolutions whose outputs are concatenated."""


class Inception(torch.nn.Module):
    """Features of images (b, 3, 299, 299) of display values 0..255: (b, 2048), the mean over the last block."""

    def __init__(self) -> None:
        super().__init__()
        channels = 3
        for step in _STEM:
            channels = _add(self, step, channels)
        for name, branches in _BLOCKS.items():
            block = _Block(branches, channels)
            self.add_module(name, block)
            channels = block.channels

    def forward(self, pictures: Tensor) -> Tensor:
        """Return features of images; TensorFlow's scaling of 2015 is (v - 128) / 128."""
        flow = _through(self, _STEM, (pictures - 128) / 128)
        for name in _BLOCKS:
            flow = getattr(self, name)(flow)
        return flow.mean(dim=(2, 3))


class _Block(torch.nn.Module):
    """Branches from the same input, whose outputs are concatenated."""

    def __init__(self, branches: list[Branch], inward: int) -> None:
        super().__init__()
        self._branches, self.channels = branches, 0
        for branch in branches:
            channels = inward
            for step in branch:
                channels = _add(self, step, channels)
            self.channels += channels

    def forward(self, flow: Tensor) -> Tensor:
        return torch.cat([_through(self, branch, flow) for branch in self._branches], 1)


class _Normalized(torch.nn.Module):
    def __init__(self, step: Convolution, inward: int) -> None:
        super().__init__()
        size = step.height, step.width or step.height
        padding = (size[0] // 2, size[1] // 2) if step.pads and step.stride == 1 else (0, 0)
        self.conv = torch.nn.Conv2d(inward, step.channels, size, step.stride, padding, bias=False)
        self.bn = FrozenNorm(step.channels)

    def forward(self, flow: Tensor) -> Tensor:
        return self.bn(self.conv(flow)).relu()


def _add(module: Any, step: str | Convolution | list[Convolution], inward: int) -> int:
    """Add the convolutions of a step to a module, and return its number of output channels."""
    if isinstance(step, str):
        return inward
    parallel = [step] if isinstance(step, Convolution) else step
    for each in parallel:
        module.add_module(each.name, _Normalized(each, inward))
    return sum(each.channels for each in parallel)


def _through(module: Any, branch: Branch, flow: Tensor) -> Tensor:
    for step in branch:
        if isinstance(step, str):
            flow = _POOLS[step](flow)
        else:
            parallel = [step] if isinstance(step, Convolution) else step
            flow = torch.cat([getattr(module, each.name)(flow) for each in parallel], 1)
    return flow


_POOLS: dict[str, Any] = {
    "average": partial(torch.nn.functional.avg_pool2d, kernel_size=3, stride=1, padding=1, count_include_pad=False),
    "maximum": partial(torch.nn.functional.max_pool2d, kernel_size=3, stride=1, padding=1),
    "halving": partial(torch.nn.functional.max_pool2d, kernel_size=3, stride=2),
}
_C = Convolution
_STEM: Branch = [
    _C("Conv2d_1a_3x3", 32, 3, stride=2),
    _C("Conv2d_2a_3x3", 32, 3, pads=False),
    _C("Conv2d_2b_3x3", 64, 3),
    "halving",
    _C("Conv2d_3b_1x1", 80),
    _C("Conv2d_4a_3x3", 192, 3, pads=False),
    "halving",
]


def _chain(name: str, *steps: tuple[int, int, int]) -> Branch:
    """Convolutions of (channels, height, width), numbered from 1."""
    return [_C(f"{name}_{number}", *step, stride=1) for number, step in enumerate(steps, 1)]


def _block_a(pooled: int) -> list[Branch]:
    return [
        [_C("branch1x1", 64)],
        _chain("branch5x5", (48, 1, 1), (64, 5, 5)),
        _chain("branch3x3dbl", (64, 1, 1), (96, 3, 3), (96, 3, 3)),
        ["average", _C("branch_pool", pooled)],
    ]


def _block_c(inner: int) -> list[Branch]:
    return [
        [_C("branch1x1", 192)],
        _chain("branch7x7", (inner, 1, 1), (inner, 1, 7), (192, 7, 1)),
        _chain("branch7x7dbl", (inner, 1, 1), (inner, 7, 1), (inner, 1, 7), (inner, 7, 1), (192, 1, 7)),
        ["average", _C("branch_pool", 192)],
    ]


def _block_e(pool: str) -> list[Branch]:
    return [
        [_C("branch1x1", 320)],
        [_C("branch3x3_1", 384), [_C("branch3x3_2a", 384, 1, 3), _C("branch3x3_2b", 384, 3, 1)]],
        [
            *_chain("branch3x3dbl", (448, 1, 1), (384, 3, 3)),
            [_C("branch3x3dbl_3a", 384, 1, 3), _C("branch3x3dbl_3b", 384, 3, 1)],
        ],
        [pool, _C("branch_pool", 192)],
    ]


_BLOCKS: dict[str, list[Branch]] = {
    "Mixed_5b": _block_a(32),
    "Mixed_5c": _block_a(64),
    "Mixed_5d": _block_a(64),
    "Mixed_6a": [
        [_C("branch3x3", 384, 3, stride=2)],
        [*_chain("branch3x3dbl", (64, 1, 1), (96, 3, 3)), _C("branch3x3dbl_3", 96, 3, stride=2)],
        ["halving"],
    ],
    "Mixed_6b": _block_c(128),
    "Mixed_6c": _block_c(160),
    "Mixed_6d": _block_c(160),
    "Mixed_6e": _block_c(192),
    "Mixed_7a": [
        [_C("branch3x3_1", 192), _C("branch3x3_2", 320, 3, stride=2)],
        [*_chain("branch7x7x3", (192, 1, 1), (192, 1, 7), (192, 7, 1)), _C("branch7x7x3_4", 192, 3, stride=2)],
        ["halving"],
    ],
    "Mixed_7b": _block_e("average"),
    "Mixed_7c": _block_e("maximum"),
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
