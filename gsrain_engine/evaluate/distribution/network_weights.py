"""Weights of Inception: where they are looked for, and whether they are the right ones."""

import os
import zipfile
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import platformdirs

from gsrain_engine.untrusted.limits import open_file

from ..weight_file import SUFFIXES, read_arrays

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
    from .frozen_network import hollow  # torch is an extra
    from .inception import Inception

    classes = arrays.get("fc.weight")
    if classes is not None and len(classes) != INCEPTION_CLASSES:
        raise ValueError(
            f"{source}: Inception of {len(classes)} classes, such as torchvision's; FID is defined with that of "
            f"{INCEPTION_CLASSES} (pt_inception-2015-12-05)"
        )
    if any(name.startswith("AuxLogits.") for name in arrays):
        raise ValueError(f"{source}: Inception with AuxLogits, such as torchvision's; FID's has none")
    wanted = {name: tuple(each.shape) for name, each in hollow(Inception).state_dict().items()}
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
