"""What every reader does last: refuse values that no Gaussian can have, and normalize quaternions."""

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
    for name, values in fields.items():
        # A sum is finite exactly where every term is, overflow of float32 aside; it is the cheap test.
        if not np.isfinite(np.sum(values, dtype=np.float64)):
            bad = np.flatnonzero(~np.isfinite(values.reshape(len(values), -1)).all(axis=1))
            raise SceneFormatError(path, _counted(bad, len(values), f"a {name} that is not a finite number"))
    lengths = np.sqrt(np.einsum("ij,ij->i", quaternions, quaternions))
    if len(lengths) and not lengths.min() > 1e-12:
        raise SceneFormatError(path, _counted(np.flatnonzero(lengths <= 1e-12), len(lengths), "a zero quaternion"))
    np.divide(quaternions, lengths[:, None], out=quaternions)
    return Gaussians(means, scales, quaternions, opacities, sh)


def _counted(bad: "np.ndarray[tuple[int], np.dtype[np.int64]]", total: int, what: str) -> str:
    return f"{len(bad)} of {total} Gaussians have {what}, the first is number {bad[0]}"
