"""The file a recolouring writes: new spherical harmonics a layer and actor, and nothing else (.npz, no pickle)."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float32

from gsrain_engine.scene.atomic_files import whole_file
from gsrain_engine.scene.errors import SceneFormatError
from gsrain_engine.untrusted.array_archives import read_archive
from gsrain_engine.untrusted.printable import printable

_VERSION = 1


def write_recolored(path: Path, colors: Mapping[str, Float32[np.ndarray, "_ _ 3"]]) -> None:
    """Write harmonics by name (`layers/NAME`, `actors/ID`), whole or not at all."""
    path.parent.mkdir(parents=True, exist_ok=True)
    arrays: dict[str, Any] = {"version": np.array(_VERSION), "names": np.array(list(colors), dtype=np.str_)}
    arrays |= {f"sh_{i}": sh for i, sh in enumerate(colors.values())}
    with whole_file(path) as beside, beside.open("wb") as file:
        np.savez(file, allow_pickle=False, **arrays)


def read_recolored(path: Path | str) -> dict[str, Float32[np.ndarray, "_ _ 3"]]:
    """Read harmonics by name (`layers/NAME`, `actors/ID`).

    Raises:
        SceneFormatError: When the file holds something else.
    """
    try:
        file = read_archive(Path(path))
        version = int(file["version"])
        if version > _VERSION:
            raise SceneFormatError(path, f"version {version} is newer than {_VERSION}, which this program knows")
        colors = {str(name): file[f"sh_{i}"] for i, name in enumerate(file["names"])}
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        if isinstance(error, SceneFormatError):
            raise
        raise SceneFormatError(path, f"not a file of recoloured Gaussians: {printable(error)}") from None
    for name, sh in colors.items():
        if sh.dtype != np.float32 or sh.ndim != 3 or sh.shape[2] != 3:
            raise SceneFormatError(path, f"harmonics of {name!r} are {sh.dtype} {sh.shape}, expected float32 (n, k, 3)")
    return colors
