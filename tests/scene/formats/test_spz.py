"""SPZ: the real files, our own round trip, and damage."""

import gzip
import struct
import tracemalloc
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import zstandard
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from gsrain_engine.scene.files import SceneFormatError
from gsrain_engine.scene.formats.spz import encode_spz, read_spz, write_spz
from gsrain_engine.scene.gaussians import COEFFICIENTS_OF_DEGREE, Gaussians, evaluate_sh
from gsrain_engine.scene.geometry import matrices_from_quaternions, normalized

FUZZ = settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])


def some_gaussians(n: int, degree: int, seed: int = 0, reach: float = 100.0) -> Gaussians:
    rng = np.random.default_rng(seed)
    return Gaussians(
        rng.uniform(-reach, reach, (n, 3)).astype(np.float32),
        np.exp(rng.uniform(-8, 2, (n, 3))).astype(np.float32),
        normalized(rng.normal(size=(n, 4)).astype(np.float32)),
        rng.random(n).astype(np.float32),
        rng.uniform(-0.95, 0.95, (n, COEFFICIENTS_OF_DEGREE[degree], 3)).astype(np.float32),
    )


def version_4(gaussians: Gaussians) -> bytes:
    """The streams of our version 3, each in a zstd frame."""
    data = gzip.decompress(encode_spz(gaussians))
    n = len(gaussians)
    sizes = [9 * n, n, 3 * n, 3 * n, 4 * n, 3 * n * (gaussians.sh.shape[1] - 1)]
    ends = np.cumsum([16, *sizes]).tolist()
    streams = [data[a:b] for a, b in pairwise(ends) if b > a]
    frames = [zstandard.compress(stream) for stream in streams]
    header = struct.pack("<4sII4BI12x", b"NGSP", 4, n, gaussians.sh_degree, data[13], 0, len(streams), 32)
    table = b"".join(struct.pack("<QQ", len(f), len(s)) for f, s in zip(frames, streams, strict=True))
    return header + table + b"".join(frames)


def read_bytes(folder: Path, data: bytes) -> Gaussians:
    path = folder / "scene.spz"
    path.write_bytes(data)
    return read_spz(path)


def assert_valid(gaussians: Gaussians) -> None:
    for values in (gaussians.means, gaussians.scales, gaussians.opacities, gaussians.sh):
        assert np.isfinite(values).all()
    np.testing.assert_allclose(np.linalg.norm(gaussians.quaternions, axis=1), 1, atol=1e-5)
    assert (gaussians.scales >= 0).all()
    assert ((gaussians.opacities >= 0) & (gaussians.opacities <= 1)).all()


def read_or_refuse(folder: Path, data: bytes) -> None:
    try:
        gaussians = read_bytes(folder, data)
    except SceneFormatError as error:
        assert error.path == folder / "scene.spz"
        assert error.problem
    else:
        assert_valid(gaussians)


@pytest.mark.parametrize("degree", range(4))
@pytest.mark.parametrize("encode", [encode_spz, version_4])
def test_round_trip_within_quantization(degree: int, encode, tmp_path: Path) -> None:
    before = some_gaussians(2000, degree)
    after = read_bytes(tmp_path, encode(before))
    np.testing.assert_allclose(after.means, before.means, atol=2**-17 + 1e-5)
    np.testing.assert_allclose(np.log(after.scales), np.log(before.scales), atol=1 / 32 + 1e-5)
    np.testing.assert_allclose(after.opacities, before.opacities, atol=0.5 / 255 + 1e-6)
    np.testing.assert_allclose(after.sh[:, 0], before.sh[:, 0], atol=0.5 / 255 / 0.15 + 1e-6)
    np.testing.assert_allclose(after.sh[:, 1:], before.sh[:, 1:], atol=0.5 / 128 + 1e-6)
    cosines = np.abs((after.quaternions * before.quaternions).sum(1))
    assert cosines.min() > 1 - 4e-6


def test_axes_turn_half_about_x() -> None:
    # What SPZ stores, read as if its axes were ours, is the scene turned half about x: means, shapes and colors alike.
    before = some_gaussians(300, 3)
    stored = gzip.decompress(encode_spz(before))
    fixed = np.frombuffer(stored, np.uint8, 9 * 300, 16).reshape(300, 3, 3).astype(np.int32)
    means = ((fixed[..., 0] | fixed[..., 1] << 8 | fixed[..., 2] << 16) << 8 >> 8) / 2.0 ** stored[13]
    np.testing.assert_allclose(means, before.means * [1, -1, -1], atol=1e-4)
    rest = np.frombuffer(stored, np.uint8)[-300 * 45 :].reshape(300, 15, 3).astype(np.float32) / 128 - 1
    flipped = np.concatenate([before.sh[:, :1], rest], axis=1)
    turn = np.diag([1.0, -1.0, -1.0])
    d = np.random.default_rng(2).normal(size=(300, 3))
    d = (d / np.linalg.norm(d, axis=1, keepdims=True)).astype(np.float32)
    seen = evaluate_sh(flipped, (d @ turn).astype(np.float32))
    np.testing.assert_allclose(seen, evaluate_sh(before.sh, d), atol=0.05)


def test_quaternions_are_stored_in_spz_axes(tmp_path: Path) -> None:
    before = some_gaussians(100, 0)
    after = read_bytes(tmp_path, encode_spz(before))
    np.testing.assert_allclose(
        matrices_from_quaternions(after.quaternions), matrices_from_quaternions(before.quaternions), atol=5e-3
    )
    signs = np.sign((after.quaternions * before.quaternions).sum(axis=1, keepdims=True))
    off = np.sort(np.abs(after.quaternions - signs * before.quaternions), axis=1)
    assert off[:, 2].max() < 0.51 * np.sqrt(0.5) / 511  # of the three that are stored, half a step
    packed = np.frombuffer(gzip.decompress(encode_spz(before)), "<u4", 100, 16 + 100 * 16)
    # The largest component, in the order x, y, z, w, is the same in both frames.
    expected = np.abs(before.quaternions[:, [1, 2, 3, 0]]).argmax(axis=1)
    assert (packed >> 30 == expected).all()


def test_version_1_has_half_floats(tmp_path: Path) -> None:
    means = np.array([[1.5, -2, 0.25], [0, 100, -0.125]], "<f2")
    body = means.tobytes() + bytes([0, 255]) + bytes([128] * 6) + bytes([160] * 6) + bytes([127, 255, 128, 128, 128, 0])
    g = read_bytes(tmp_path, gzip.compress(struct.pack("<4sIIBBBB", b"NGSP", 1, 2, 0, 12, 0, 0) + body))
    np.testing.assert_array_equal(g.means, means.astype(np.float32) * [1, -1, -1])
    np.testing.assert_allclose(g.scales, 1)
    np.testing.assert_allclose(np.abs(g.quaternions), [[0, 0, 1, 0], [0, 0, 0, 1]], atol=0.01)


def test_empty_and_huge_scenes(tmp_path: Path) -> None:
    assert len(read_bytes(tmp_path, encode_spz(Gaussians.empty(2)))) == 0
    far = some_gaussians(50, 0, reach=5e6)
    np.testing.assert_allclose(read_bytes(tmp_path, encode_spz(far)).means, far.means, atol=0.6)
    with pytest.raises(ValueError, match="units from the origin"):
        encode_spz(some_gaussians(50, 0, reach=1e8))


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_means_that_are_not_finite_are_neither_written_nor_read(value: float, tmp_path: Path) -> None:
    broken = some_gaussians(3, 0)
    broken.means[1, 2] = value
    with pytest.raises(ValueError, match="units from the origin, not"):
        encode_spz(broken)
    halves = header(1, 2, bits=0) + struct.pack("<6e", 0, 1, 2, 3, value, 5) + bytes(20)
    with pytest.raises(SceneFormatError, match="1 of 2 Gaussians have a mean that is not a finite .* number 1"):
        read_bytes(tmp_path, halves)


@pytest.mark.parametrize(("units", "bits"), [(0.0, 16), (127.99, 16), (128.0, 15), (8_388_606.0, 0)])
def test_means_have_the_finest_step_that_24_bits_have_room_for(units: float, bits: int, tmp_path: Path) -> None:
    g = some_gaussians(1, 0)
    g.means[0] = units, -units, 0
    data = encode_spz(g)
    assert gzip.decompress(data)[13] == bits
    np.testing.assert_allclose(read_bytes(tmp_path, data).means, g.means, atol=0.5 / 2**bits, rtol=0)
    g.means[0, 0] = 8_388_607
    with pytest.raises(ValueError, match="up to 8388607 units"):
        encode_spz(g)


def test_extensions_after_the_gaussians_are_left_unread(tmp_path: Path) -> None:
    data = bytearray(gzip.decompress(encode_spz(some_gaussians(4, 1))))
    before = read_bytes(tmp_path, bytes(data))
    data[14] |= 2
    for packed in (bytes, gzip.compress):
        after = read_bytes(tmp_path, packed(bytes(data) + bytes(2**20)))
        np.testing.assert_array_equal(after.means, before.means)
        with pytest.raises(SceneFormatError):
            read_bytes(tmp_path, packed(bytes(data) + bytes(2**20 + 1)))
    data[14] = 1  # another flag
    with pytest.raises(SceneFormatError, match="bytes, not"):
        read_bytes(tmp_path, bytes(data) + b"x")


def test_numbers_are_those_of_the_format(tmp_path: Path) -> None:
    """As Niantic's description has them, in steps: log scales 1/16 from -10, harmonics 1/128, turns 511."""
    means = b"".join(struct.pack("<i", value << 8)[1:] for value in (3, -5, 1))
    turn = 3 << 30 | 100 << 20 | 50 << 10 | 512 | 25  # w is the largest; x, y and, negative, z
    body = bytes([51, 0, 255, 51, 160, 0, 255]) + struct.pack("<I", turn) + bytes([128, 0, 255] * 3)
    g = read_bytes(tmp_path, header(3, 1, degree=1, bits=1) + means + body)
    np.testing.assert_array_equal(g.means, [[1.5, 2.5, -0.5]])
    np.testing.assert_allclose(g.opacities, 0.2)
    np.testing.assert_allclose(g.sh[0, 0], [-0.5 / 0.15, 0.5 / 0.15, -0.3 / 0.15], rtol=1e-5)
    np.testing.assert_allclose(g.scales, np.exp([[0, -10, 255 / 16 - 10]]), rtol=1e-6)
    np.testing.assert_allclose(g.quaternions[0, 1:], np.sqrt(0.5) / 511 * np.array([100, -50, 25]), rtol=1e-5)
    np.testing.assert_allclose(np.linalg.norm(g.quaternions), 1)
    np.testing.assert_allclose(g.sh[0, 1:], np.outer([-1, -1, 1], [0, -1, 127 / 128]))


def test_written_files_are_the_same_bytes_each_time(tmp_path: Path) -> None:
    g = some_gaussians(100, 1)
    write_spz(g, tmp_path / "a.spz")
    assert (tmp_path / "a.spz").read_bytes() == encode_spz(g)


def test_real_files(test_data: Path) -> None:
    biker = read_spz(test_data / "scenes/biker.spz")
    assert len(biker) == 152_746
    assert_valid(biker)
    for name in ("raw", "v2", "v3", "v4"):
        g = read_spz(test_data / f"scenes/minimal/minimal-{name}.spz")
        assert len(g) == 4
        # Four Gaussians of radius 0.1 and opacity 0.9 on the corners of a unit square.
        np.testing.assert_array_equal(np.unique(np.abs(g.means[:, [0, 2]]), axis=0), [[0, 0], [0, 1], [1, 0], [1, 1]])
        np.testing.assert_allclose(g.scales, 0.1, rtol=0.02)
        np.testing.assert_allclose(g.opacities, 0.9, atol=0.003)
        np.testing.assert_allclose(g.quaternions[:, 0], 1, atol=1e-3)


@pytest.mark.parametrize("encode", [encode_spz, version_4, lambda g: gzip.decompress(encode_spz(g))])
def test_cut_off_anywhere_is_refused(encode, tmp_path: Path) -> None:
    data = encode(some_gaussians(5, 1))
    for end in range(len(data)):
        with pytest.raises(SceneFormatError):
            read_bytes(tmp_path, data[:end])


def header(version: int, count: int, degree: int = 0, bits: int = 12, flags: int = 0, streams: int = 0) -> bytes:
    return struct.pack("<4sIIBBBB", b"NGSP", version, count, degree, bits, flags, streams)


def one_with_table(packed_size: int, unpacked_size: int) -> bytes:
    """Version 4 with one Gaussian, whose five streams all have these sizes."""
    return header(4, 1, streams=5) + struct.pack("<I12x", 32) + struct.pack("<QQ", packed_size, unpacked_size) * 5


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"", "header of 16 bytes"),
        (b"PLY file, not SPZ", "not an SPZ file"),
        (gzip.compress(b"something else entirely", mtime=0), "not an SPZ file"),
        (header(5, 0), "version 5"),
        (header(3, 0, degree=4), "SH degree 4"),
        (header(3, 0, bits=24), "24 fractional bits"),
        (gzip.compress(header(3, 2**32 - 1, degree=3), mtime=0), "can't be in a file"),
        (header(4, 2**32 - 1, streams=5) + bytes(100), "can't be in a file"),
        (gzip.compress(header(3, 10) + bytes(10), mtime=0), "take 216 bytes"),
        (gzip.compress(header(3, 10) + bytes(10**7), mtime=0), "more than the 216 bytes"),
        (gzip.compress(header(4, 0), mtime=0), "inside gzip"),
        (header(4, 10, streams=7) + bytes(200), "7 streams"),
        (header(4, 10, streams=5) + struct.pack("<I12x", 2**31) + bytes(200), "table of contents"),
        (one_with_table(1, 2**60) + bytes(9), "must hold 9 bytes"),
        (one_with_table(2**60, 9), "cut off"),
        (one_with_table(4, 9) + bytes(20), "zstd"),
        (header(1, 1, bits=0) + struct.pack("<3e", 0, np.nan, 0) + bytes(10), "mean that is not a finite"),
    ],
)
def test_what_is_wrong_is_said(data: bytes, words: str, tmp_path: Path) -> None:
    with pytest.raises(SceneFormatError, match=words):
        read_bytes(tmp_path, data)


def test_bombs_take_no_memory(tmp_path: Path) -> None:
    gzip_bomb = gzip.compress(header(3, 10, degree=3) + bytes(100_000_000), compresslevel=9)
    frame = zstandard.compress(bytes(100_000_000))
    zstd_bomb = one_with_table(len(frame), 9) + frame * 5
    tracemalloc.start()
    try:
        for bomb in (gzip_bomb, zstd_bomb):
            with pytest.raises(SceneFormatError):
                read_bytes(tmp_path, bomb)
        assert tracemalloc.get_traced_memory()[1] < 20e6
    finally:
        tracemalloc.stop()


@given(data=st.data(), encode=st.sampled_from([encode_spz, version_4, lambda g: gzip.decompress(encode_spz(g))]))
@FUZZ
def test_flipped_bytes_are_read_or_refused(data: st.DataObject, encode, tmp_path: Path) -> None:
    raw = bytearray(encode(some_gaussians(6, 2)))
    for _ in range(data.draw(st.integers(1, 4))):
        raw[data.draw(st.integers(0, len(raw) - 1))] = data.draw(st.integers(0, 255))
    read_or_refuse(tmp_path, bytes(raw))


@given(
    version=st.integers(0, 6),
    count=st.integers(0, 2**32 - 1) | st.integers(0, 10),
    rest=st.binary(min_size=4, max_size=4),
    body=st.binary(max_size=300),
    zipped=st.booleans(),
)
@FUZZ
def test_any_header_is_read_or_refused(
    version: int, count: int, rest: bytes, body: bytes, zipped: bool, tmp_path: Path
) -> None:
    raw = struct.pack("<4sII", b"NGSP", version, count) + rest + body
    read_or_refuse(tmp_path, gzip.compress(raw) if zipped else raw)
