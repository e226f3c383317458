"""KSPLAT: a small encoder of our own for every level and degree, the real minimal file, and damage.

No real file of levels 1 and 2 is free to ship: the encoder below follows `SplatBuffer.js` (mkkellogg, MIT).
"""

import struct
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from gsrain_engine.scene.files import SceneFormatError
from gsrain_engine.scene.formats.ksplat import read_ksplat
from gsrain_engine.scene.gaussians import COEFFICIENTS_OF_DEGREE, SH_C0, Gaussians
from gsrain_engine.scene.geometry import normalized

FUZZ = settings(max_examples=200, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
BLOCK = 5.0
BUCKET = 16


def some_gaussians(n: int, degree: int, seed: int = 0) -> Gaussians:
    rng = np.random.default_rng(seed)
    return Gaussians(
        rng.uniform(-10, 10, (n, 3)).astype(np.float32),
        np.exp(rng.uniform(-5, 1, (n, 3))).astype(np.float32),
        normalized(rng.normal(size=(n, 4)).astype(np.float32)),
        rng.random(n).astype(np.float32),
        rng.uniform(-1.4, 1.4, (n, COEFFICIENTS_OF_DEGREE[degree], 3)).astype(np.float32),
    )


def into_buckets(g: Gaussians) -> tuple[Gaussians, np.ndarray, list[int], int]:
    """Sort by 5 m block and cut into buckets of 16, full ones first; centres, lengths of the others, number of full."""
    blocks = np.floor(g.means / BLOCK)
    order = np.lexsort(blocks.T)
    starts = np.flatnonzero(np.r_[True, np.any(np.diff(blocks[order], axis=0) != 0, axis=1)])
    pieces = [p[i : i + BUCKET] for p in np.split(order, starts[1:]) for i in range(0, len(p), BUCKET)]
    pieces.sort(key=lambda piece: len(piece) < BUCKET)
    centres = np.array([(blocks[piece[0]] + 0.5) * BLOCK for piece in pieces], np.float32)
    full = sum(len(piece) == BUCKET for piece in pieces)
    return g.take(np.concatenate(pieces)), centres, [len(piece) for piece in pieces[full:]], full


def encode_section(g: Gaussians, level: int) -> tuple[Gaussians, bytes, bytes]:
    """Gaussians in file order, section header, section."""
    centres, lengths, full = np.zeros((0, 3), np.float32), [], 0
    stored = g.means.astype("<f4")
    if level:
        g, centres, lengths, full = into_buckets(g)
        center = np.repeat(centres, [BUCKET] * full + lengths, axis=0)
        stored = np.clip(np.round((g.means - center) * (32767 / (BLOCK / 2))) + 32767, 0, 65535).astype("<u2")
    number = "<f4" if level == 0 else "<f2"
    color = np.round(np.concatenate([g.sh[:, 0] * SH_C0 + 0.5, g.opacities[:, None]], axis=1) * 255)
    # Degree by degree, and within a degree channel by channel.
    bands = [g.sh[:, d * d : (d + 1) ** 2].transpose(0, 2, 1).reshape(len(g), -1) for d in range(1, g.sh_degree + 1)]
    rest = np.concatenate(bands, axis=1) if bands else np.zeros((len(g), 0))
    if level == 2:
        rest = np.floor((rest + 1.5) / 3 * 255)
    columns = [
        stored,
        g.scales.astype(number),
        g.quaternions.astype(number),
        np.clip(color, 0, 255).astype("u1"),
        rest.astype(("<f4", "<f2", "u1")[level]),
    ]
    rows = np.concatenate([np.ascontiguousarray(c).view("u1").reshape(len(g), -1) for c in columns], axis=1)
    body = np.array(lengths, "<u4").tobytes() + centres.astype("<f4").tobytes() + rows.tobytes()
    buckets = (BUCKET, len(centres), BLOCK, 12) if level else (0, 0, 0.0, 0)
    header = struct.pack(
        "<IIIIfHxxIIIIH", len(g), len(g), *buckets, 32767 if level else 0, len(body), full, len(lengths), g.sh_degree
    )
    return g, header.ljust(1024, b"\0"), body


def encode(parts: list[Gaussians], level: int) -> tuple[Gaussians, bytes]:
    sections = [encode_section(part, level) for part in parts]
    n = sum(map(len, parts))
    header = struct.pack("<BBxxIIIIHxx3fff", 0, 1, len(parts), len(parts), n, n, level, 0, 0, 0, 0, 0)
    data = header.ljust(4096, b"\0") + b"".join(s[1] for s in sections) + b"".join(s[2] for s in sections)
    return Gaussians.concatenate([s[0] for s in sections]), data


def read_bytes(folder: Path, data: bytes) -> Gaussians:
    path = folder / "scene.ksplat"
    path.write_bytes(data)
    return read_ksplat(path)


@pytest.mark.parametrize("level", range(3))
@pytest.mark.parametrize("degrees", [(0,), (1,), (2,), (2, 0), (0, 1, 2)])
def test_every_level_and_degree(level: int, degrees: tuple[int, ...], tmp_path: Path) -> None:
    parts = [some_gaussians(700, degree, seed) for seed, degree in enumerate(degrees)]
    before, data = encode(parts, level)
    after = read_bytes(tmp_path, data)
    half = 1e-6 if level == 0 else 2**-10
    np.testing.assert_allclose(after.means, before.means, atol=0 if level == 0 else 0.51 * BLOCK / 2 / 32767)
    np.testing.assert_allclose(after.scales, before.scales, rtol=half)
    np.testing.assert_allclose(after.quaternions, before.quaternions, atol=2 * half)
    np.testing.assert_allclose(after.opacities, before.opacities, atol=0.51 / 255)
    np.testing.assert_allclose(after.sh[:, 0], before.sh[:, 0], atol=0.51 / 255 / SH_C0)
    rest = (1e-6, 2e-3, 3.01 / 255)[level]
    np.testing.assert_allclose(after.sh[:, 1:], before.sh[:, 1:], atol=rest)


def test_header_gives_the_range_of_8_bit_harmonics(tmp_path: Path) -> None:
    _, data = encode([some_gaussians(20, 1)], 2)
    usual = read_bytes(tmp_path, data).sh[:, 1:]
    wide = read_bytes(tmp_path, data[:36] + struct.pack("<ff", -3, 3) + data[44:]).sh[:, 1:]
    np.testing.assert_allclose(wide, 2 * usual, atol=1e-5)


def test_minimal_file(test_data: Path) -> None:
    g = read_ksplat(test_data / "scenes/minimal/minimal.ksplat")
    np.testing.assert_array_equal(g.means, [[-1, 0, -1], [0, 0, -1], [-1, 0, 0], [0, 0, 0]])
    np.testing.assert_allclose(g.scales, 0.1)
    np.testing.assert_allclose(g.opacities, 230 / 255)
    # Red grows along x, green along z; the first three bytes are the display color.
    np.testing.assert_allclose(g.sh[:, 0, 0] * SH_C0 + 0.5, np.array([0x55, 0xAA, 0x55, 0xAA]) / 255, atol=1e-6)


@pytest.mark.parametrize("level", [0, 2])
def test_cut_off_is_refused(level: int, tmp_path: Path) -> None:
    _, data = encode([some_gaussians(20, 1)], level)
    for end in [0, 1, 4095, 4096, 5119, *range(5120, len(data), 7), len(data) - 1]:
        with pytest.raises(SceneFormatError):
            read_bytes(tmp_path, data[:end])


def patched(level: int, offset: int, form: str, *values: float) -> bytes:
    data = bytearray(encode([some_gaussians(40, 2)], level)[1])
    struct.pack_into(form, data, offset, *values)
    return bytes(data)


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (bytes(5000), r"version is 0\.0"),
        (patched(0, 4, "<I", 2**32 - 1), "4294967295 sections"),
        (patched(0, 16, "<I", 41), "hold 40 Gaussians, the header says 41"),
        (patched(0, 20, "<H", 3), "compression level 3"),
        (patched(0, 4096 + 4, "<I", 2**32 - 1), "cut off"),
        (patched(0, 4096, "<I", 41), "room for 40 Gaussians and holds 41"),
        (patched(0, 4096 + 40, "<H", 3), "SH degree 3"),
        (patched(2, 36, "<ff", 1, 0.5), "from low to high"),
        (patched(1, 4096 + 20, "<H", 8), "buckets of 8 bytes"),
        (patched(1, 4096 + 12, "<I", 2**32 - 1), "cut off"),
        (patched(1, 4096 + 32, "<I", 2**32 - 1), "4294967295 full"),
        (patched(1, 5120, "<I", 0), "hold 3. of its 40"),
        (patched(0, 5120 + 4, "<f", np.nan), "mean that is not a finite number, the first is number 0"),
        (patched(0, 5120 + 12, "<f", -1), "negative scale"),
        (patched(0, 5120 + 24, "<4f", 0, 0, 0, 0), "zero quaternion"),
        (patched(0, 5120 + 24, "<f", 1e30), "quaternion longer than 1"),
        (patched(0, 5120 + 44, "<f", np.inf), "color that is not a finite number"),
    ],
)
def test_what_is_wrong_is_said(data: bytes, words: str, tmp_path: Path) -> None:
    with pytest.raises(SceneFormatError, match=words):
        read_bytes(tmp_path, data)


@given(data=st.data(), level=st.integers(0, 2))
@FUZZ
def test_damage_is_read_or_refused(data: st.DataObject, level: int, tmp_path: Path) -> None:
    raw = bytearray(encode([some_gaussians(20, 1), some_gaussians(5, 2)], level)[1])
    # The headers are mostly zeros: aim at what is read of them, and at the data.
    places = [*range(44), *range(4096, 4138), *range(5120, 5162), *range(6144, len(raw))]
    for _ in range(data.draw(st.integers(1, 4))):
        raw[data.draw(st.sampled_from(places))] = data.draw(st.integers(0, 255))
    try:
        g = read_bytes(tmp_path, bytes(raw))
    except SceneFormatError as error:
        assert error.path == tmp_path / "scene.ksplat"
    else:
        assert all(np.isfinite(a).all() for a in (g.means, g.scales, g.opacities, g.sh))
        np.testing.assert_allclose(np.linalg.norm(g.quaternions, axis=1), 1, atol=1e-5)
        assert (g.scales >= 0).all()
