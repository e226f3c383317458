"""What every reader does last: refuse values that no Gaussian can have, and normalize quaternions."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from jaxtyping import Float32

from ..errors import SceneFormatError
from ..gaussians import Gaussians


def checked_gaussians(
    path: Path,
    means: Float32[np.ndarray, "n 3"],
    scales: Float32[np.ndarray, "n 3"],
    quaternions: Float32[np.ndarray, "n 4"],
    opacities: Float32[np.ndarray, " n"],
    sh: Float32[np.ndarray, "n k 3"],
) -> Gaussians:
    """Build `Gaussians` from what a file held; the quaternions may have any length but zero.

    Raises `SceneFormatError` that says what is wrong with how many Gaussians, and which is the first.
    """
    fields = {"mean": means, "scale": scales, "quaternion": quaternions, "opacity": opacities, "colour": sh}
    check_finite(path, fields)
    if scales.size and scales.min() < 0:
        raise SceneFormatError(path, _counted(np.flatnonzero(scales.min(axis=1) < 0), len(scales), "a negative scale"))
    with np.errstate(over="ignore"):
        lengths = np.sqrt(np.einsum("ij,ij->i", quaternions, quaternions))
    if len(lengths) and not lengths.min() > 1e-12:
        raise SceneFormatError(path, _counted(np.flatnonzero(lengths <= 1e-12), len(lengths), "a zero quaternion"))
    if len(lengths) and not lengths.max() < np.inf:
        endless = np.flatnonzero(np.isinf(lengths))
        raise SceneFormatError(path, _counted(endless, len(lengths), "a quaternion too long to be normalized"))
    np.divide(quaternions, lengths[:, None], out=quaternions)
    return Gaussians(means, scales, quaternions, opacities, sh)


def check_finite(path: Path, fields: Mapping[str, Float32[np.ndarray, "..."]]) -> None:
    """Refuse fields, one row a Gaussian, that hold NaN or infinity.

    Raises `SceneFormatError` that says which field of how many Gaussians, and which is the first.
    """
    for name, values in fields.items():
        # A sum is finite exactly where every term is, overflow of float32 aside; it is the cheap test.
        with np.errstate(invalid="ignore"):  # infinity minus infinity
            total = np.sum(values, dtype=np.float64)
        if not np.isfinite(total):
            bad = np.flatnonzero(~np.isfinite(values.reshape(len(values), -1)).all(axis=1))
            article = "an" if name[0] in "aeiou" else "a"
            raise SceneFormatError(path, _counted(bad, len(values), f"{article} {name} that is not a finite number"))


def _counted(bad: "np.ndarray[tuple[int], np.dtype[np.int64]]", total: int, what: str) -> str:
    return f"{len(bad)} of {total} Gaussians have {what}, the first is number {bad[0]}"
