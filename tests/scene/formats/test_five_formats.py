"""One scene in five files (PLY, compressed PLY, SOG, SPZ v3 and v4): what our readers make of each agrees."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import cKDTree

from gsrain_engine.scene.formats.registry import read_gaussians
from gsrain_engine.scene.formats.sog import read_sog
from gsrain_engine.scene.formats.spz import encode_spz, read_spz
from gsrain_engine.scene.gaussians import Gaussians
from gsrain_engine.scene.geometry import normalized

NAME = "scenes/playbot/playbot_lod3_31k_sh2"


@pytest.fixture(scope="module")
def original(test_data: Path) -> Gaussians:
    """The PLY, read without any of our code."""
    header, body = (test_data / f"{NAME}.ply").read_bytes().split(b"end_header\n", 1)
    names = [line.split()[2].decode() for line in header.splitlines() if line.startswith(b"property float")]
    columns = dict(zip(names, np.frombuffer(body, "<f4").reshape(-1, len(names)).T, strict=True))
    base = np.stack([columns[f"f_dc_{i}"] for i in range(3)], axis=1)
    rest = np.stack([columns[f"f_rest_{i}"] for i in range(24)], axis=1).reshape(-1, 3, 8).transpose(0, 2, 1)
    return Gaussians(
        np.stack([columns[axis] for axis in "xyz"], axis=1),
        np.exp(np.stack([columns[f"scale_{i}"] for i in range(3)], axis=1)),
        normalized(np.stack([columns[f"rot_{i}"] for i in range(4)], axis=1)),
        1 / (1 + np.exp(-columns["opacity"])),
        np.ascontiguousarray(np.concatenate([base[:, None], rest], axis=1)),
    )


def matched(original: Gaussians, other: Gaussians) -> tuple[Gaussians, Gaussians]:
    """Pairs that are each other's nearest, in place, size, opacity and color together: some stand on one spot."""

    def features(g: Gaussians) -> np.ndarray:
        return np.concatenate([g.means * 100, np.log(g.scales), g.opacities[:, None], g.sh[:, 0]], axis=1)

    a, b = features(original), features(other)
    there, back = cKDTree(b).query(a)[1], cKDTree(a).query(b)[1]
    mutual = back[there] == np.arange(len(a))
    assert mutual.mean() > 0.97
    return original.take(np.flatnonzero(mutual)), other.take(there[mutual])


def check_agreement(a: Gaussians, b: Gaussians, mean: float, log_scale: float, sh0: float, sh_slope: float) -> None:
    def most(errors: np.ndarray) -> float:
        return float(np.quantile(errors, 0.98))

    assert most(np.abs(a.means - b.means)) < mean
    assert most(np.abs(np.log(a.scales) - np.log(b.scales))) < log_scale
    assert most(np.abs(a.opacities - b.opacities)) < 0.004
    assert most(1 - np.abs((a.quaternions * b.quaternions).sum(1))) < 1e-4
    assert most(np.abs(a.sh[:, 0] - b.sh[:, 0])) < sh0
    # Every harmonic by itself: a wrong sign or a wrong order makes its slope -1 or 0. SPZ ends at 1.
    inside = np.abs(a.sh) < 0.95
    slopes = (a.sh * b.sh * inside).sum((0, 2)) / (a.sh**2 * inside).sum((0, 2))
    np.testing.assert_allclose(slopes, 1, atol=sh_slope)


@pytest.mark.parametrize("version", ["v3", "v4"])
def test_spz(version: str, original: Gaussians, test_data: Path) -> None:
    other = read_spz(test_data / f"{NAME}.{version}.spz")
    assert len(other) == len(original)
    check_agreement(*matched(original, other), mean=1.3e-4, log_scale=0.032, sh0=0.0135, sh_slope=0.02)


def test_ply(original: Gaussians, test_data: Path) -> None:
    other = read_gaussians(test_data / f"{NAME}.ply")
    np.testing.assert_array_equal(other.means, original.means)
    np.testing.assert_array_equal(other.sh, original.sh)
    check_agreement(original, other, mean=1e-9, log_scale=1e-6, sh0=1e-9, sh_slope=1e-6)


def test_compressed_ply(original: Gaussians, test_data: Path) -> None:
    other = read_gaussians(test_data / f"{NAME}.compressed.ply")
    assert len(other) == len(original)
    check_agreement(*matched(original, other), mean=2e-4, log_scale=0.004, sh0=0.02, sh_slope=0.01)


def test_sog(original: Gaussians, test_data: Path) -> None:
    other = read_sog(test_data / f"{NAME}.sog")
    assert len(other) == len(original)
    # The PLY was made from the SOG: nothing but rounding may lie between them.
    check_agreement(*matched(original, other), mean=1e-6, log_scale=1e-5, sh0=1e-6, sh_slope=1e-6)


def test_our_spz_is_closer_to_the_original_than_the_shipped_one(
    original: Gaussians, test_data: Path, tmp_path: Path
) -> None:
    (tmp_path / "ours.spz").write_bytes(encode_spz(original))
    ours, shipped = read_spz(tmp_path / "ours.spz"), read_spz(test_data / f"{NAME}.v3.spz")
    np.testing.assert_allclose(ours.means, original.means, atol=2**-17 + 1e-6)
    assert np.abs(ours.sh[:, 1:] - original.sh[:, 1:]).mean() < 0.01
    assert np.abs(ours.sh[:, 1:] - original.sh[:, 1:]).mean() < 0.3 * _rest_error(original, shipped)


def _rest_error(original: Gaussians, other: Gaussians) -> float:
    a, b = matched(original, other)
    return float(np.abs(a.sh[:, 1:] - b.sh[:, 1:]).mean())
