"""Gaussians that are written come back as far as their format can hold them, and real files agree with one another."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from gsrain_engine.safe_io.errors import SceneFormatError
from gsrain_engine.scene.formats.compressed_ply import chunk_order
from gsrain_engine.scene.formats.lod_file import read_lod_tree, write_lod_tree
from gsrain_engine.scene.formats.ply import write_ply
from gsrain_engine.scene.formats.registry import read_gaussians, write_gaussians
from gsrain_engine.scene.formats.scene_files import read_scene
from gsrain_engine.scene.formats.sog_writer import sog_order
from gsrain_engine.scene.formats.spz import encode_spz
from gsrain_engine.scene.gaussians import SH_C0, Gaussians
from gsrain_engine.scene.geometry import normalized
from gsrain_engine.scene.lod_order import lod_order, morton_order
from gsrain_engine.scene.lod_tree import build_lod_tree
from gsrain_engine.scene.open import load_sorted_scene

from .sample_files import (
    BLOCK,
    SMALL_FILES,
    assert_valid,
    ksplat,
    old_spz,
    sample_gaussians,
    write_small,
    written,
)
from .test_layouts import columns_of, write_text

PLAYBOT = "scenes/playbot/playbot_lod3_31k_sh2"


class RoundTrip(NamedTuple):
    """A format, what writes it, and by how much each value may be off."""

    suffix: str
    encode: Callable[[Gaussians], tuple[Gaussians, bytes]]
    """Returns the Gaussians in the order of the file, and the file."""
    mean: float
    log_scale: float
    cosine: float
    """Of half the angle between quaternions: how much smaller than 1."""
    opacity: float
    base: float
    rest: float
    sh_degree: int = 3


def ours(suffix: str, gaussians: Gaussians) -> tuple[Gaussians, bytes]:
    data = written(gaussians, suffix)
    assert written(gaussians, suffix) == data  # the same Gaussians make the same bytes
    return gaussians, data


def in_morton_order(suffix: str, gaussians: Gaussians) -> tuple[Gaussians, bytes]:
    before, data = ours(suffix, gaussians)
    return before.take(chunk_order(before)), data


def text(gaussians: Gaussians) -> tuple[Gaussians, bytes]:
    return gaussians, write_text(written(gaussians, ".ply"), before="7\n8\n")


def spz_3(gaussians: Gaussians) -> tuple[Gaussians, bytes]:
    return gaussians, old_spz(gaussians, 3)


def of_level(level: int, gaussians: Gaussians) -> tuple[Gaussians, bytes]:
    """Two sections, of which the second has no harmonics above degree 0."""
    return ksplat([gaussians, sample_gaussians(9, 0)], level)


_BYTE = 0.51 / 255
ROUND_TRIPS = {
    "ply": RoundTrip(".ply", partial(ours, ".ply"), 0, 1e-5, 1e-6, 1e-6, 0, 0),
    "ply, text": RoundTrip(".ply", text, 0, 1e-5, 1e-6, 1e-6, 0, 0),
    "splat": RoundTrip(".splat", partial(ours, ".splat"), 0, 1e-6, 1e-4, _BYTE, _BYTE / SH_C0, 0, 0),
    "spz 4": RoundTrip(".spz", partial(ours, ".spz"), 2**-17 + 1e-5, 1 / 31, 4e-6, _BYTE, _BYTE / 0.15, 0.51 / 128),
    "spz 3": RoundTrip(".spz", spz_3, 2**-17 + 1e-5, 1 / 31, 4e-6, _BYTE, _BYTE / 0.15, 0.51 / 128),
    "glb": RoundTrip(".glb", partial(ours, ".glb"), 0, 1e-6, 1e-6, 0, 0, 0),
    "compressed ply": RoundTrip(
        ".compressed.ply", partial(in_morton_order, ".compressed.ply"), 0.03, 3e-3, 1e-5, _BYTE, 0.05, 0.51 / 32
    ),
    "ksplat 0": RoundTrip(".ksplat", partial(of_level, 0), 0, 1e-6, 1e-6, _BYTE, _BYTE / SH_C0, 1e-6, 2),
    "ksplat 1": RoundTrip(
        ".ksplat", partial(of_level, 1), 0.51 * BLOCK / 2 / 32767, 2**-10, 1e-5, _BYTE, _BYTE / SH_C0, 2e-3, 2
    ),
    "ksplat 2": RoundTrip(
        ".ksplat", partial(of_level, 2), 0.51 * BLOCK / 2 / 32767, 2**-10, 1e-5, _BYTE, _BYTE / SH_C0, 3.01 / 255, 2
    ),
}


@pytest.mark.parametrize("name", ROUND_TRIPS)
@settings(max_examples=8)
@given(count=st.integers(1, 3000), degree=st.integers(0, 3), seed=st.integers(0, 2**32 - 1))
def test_gaussians_come_back(
    tmp_path_factory: pytest.TempPathFactory, name: str, count: int, degree: int, seed: int
) -> None:
    row = ROUND_TRIPS[name]
    written_degree = min(degree, row.sh_degree) if row.sh_degree else degree
    before, data = row.encode(sample_gaussians(count, written_degree, seed))
    path = tmp_path_factory.mktemp("round") / f"a{row.suffix}"
    path.write_bytes(data)
    after = read_gaussians(path)
    assert_valid(after)
    np.testing.assert_allclose(after.means, before.means, atol=row.mean, rtol=0)
    np.testing.assert_allclose(np.log(after.scales), np.log(before.scales), atol=row.log_scale)
    assert (1 - np.abs((after.quaternions * before.quaternions).sum(1))).max() < row.cosine
    np.testing.assert_allclose(after.opacities, before.opacities, atol=row.opacity)
    np.testing.assert_allclose(after.sh[:, 0], before.sh[:, 0], atol=row.base)
    assert after.sh_degree == min(before.sh_degree, row.sh_degree)
    np.testing.assert_allclose(after.sh[:, 1:], before.sh[:, 1 : after.sh.shape[1]], atol=row.rest)


@pytest.mark.parametrize("suffix", [".ply", ".spz", ".compressed.ply", ".sog", ".glb"])
def test_files_tell_antialiased_gaussians_from_others(suffix: str, tmp_path: Path) -> None:
    path = tmp_path / f"a{suffix}"
    for antialiased in (True, False):
        path.write_bytes(written(replace(sample_gaussians(50, 1), antialiased=antialiased), suffix))
        assert read_gaussians(path).antialiased is antialiased
        tree = build_lod_tree(read_gaussians(path))
        write_lod_tree(tree, tmp_path / "a.lod", path)
        found = read_lod_tree(tmp_path / "a.lod", path)
        assert found.nodes.antialiased is found.gaussians.antialiased is antialiased
    if suffix == ".ply":  # as other programs mark it
        path.write_bytes(path.read_bytes().replace(b"element vertex", b"comment antialiased 1\nelement vertex", 1))
        assert read_gaussians(path).antialiased


@pytest.mark.parametrize("suffix", [".ply", ".spz"])
def test_no_gaussians_come_back_as_none(suffix: str, tmp_path: Path) -> None:
    (tmp_path / f"a{suffix}").write_bytes(written(Gaussians.empty(2), suffix))
    assert read_gaussians(tmp_path / f"a{suffix}").sh.shape == (0, 9, 3)


@pytest.mark.parametrize("suffix", [".compressed.ply", ".sog", ".glb"])
def test_formats_with_ranges_refuse_nothing_to_write(suffix: str, tmp_path: Path) -> None:
    with pytest.raises(SceneFormatError, match="at least one"):
        write_gaussians(Gaussians.empty(), tmp_path / f"a{suffix}")
    assert not [*tmp_path.iterdir()]


def test_a_sog_is_as_close_as_its_codes_allow(tmp_path: Path) -> None:
    before = sample_gaussians(3000, 2)
    same = written(before, ".sog")
    assert same == written(before, ".sog")
    (tmp_path / "a.sog").write_bytes(same)
    after, before = read_gaussians(tmp_path / "a.sog"), before.take(morton_order(before))
    assert_valid(after)
    np.testing.assert_allclose(after.means, before.means, atol=2e-3)
    np.testing.assert_allclose(np.log(after.scales), np.log(before.scales), atol=0.02)
    assert (1 - np.abs((after.quaternions * before.quaternions).sum(1))).max() < 1e-4
    np.testing.assert_allclose(after.opacities, before.opacities, atol=_BYTE)
    np.testing.assert_allclose(after.sh[:, 0], before.sh[:, 0], atol=0.01)
    # Random numbers are the worst case of a palette: here of 2048 vectors for 3000 in 24 dimensions.
    shared = np.mean((after.sh[:, 1:] - before.sh[:, 1:]) ** 2) / np.mean(before.sh[:, 1:] ** 2)
    assert shared < 0.35
    assert np.count_nonzero(np.abs(after.sh - before.sh).max(axis=(1, 2)) < 0.01) > 1000  # those with their own entry


def test_a_sog_has_gaussians_of_one_surface_together() -> None:
    before = sample_gaussians(4000, 0)
    assert np.array_equal(sog_order(before), morton_order(before))  # each is turned in its own way
    two = before.quaternions[np.random.default_rng(1).integers(0, 2, 4000)]
    walls = replace(before, quaternions=two, means=before.means * np.float32(4 / np.ptp(before.means)))
    order = sog_order(walls)
    assert sorted(order.tolist()) == [*range(4000)]
    cells = np.floor(walls.means[order] / 4)
    surfaces = np.concatenate([cells, walls.quaternions[order]], axis=1)
    changes = np.count_nonzero((surfaces[1:] != surfaces[:-1]).any(axis=1))
    assert changes == len(np.unique(surfaces, axis=0)) - 1


def test_extreme_values_survive(tmp_path: Path) -> None:
    some = sample_gaussians(3, 0)
    scales = np.array([[0, 0, 0], [1e-20, 1e10, 1], [1, 1, 1]], np.float32)
    odd = Gaussians(some.means, scales, some.quaternions, np.array([0, 1, 0.25], np.float32), some.sh)
    write_ply(odd, tmp_path / "a.ply")
    read = read_gaussians(tmp_path / "a.ply")
    np.testing.assert_array_equal(read.opacities[:2], [0, 1])
    np.testing.assert_allclose(read.scales, scales, rtol=1e-5, atol=1e-30)
    far = Gaussians(some.means * 1e6, some.scales, some.quaternions, some.opacities, some.sh)
    (tmp_path / "a.spz").write_bytes(encode_spz(far))
    np.testing.assert_allclose(read_gaussians(tmp_path / "a.spz").means, far.means, atol=2)


# Floaters far out


def directions_to(points: np.ndarray) -> np.ndarray:
    return points / np.linalg.norm(points, axis=1, keepdims=True)


@pytest.fixture(scope="module")
def with_floaters() -> Gaussians:
    """20,000 Gaussians within some units, the last 12 of which are as far out as trainings leave floaters."""
    found = sample_gaussians(20_000, 0)
    found.scales[:] *= np.float32(0.05)
    directions = directions_to(np.random.default_rng(2).normal(size=(12, 3)))
    found.means[-12:] = directions * np.geomspace(2e4, 2e6, 12)[:, None]
    found.scales[-12:] = 300
    return found


def test_floaters_take_no_precision_from_a_compressed_ply(with_floaters: Gaussians, tmp_path: Path) -> None:
    write_gaussians(with_floaters, tmp_path / "a.compressed.ply")
    distances, _ = cKDTree(read_gaussians(tmp_path / "a.compressed.ply").means).query(with_floaters.means[:-12])
    coarse = np.flatnonzero(distances > 0.05)
    visibility = with_floaters.opacities * with_floaters.scales.max(axis=1) ** 2
    assert len(coarse) < 256 and visibility[coarse].sum() < 1e-3 * visibility[:-12].sum()


def test_floaters_take_no_precision_from_spz(
    with_floaters: Gaussians, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    write_gaussians(with_floaters, tmp_path / "a.spz")
    after = read_gaussians(tmp_path / "a.spz")
    np.testing.assert_allclose(after.means[:-12], with_floaters.means[:-12], atol=0.001, rtol=0)
    assert "12 of 20000" in caplog.text or "11 of 20000" in caplog.text
    before, distances = with_floaters.means[-12:], np.linalg.norm(after.means[-12:], axis=1)
    sines = np.linalg.norm(np.cross(directions_to(after.means[-12:]), directions_to(before)), axis=1)
    assert sines.max() < 1e-4  # in the same direction, at the same apparent size
    np.testing.assert_allclose(after.scales[-12:, 0] / distances, 300 / np.linalg.norm(before, axis=1), rtol=0.04)


@pytest.mark.parametrize("suffix", [".spz", ".compressed.ply"])
def test_a_step_that_shows_is_logged(suffix: str, tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    spread = sample_gaussians(2000, 0)
    write_gaussians(spread, tmp_path / f"a{suffix}")
    assert not caplog.text
    spread.means[:] *= np.float32(1e5)
    write_gaussians(spread, tmp_path / f"a{suffix}")
    assert "steps of" in caplog.text


def check_opened(path: Path) -> None:
    """Assert that a file is opened in drawing order, as the window does."""
    (layer,) = load_sorted_scene(str(path)).layers
    read = read_scene(path).layers[0].gaussians
    for found, array in zip(layer.gaussians.arrays, read.take(lod_order(read)).arrays, strict=True):
        np.testing.assert_array_equal(found, array)


@pytest.mark.parametrize("name", SMALL_FILES)
def test_every_format_opens_in_drawing_order(name: str, tmp_path: Path) -> None:
    check_opened(write_small(name, tmp_path))


# Real files


@pytest.mark.parametrize(
    ("file", "count", "sh_degree"),
    [
        ("pc_short.ply", 100, 3), ("plant.splat", 113_648, 0), ("biker.spz", 152_746, 0),
        *((f"playbot/playbot_lod3_31k_sh2.{suffix}", 31_000, 2)
          for suffix in ("ply", "compressed.ply", "sog", "v3.spz", "v4.spz")),
        *((f"minimal/minimal{name}", 4, 0)
          for name in ("-raw.spz", "-v2.spz", "-v3.spz", "-v4.spz", ".splat", ".ksplat")),
    ],
)  # fmt: skip
def test_real_files(file: str, count: int, sh_degree: int, test_data: Path) -> None:
    gaussians = read_gaussians(test_data / "scenes" / file)
    assert len(gaussians) == count
    assert gaussians.sh_degree >= sh_degree
    assert_valid(gaussians)
    if file.startswith("minimal"):
        # Four Gaussians of radius 0.1 and opacity 0.9 on the corners of a unit square.
        corners = np.unique(np.abs(gaussians.means[:, [0, 2]]), axis=0)
        np.testing.assert_array_equal(corners, [[0, 0], [0, 1], [1, 0], [1, 1]])
        np.testing.assert_allclose(gaussians.scales, 0.1, rtol=0.02)
        np.testing.assert_allclose(gaussians.opacities, 0.9, atol=0.003)
        np.testing.assert_allclose(np.abs(gaussians.quaternions).max(axis=1), 1, atol=1e-3)
        if file.endswith("ksplat"):  # red grows along x; the first byte is the display color
            red = gaussians.sh[:, 0, 0] * SH_C0 + 0.5
            np.testing.assert_allclose(red, np.array([0x55, 0xAA, 0x55, 0xAA]) / 255, atol=1e-6)
    elif file.startswith("plant"):
        np.testing.assert_allclose(np.ptp(gaussians.means, axis=0), [0.5172, 1.0, 0.6098], atol=2e-4)  # plant.meta.json
    check_opened(test_data / "scenes" / file)


@pytest.fixture(scope="module")
def original(test_data: Path) -> Gaussians:
    """The PLY, read without any of our code."""
    names, values = columns_of((test_data / f"{PLAYBOT}.ply").read_bytes())
    columns = dict(zip(names, values.T, strict=True))
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


@pytest.mark.parametrize(
    ("suffix", "mean", "log_scale", "base", "slope"),
    [
        ("ply", 1e-9, 1e-6, 1e-9, 1e-6),
        ("compressed.ply", 2e-4, 0.004, 0.02, 0.01),
        ("sog", 1e-6, 1e-5, 1e-6, 1e-6),  # the PLY was made from it: nothing but rounding may lie between them
        ("v3.spz", 1.3e-4, 0.032, 0.0135, 0.02),
        ("v4.spz", 1.3e-4, 0.032, 0.0135, 0.02),
    ],
)
def test_one_scene_in_five_files_agrees(
    suffix: str, mean: float, log_scale: float, base: float, slope: float, original: Gaussians, test_data: Path
) -> None:
    a, b = matched(original, read_gaussians(test_data / f"{PLAYBOT}.{suffix}"))
    errors = {
        "mean": (np.abs(a.means - b.means), mean),
        "log scale": (np.abs(np.log(a.scales) - np.log(b.scales)), log_scale),
        "opacity": (np.abs(a.opacities - b.opacities), 0.004),
        "quaternion": (1 - np.abs((a.quaternions * b.quaternions).sum(1)), 1e-4),
        "color": (np.abs(a.sh[:, 0] - b.sh[:, 0]), base),
    }
    for name, (error, bound) in errors.items():
        assert np.quantile(error, 0.98) < bound, name
    # Every harmonic by itself: a wrong sign or a wrong order makes its slope -1 or 0. SPZ ends at 1.
    inside = np.abs(a.sh) < 0.95
    slopes = (a.sh * b.sh * inside).sum((0, 2)) / (a.sh**2 * inside).sum((0, 2))
    np.testing.assert_allclose(slopes, 1, atol=slope)
