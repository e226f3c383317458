"""Gaussians in checkpoints of PyTorch, as trainings keep them: log scales, opacity logits, harmonics in two parts."""

import re
from io import BufferedReader, BytesIO
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Float32

from ...optional_packages import MissingPackageError, import_package
from ...safe_io.errors import SceneFormatError
from ...safe_io.limits import check_file, check_zip_expansion, open_file
from ...safe_io.text_files import printable_line
from ..gaussians import COEFFICIENTS_OF_DEGREE, Gaussians, sh_from_color
from ._common import check_expansion, checked_gaussians, usable_rows
from .ply import activate_opacities, apply_3d_filter

MISFITS = ArithmeticError, AttributeError, LookupError, RuntimeError, TypeError, ValueError
"""Errors of tensors whose types or shapes are not those of the layout."""


class SplatTensors(NamedTuple):
    """Tensors of n Gaussians before activation."""

    means: Any
    """(n, 3)."""
    log_scales: Any
    """(n, 3); (n, 2) is flat, (n, 1) round."""
    quaternions: Any
    """(n, 4), wxyz, of any length."""
    logits: Any
    """(n) or (n, 1)."""
    constant: Any
    """(n, 3) or (n, 1, 3): harmonics of degree 0; without `others` and with `is_squashed` logits of colors."""
    others: Any = None
    """(n, k, 3): the other harmonics; None is degree 0."""
    filter_3d: Any = None
    """(n) or (n, 1): standard deviation of Mip-Splatting's filter; None is none."""
    thickness: float = 0.0
    """Third scale of flat ones, along their y axis if above 0, as HUGSIM's road has it."""
    is_squashed: bool = False


def load_tensors(path: Path) -> Any:
    """Contents of a checkpoint, as tensors and plain values only: no code in it runs.

    Raises `SceneFormatError` if it is damaged or holds anything else.
    """
    check_file(path)
    with open_file(path) as stream:
        return tensors_in(path, stream)


def tensors_in(path: Path, stream: BufferedReader | BytesIO) -> Any:
    """Contents of a checkpoint that is part of the file at `path`; see `load_tensors`."""
    try:
        torch = import_package("torch", "a checkpoint")  # slow to import
    except MissingPackageError as error:
        raise SceneFormatError(path, str(error)) from None
    try:
        check_zip_expansion(stream, path)
        return torch.load(stream, map_location="cpu", weights_only=True)
    except OSError:
        raise
    except Exception as error:  # torch raises many types
        found = _GLOBAL.search(str(error))
        reason = "it is damaged, or none of PyTorch" if found is None else f"it holds {found[1]}, code of a program"
        raise SceneFormatError(path, f"no checkpoint of plain tensors: {reason}") from None


_GLOBAL = re.compile(r"GLOBAL ([\w.]+)")
"""Name of code in the message of PyTorch's loader that refuses it."""


def activated(path: Path, trained: SplatTensors, *, max_degree: int = 3) -> Gaussians:
    """Gaussians of tensors, without unusable ones (see `usable_rows`). Raises `SceneFormatError`."""
    return activated_rows(path, trained, max_degree=max_degree)[0]


def activated_rows(
    path: Path, trained: SplatTensors, *, max_degree: int = 3
) -> tuple[Gaussians, "np.ndarray[tuple[int], np.dtype[np.bool_]]"]:
    """Gaussians of tensors, and the mask of the usable ones among their rows. Raises `SceneFormatError`."""
    try:
        count = len(trained.means)
        others = np.zeros((count, 0, 3), np.float32) if trained.others is None else _values(trained.others)
        others = others.reshape(count, -1, 3)[:, : COEFFICIENTS_OF_DEGREE[max_degree] - 1]
        coefficients = others.shape[1] + 1
        if coefficients not in COEFFICIENTS_OF_DEGREE:
            raise SceneFormatError(path, f"{coefficients} harmonics for each color: expected 1, 4, 9 or 16")
        check_expansion(path, count, coefficients, path.stat().st_size)
        constant = array_of(trained.constant).reshape(count, 1, 3)
        means, quaternions = array_of(trained.means).reshape(count, 3), array_of(trained.quaternions).reshape(count, 4)
        opacities = array_of(trained.logits).reshape(count)
        with np.errstate(over="ignore", invalid="ignore"):  # NaN and infinity are left out below
            if trained.is_squashed:
                constant = sh_from_color(1 / (1 + np.exp(-constant[:, 0])))
            scales = _three(np.exp(array_of(trained.log_scales).reshape(count, -1)), trained.thickness)
            activate_opacities(opacities)
            if trained.filter_3d is not None:
                apply_3d_filter(scales, opacities, array_of(trained.filter_3d).reshape(count))
            sh = np.empty((count, coefficients, 3), np.float32)
            sh[:, :1], sh[:, 1:] = constant.reshape(count, 1, 3), others
        fit = usable_rows(path, means, scales, quaternions, opacities, sh)
        rows = (means, scales, quaternions, opacities, sh) if fit.all() else (
            means[fit], scales[fit], quaternions[fit], opacities[fit], sh[fit]
        )  # fmt: skip
        return checked_gaussians(path, *rows), fit
    except SceneFormatError:
        raise
    except MISFITS as error:
        raise misfit(path, error) from None


def _three(scales: Float32[np.ndarray, "n k"], thickness: float) -> Float32[np.ndarray, "n 3"]:
    if scales.shape[1] == 1:
        return np.repeat(scales, 3, axis=1)
    if scales.shape[1] == 2:
        return np.insert(scales, 1 if thickness else 2, np.float32(thickness), axis=1)
    return scales.reshape(len(scales), 3)


def array_of(tensor: Any) -> Float32[np.ndarray, "..."]:
    """Copy of the values of a tensor or an array."""
    return np.array(_values(tensor), np.float32, order="C")


def _values(tensor: Any) -> Float[np.ndarray, "..."]:
    return tensor if isinstance(tensor, np.ndarray) else tensor.detach().float().numpy()


def misfit(path: Path, error: Exception) -> SceneFormatError:
    """Error for tensors that are not those of the layout."""
    return SceneFormatError(path, f"its tensors don't fit together: {printable_line(error)}")
