"""The `meta.json` of a SOG scene, with its numbers checked; version 1 is brought into the form of version 2."""

from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import Annotated

import msgspec
import numpy as np
from jaxtyping import Float32, Float64
from msgspec import Meta

from ..errors import SceneFormatError

_Triple = Annotated[list[float], Meta(min_length=3, max_length=3)]
_Codebook = Annotated[list[float | None], Meta(min_length=2, max_length=256)]
_OneFile = Annotated[list[str], Meta(min_length=1, max_length=1)]
_TwoFiles = Annotated[list[str], Meta(min_length=2, max_length=2)]
_PALETTE = 65536
"""Labels have 16 bits."""


# Writers add fields of their own (`asset`, `antialias`): unlike in our own files, unknown ones are passed over.
class _Means(msgspec.Struct, frozen=True):
    mins: _Triple
    maxs: _Triple
    files: _TwoFiles
    shape: list[int] = []


class _Quaternions(msgspec.Struct, frozen=True):
    files: _OneFile


class _Coded(msgspec.Struct, frozen=True):
    codebook: _Codebook
    files: _OneFile


class _CodedRest(msgspec.Struct, frozen=True):
    bands: Annotated[int, Meta(ge=1, le=3)]
    codebook: _Codebook
    files: _TwoFiles
    count: Annotated[int, Meta(ge=1, le=_PALETTE)] | None = None


class _Version2(msgspec.Struct, frozen=True):
    count: Annotated[int, Meta(ge=0, lt=2**32)]
    means: _Means
    scales: _Coded
    quats: _Quaternions
    sh0: _Coded
    shN: _CodedRest | None = None  # noqa: N815 - the format's own name


class _Ranged(msgspec.Struct, frozen=True):
    mins: Annotated[list[float], Meta(min_length=3, max_length=4)]
    maxs: Annotated[list[float], Meta(min_length=3, max_length=4)]
    files: _OneFile


class _RangedRest(msgspec.Struct, frozen=True):
    mins: float
    maxs: float
    files: _TwoFiles


class _Version1(msgspec.Struct, frozen=True):
    means: _Means
    scales: _Ranged
    quats: _Quaternions
    sh0: _Ranged
    shN: _RangedRest | None = None  # noqa: N815 - the format's own name


class _Version(msgspec.Struct, frozen=True):
    version: int = 1


class RestHarmonics(msgspec.Struct, frozen=True, kw_only=True):
    """Where the harmonics above degree 0 are: a palette of them, and a label a Gaussian."""

    centroids: str
    labels: str
    bands: int | None
    """SH degree; version 1 leaves it to the width of the palette's image."""
    palette_count: int | None
    codebook: Float32[np.ndarray, "256"]


class SogMeta(msgspec.Struct, frozen=True, kw_only=True):
    """What `meta.json` says: every byte of an image is looked up in a codebook of 256 numbers.

    What a codebook of the file is too short to give is NaN here, so that a byte that asks for it is found out.
    """

    count: int
    means_files: tuple[str, str]
    """Low bytes, high bytes."""
    mins: Float64[np.ndarray, "3"]
    maxs: Float64[np.ndarray, "3"]
    """Range of the means after sign(x) ln(1 + |x|)."""
    quaternions_file: str
    scales_file: str
    log_scales: Float32[np.ndarray, "3 256"]
    base_file: str
    base: Float32[np.ndarray, "3 256"]
    """Harmonic of degree 0."""
    opacities: Float32[np.ndarray, "256"]
    rest: RestHarmonics | None


def read_meta(path: Path, text: bytes) -> SogMeta:
    """Read version 2, and version 1 (2024, without a `version`), of the description of a SOG scene.

    Raises `SceneFormatError` that names the field, as in ``Expected `int` - at `$.count` ``.
    """
    try:
        version = msgspec.json.decode(text, type=_Version).version
        if version == 1:
            return _from_version_1(path, msgspec.json.decode(text, type=_Version1))
        if version == 2:
            return _from_version_2(path, msgspec.json.decode(text, type=_Version2))
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise SceneFormatError(path, f"meta.json: {error}") from None
    raise SceneFormatError(path, f"meta.json: version {version} of SOG can't be read, versions 1 and 2 can")


def _from_version_2(path: Path, meta: _Version2) -> SogMeta:
    rest = None
    if meta.shN is not None:
        rest = RestHarmonics(
            centroids=_file(path, meta.shN.files[0]),
            labels=_file(path, meta.shN.files[1]),
            bands=meta.shN.bands,
            palette_count=meta.shN.count,
            codebook=_codebook(path, "shN", meta.shN.codebook),
        )
    return SogMeta(
        count=meta.count,
        means_files=(_file(path, meta.means.files[0]), _file(path, meta.means.files[1])),
        mins=np.array(meta.means.mins),
        maxs=np.array(meta.means.maxs),
        quaternions_file=_file(path, meta.quats.files[0]),
        scales_file=_file(path, meta.scales.files[0]),
        log_scales=np.tile(_codebook(path, "scales", meta.scales.codebook), (3, 1)),
        base_file=_file(path, meta.sh0.files[0]),
        base=np.tile(_codebook(path, "sh0", meta.sh0.codebook), (3, 1)),
        opacities=np.arange(256, dtype=np.float32) / 255,
        rest=rest,
    )


def _from_version_1(path: Path, meta: _Version1) -> SogMeta:
    if not meta.means.shape or not 0 <= meta.means.shape[0] < 2**32:
        raise SceneFormatError(path, "meta.json: means.shape must start with the number of Gaussians")
    if len(meta.sh0.mins) != 4 or len(meta.sh0.maxs) != 4:
        raise SceneFormatError(path, "meta.json: mins and maxs of sh0 must hold 4 numbers: red, green, blue, opacity")
    base = _ramps(meta.sh0.mins, meta.sh0.maxs)
    rest = None
    if meta.shN is not None:
        rest = RestHarmonics(
            centroids=_file(path, meta.shN.files[0]),
            labels=_file(path, meta.shN.files[1]),
            bands=None,
            palette_count=None,
            codebook=_ramps([meta.shN.mins], [meta.shN.maxs])[0],
        )
    return SogMeta(
        count=meta.means.shape[0],
        means_files=(_file(path, meta.means.files[0]), _file(path, meta.means.files[1])),
        mins=np.array(meta.means.mins),
        maxs=np.array(meta.means.maxs),
        quaternions_file=_file(path, meta.quats.files[0]),
        scales_file=_file(path, meta.scales.files[0]),
        log_scales=_ramps(meta.scales.mins[:3], meta.scales.maxs[:3]),
        base_file=_file(path, meta.sh0.files[0]),
        base=base[:3],
        opacities=(1 / (1 + np.exp(-np.clip(base[3], -80, 80)))).astype(np.float32),
        rest=rest,
    )


def _codebook(path: Path, name: str, values: list[float | None]) -> Float32[np.ndarray, "256"]:
    first, *others = values
    numbers = [number for number in others if number is not None]
    if len(numbers) != len(others):
        raise SceneFormatError(path, f"meta.json: {name}.codebook holds null after its first entry")
    if first is None:
        # A bug of early writers: PlayCanvas goes on to where the entry must have been, one step below the second.
        first = numbers[0] + (numbers[0] - numbers[-1]) / 255
    codebook = np.full(256, np.nan, np.float32)
    with np.errstate(over="ignore"):  # infinity is refused together with NaN when a Gaussian uses it
        codebook[: len(values)] = np.array([first, *numbers]).astype(np.float32)
    return codebook


def _ramps(mins: list[float], maxs: list[float]) -> Float32[np.ndarray, "channels 256"]:
    """Codebooks of version 1: 256 equal steps from the smallest to the largest value."""
    low, high = np.array(mins)[:, None], np.array(maxs)[:, None]
    with np.errstate(over="ignore", invalid="ignore"):
        return (low + (high - low) * (np.arange(256) / 255)).astype(np.float32)


def _file(path: Path, name: str) -> str:
    """Accept only a bare file name: nothing in a scene may point out of its folder."""
    if not name or name in (".", "..") or "\0" in name or len(name) > 255:
        raise SceneFormatError(path, f"meta.json: {name[:40]!r} is not the name of a file")
    if PurePosixPath(name).name != name or PureWindowsPath(name).name != name:
        raise SceneFormatError(path, f"meta.json: the file {name!r} must lie beside meta.json, without a folder")
    return name
