"""Values lie where each format has them: files written by their specifications, and ours read without our readers."""

import gzip
import json
import re
import struct
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gsrain_engine.safe_io.errors import SceneFormatError
from gsrain_engine.scene.formats.registry import read_gaussians
from gsrain_engine.scene.formats.scene_files import read_scene
from gsrain_engine.scene.formats.spz import encode_spz
from gsrain_engine.scene.gaussians import SH_C0, Gaussians

from .sample_files import (
    BOUNDS,
    SOG_COUNT,
    assert_equal,
    compressed,
    gltf,
    ksplat,
    old_spz,
    sample_gaussians,
    sog_image,
    sog_scene,
    sog_version_1,
    spz_header,
    write_sog_folder,
    written,
    zipped,
)


def read_bytes(folder: Path, name: str, data: bytes) -> Gaussians:
    (folder / name).write_bytes(data)
    return read_gaussians(folder / name)


# PLY


def columns_of(data: bytes) -> tuple[list[str], np.ndarray]:
    """Property names and values of a PLY of floats, read without our reader."""
    header, body = data.split(b"end_header\n", 1)
    names = [line.split()[2].decode() for line in header.splitlines() if line.startswith(b"property float")]
    return names, np.frombuffer(body, "<f4", len(body) // 4 // len(names) * len(names)).reshape(-1, len(names))


def ply_of(names: list[str], values: np.ndarray, kind: str = "float", order: str = "<") -> bytes:
    """A PLY with these columns, written without our writer."""
    endian = {"<": "little", ">": "big"}[order]
    lines = [f"format binary_{endian}_endian 1.0", "comment made by a test", f"element vertex {len(values)}"]
    lines += [f"property {kind} {name}" for name in names]
    text = "\n".join(["ply", *lines, "end_header", ""])
    return text.encode() + values.astype(order + {"float": "f4", "double": "f8"}[kind]).tobytes()


def write_text(ply: bytes, before: str = "") -> bytes:
    """The same PLY as text; `before` are lines of an element `note` of one number."""
    names, values = columns_of(ply)
    note = f"element note {before.count(chr(10))}\nproperty int number\n" * bool(before)
    properties = "".join(f"property float {name}\n" for name in names)
    lines = "".join(" ".join(repr(float(value)) for value in row) + "\n" for row in values)
    head = f"ply\nformat ascii 1.0\n{note}element vertex {len(values)}\n{properties}end_header\n"
    return (head + before + lines).encode()


@pytest.fixture
def ply() -> bytes:
    return written(sample_gaussians(), ".ply")


def test_the_written_layout_is_that_of_3dgs(ply: bytes, test_data: Path) -> None:
    theirs = re.findall(rb"property \w+ (\w+)", (test_data / "scenes/pc_short.ply").read_bytes()[:3000])
    names, values = columns_of(ply)
    assert names == [name.decode() for name in theirs]
    gaussians = sample_gaussians()
    np.testing.assert_array_equal(values[:, names.index("f_rest_15")], gaussians.sh[:, 1, 1])
    np.testing.assert_allclose(values[:, names.index("scale_2")], np.log(gaussians.scales[:, 2]), rtol=1e-6)


def test_other_writers_properties_in_any_order_and_type_are_read(ply: bytes, tmp_path: Path) -> None:
    names, values = columns_of(ply)
    shuffled = np.random.default_rng(3).permutation(len(names))
    without_normals = [i for i, name in enumerate(names) if name not in ("nx", "ny", "nz")]
    extra = np.full((len(values), 1), np.nan)
    header, rows = ply.split(b"end_header\n", 1)
    start, vertex = header.split(b"element vertex", 1)
    camera = b"element camera 2\nproperty double focal\nproperty uchar kind\n"
    face = b"element face 1\nproperty list uchar int vertex_indices\n"
    variants = [
        *(
            ply_of([names[i] for i in shuffled], values[:, shuffled], kind, order)
            for kind, order in [("float", "<"), ("float", ">"), ("double", "<"), ("double", ">")]
        ),
        ply_of(["confidence", *(names[i] for i in without_normals)], np.hstack([extra, values[:, without_normals]])),
        b"".join([start, camera, b"element vertex", vertex, face, b"end_header\n", bytes(18), rows, b"\3", bytes(12)]),
        (header + b"end_header\n").replace(b"\n", b"\r\n") + rows,
        write_text(ply).replace(b"\n", b"\r\n").removesuffix(b"\r\n"),
    ]
    for variant in variants:
        assert_equal(read_bytes(tmp_path, "a.ply", variant), sample_gaussians())


def test_only_bytes_after_the_rows_of_a_ply_are_reported(
    ply: bytes, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    read_bytes(tmp_path, "a.ply", ply)
    assert not caplog.messages
    assert_equal(read_bytes(tmp_path, "a.ply", ply + b"abc"), sample_gaussians())
    assert "3 bytes follow the rows" in caplog.messages[0]


def test_bits_of_a_compressed_ply(tmp_path: Path) -> None:
    gaussians = read_bytes(tmp_path, "a.compressed.ply", compressed(257, 2, BOUNDS[:6], sh_rows=257))
    assert len(gaussians) == 257
    middle = [2 * 1024 / 2047 - 1, 2 * 512 / 1023 - 1, 2 * 1024 / 2047 - 1]
    np.testing.assert_allclose(gaussians.means[256], middle, atol=1e-6)
    np.testing.assert_allclose(gaussians.scales[0], np.exp([1, -1, -1]), rtol=1e-6)
    np.testing.assert_allclose(gaussians.quaternions[0], [0.0007, 0.0007, 1, 0.0007], atol=1e-5)
    np.testing.assert_allclose(gaussians.sh[0, 0] * SH_C0 + 0.5, [0.2, 0.4, 1], atol=1e-6)
    assert gaussians.opacities[0] == pytest.approx(0.8)
    np.testing.assert_allclose(gaussians.sh[0, 1:, 0], [-4, 4, 4 / 256], atol=1e-6)
    bounded = read_bytes(tmp_path, "a.ply", compressed(1, 1, BOUNDS))  # colors within -1..1, too
    np.testing.assert_allclose(bounded.sh[0, 0] * SH_C0 + 0.5, [-0.6, -0.2, 1], atol=1e-6)


# .splat


def test_splat_clamps_colors_and_stays_as_it_is_when_written_anew(tmp_path: Path) -> None:
    one = sample_gaussians(1, 0)
    bright = Gaussians(one.means, one.scales, one.quaternions, one.opacities, np.array([[[9, -9, 0]]], np.float32))
    assert list(written(bright, ".splat")[24:27]) == [255, 0, 128]
    first = written(sample_gaussians(), ".splat")
    second = written(read_bytes(tmp_path, "a.splat", first), ".splat")
    a, b = (np.frombuffer(data, np.uint8).reshape(-1, 32) for data in (first, second))
    np.testing.assert_array_equal(a[:, :28], b[:, :28])
    assert np.abs(a[:, 28:].astype(int) - b[:, 28:]).max() <= 1


# KSPLAT


def test_the_header_of_ksplat_has_the_range_of_8_bit_harmonics(tmp_path: Path) -> None:
    _, data = ksplat([sample_gaussians(20, 1)], 2)
    default = read_bytes(tmp_path, "a.ksplat", data).sh[:, 1:]
    wide = read_bytes(tmp_path, "a.ksplat", data[:36] + struct.pack("<ff", -3, 3) + data[44:]).sh[:, 1:]
    np.testing.assert_allclose(wide, 2 * default, atol=1e-5)


# SPZ


def test_numbers_of_spz_are_those_of_the_format(tmp_path: Path) -> None:
    """As Niantic's description has them, in steps: log scales 1/16 from -10, harmonics 1/128, turns 511."""
    means = b"".join(struct.pack("<i", value << 8)[1:] for value in (3, -5, 1))
    turn = 3 << 30 | 100 << 20 | 50 << 10 | 512 | 25  # w is the largest; x, y and, negative, z
    body = bytes([51, 0, 255, 51, 160, 0, 255]) + struct.pack("<I", turn) + bytes([128, 0, 255] * 3)
    g = read_bytes(tmp_path, "a.spz", spz_header(3, 1, degree=1, bits=1) + means + body)
    np.testing.assert_array_equal(g.means, [[1.5, 2.5, -0.5]])
    np.testing.assert_allclose(g.opacities, 0.2)
    np.testing.assert_allclose(g.sh[0, 0], [-0.5 / 0.15, 0.5 / 0.15, -0.3 / 0.15], rtol=1e-5)
    np.testing.assert_allclose(g.scales, np.exp([[0, -10, 255 / 16 - 10]]), rtol=1e-6)
    np.testing.assert_allclose(g.quaternions[0, 1:], np.sqrt(0.5) / 511 * np.array([100, -50, 25]), rtol=1e-5)
    np.testing.assert_allclose(np.linalg.norm(g.quaternions), 1)
    np.testing.assert_allclose(g.sh[0, 1:], np.outer([-1, -1, 1], [0, -1, 127 / 128]))


def test_version_1_of_spz_has_half_floats(tmp_path: Path) -> None:
    means = np.array([[1.5, -2, 0.25], [0, 100, -0.125]], "<f2")
    body = means.tobytes() + bytes([0, 255]) + bytes([128] * 6) + bytes([160] * 6) + bytes([127, 255, 128, 128, 128, 0])
    g = read_bytes(tmp_path, "a.spz", gzip.compress(spz_header(1, 2) + body))
    np.testing.assert_array_equal(g.means, means.astype(np.float32) * [1, -1, -1])
    np.testing.assert_allclose(g.scales, 1)
    np.testing.assert_allclose(np.abs(g.quaternions), [[0, 0, 1, 0], [0, 0, 0, 1]], atol=0.01)


@pytest.mark.parametrize(("units", "bits"), [(0.0, 16), (127.99, 16), (128.0, 15), (8_388_606.0, 0)])
def test_means_of_spz_have_the_finest_step_that_24_bits_have_room_for(units: float, bits: int, tmp_path: Path) -> None:
    g = sample_gaussians(1, 0)
    g.means[0] = units, -units, 0
    data = encode_spz(g)
    assert list(data[13:16]) == [bits, 0, 5]  # no flags, five streams
    np.testing.assert_allclose(read_bytes(tmp_path, "a.spz", data).means, g.means, atol=0.5 / 2**bits, rtol=0)
    for beyond in (8_388_607, np.nan, -np.inf):
        g.means[0, 0] = beyond
        with pytest.raises(ValueError, match="units from the origin"):
            encode_spz(g)


def test_extensions_after_the_gaussians_of_spz_are_left_unread(tmp_path: Path) -> None:
    data = bytearray(gzip.decompress(old_spz(sample_gaussians(4, 1), 3)))
    before = read_bytes(tmp_path, "a.spz", bytes(data))
    data[14] |= 2
    for packed in (bytes, gzip.compress):
        after = read_bytes(tmp_path, "a.spz", packed(bytes(data) + bytes(2**20)))
        np.testing.assert_array_equal(after.means, before.means)
        with pytest.raises(SceneFormatError):
            read_bytes(tmp_path, "a.spz", packed(bytes(data) + bytes(2**20 + 1)))
    data[14] = 1  # another flag
    with pytest.raises(SceneFormatError, match="bytes, not"):
        read_bytes(tmp_path, "a.spz", bytes(data) + b"x")


# SOG


def log_means(raw: dict[str, np.ndarray]) -> np.ndarray:
    part = (raw["means_l"][:, :3] + 256.0 * raw["means_u"][:, :3]) / 65535
    return np.array([-3, -2, 0.5]) + np.array([6, 3, 0]) * part


@pytest.mark.parametrize("bands", range(4))
def test_version_2_of_sog(bands: int, tmp_path: Path) -> None:
    meta, files, raw = sog_scene(bands)
    g = read_bytes(tmp_path, "a.sog", zipped(meta, files, zipfile.ZIP_DEFLATED))
    np.testing.assert_allclose(g.means, np.sign(log_means(raw)) * (np.exp(np.abs(log_means(raw))) - 1), atol=1e-5)
    np.testing.assert_allclose(np.log(g.scales), -9 + 10 * (raw["scales"][:, :3] / 255), atol=1e-5)
    np.testing.assert_allclose(g.opacities, raw["sh0"][:, 3] / 255, atol=1e-6)
    np.testing.assert_allclose(g.sh[:, 0], -2 + 4 * (raw["sh0"][:, :3] / 255), atol=1e-5)
    assert g.sh_degree == bands
    for i in range(SOG_COUNT if bands else 0):
        row, column = divmod(int(raw["labels"][i]), 64)
        k = g.sh.shape[1] - 1
        entry = raw["palette"][row, column * k : (column + 1) * k]
        np.testing.assert_allclose(g.sh[i, 1:], -1 + 2 * (entry / 255), atol=1e-5)
    for q, pixel in zip(g.quaternions, raw["quats"], strict=True):
        others = np.delete(q, pixel[3] - 252)
        stored = (pixel[:3] / 127.5 - 1) / np.sqrt(2)
        np.testing.assert_allclose(others, stored / max(1, np.linalg.norm(stored)), atol=1e-5)
        assert q[pixel[3] - 252] >= 0


def test_version_1_of_sog(tmp_path: Path) -> None:
    meta, files, raw = sog_scene(1)
    g = read_bytes(tmp_path, "a.sog", zipped(sog_version_1(meta), files))
    new = read_bytes(tmp_path, "a.sog", zipped(meta, files))
    np.testing.assert_array_equal(g.means, new.means)
    np.testing.assert_array_equal(g.quaternions, new.quaternions)
    scales, base = (raw[name] / 255 for name in ("scales", "sh0"))
    np.testing.assert_allclose(np.log(g.scales), [-9, -8, -7] + scales[:, :3] * [10, 8, 9], atol=1e-5)
    np.testing.assert_allclose(g.sh[:, 0], [-1, -2, -3] + base[:, :3] * [2, 4, 6], atol=1e-5)
    np.testing.assert_allclose(np.log(g.opacities / (1 - g.opacities)), -6 + 10 * base[:, 3], atol=1e-3)
    np.testing.assert_allclose(g.sh[:, 1:], new.sh[:, 1:] + 0.5, atol=1e-5)


def test_loose_files_of_sog_must_be_there(tmp_path: Path) -> None:
    (write_sog_folder(tmp_path) / "quats.webp").unlink()
    with pytest.raises(SceneFormatError, match=r"quats\.webp"):
        read_gaussians(tmp_path / "meta.json")


def streamed_sog(folder: Path, **changes: Any) -> Path:
    """A streamed scene whose finest level is one file and a part of another."""
    for name in ("0_0", "0_1", "1_0", "env"):
        (folder / name).mkdir(parents=True, exist_ok=True)
        write_sog_folder(folder / name)
    leaves: list[Any] = [
        {"lods": {"1": {"file": 2, "offset": 0, "count": 5}, "0": {"file": 0, "offset": 0, "count": SOG_COUNT}}},
        {"lods": {"0": {"file": 1, "offset": 3, "count": 4}}},
        {"lods": {"1": {"file": 2, "offset": 5, "count": 2}}},
    ]
    meta: dict[str, Any] = {"lodLevels": 2, "filenames": [f"{name}/meta.json" for name in ("0_0", "0_1", "1_0")]}
    meta |= {"tree": {"children": [leaves[0], {"children": leaves[1:]}]}, "environment": "env/meta.json"}
    (folder / "lod-meta.json").write_text(json.dumps(meta | changes))
    return folder


def test_a_streamed_sog_is_its_finest_level_and_its_environment(tmp_path: Path) -> None:
    folder = streamed_sog(tmp_path / "streamed")
    whole = read_gaussians(folder / "0_0" / "meta.json")
    parts = [whole, whole.take(slice(3, 7)), whole.take(slice(5, 7)), whole]
    for name in (folder, folder / "lod-meta.json"):
        (layer,) = read_scene(name).layers
        assert layer.name == "streamed"
        assert_equal(layer.gaussians, Gaussians.concatenate(parts))


@pytest.mark.parametrize(
    ("changes", "what"),
    [
        ({"filenames": ["0_0/meta.json"]}, "names file 1"),
        ({"filenames": ["../0_0/meta.json", "0_1/meta.json", "1_0/meta.json"]}, "'../0_0/meta.json'"),
        ({"filenames": ["/etc/passwd", "0_1/meta.json", "1_0/meta.json"]}, "'/etc/passwd'"),
        ({"tree": {"lods": {"0": {"file": 0, "offset": SOG_COUNT, "count": 1}}}}, "beyond"),
        ({"tree": 5}, "tree"),
    ],
)
def test_what_is_wrong_with_a_streamed_sog_is_named(changes: dict[str, Any], what: str, tmp_path: Path) -> None:
    with pytest.raises(SceneFormatError, match=rf"lod-meta\.json: .*{what}"):
        read_scene(streamed_sog(tmp_path / "streamed", **changes))


def test_a_codebook_of_sog_that_starts_with_null(tmp_path: Path) -> None:
    meta, files, raw = sog_scene(0)
    raw["sh0"][0, :3] = 0
    files["sh0.webp"] = sog_image(raw["sh0"])
    meta["sh0"]["codebook"][0] = None
    step = 4 / 255
    g = read_bytes(tmp_path, "a.sog", zipped(meta, files))
    np.testing.assert_allclose(g.sh[0, 0], -2 + step - (4 - step) / 255, atol=1e-5)


# glTF


def test_the_draft_of_the_extension_has_colors_for_harmonics(tmp_path: Path) -> None:
    before = sample_gaussians(9, 0)
    values = json.loads(gltf(before))
    attributes = values["meshes"][0]["primitives"][0]["attributes"]
    ours = {"_SCALE": "SCALE", "_ROTATION": "ROTATION"}
    draft = {name: attributes[f"KHR_gaussian_splatting:{own}"] for name, own in ours.items()}
    draft |= {name: attributes[name] for name in ("POSITION", "COLOR_0")}
    values["meshes"][0]["primitives"][0]["attributes"] = draft
    found = read_bytes(tmp_path, "a.gltf", json.dumps(values).encode())
    np.testing.assert_allclose(found.means, before.means)
    np.testing.assert_allclose(found.scales, before.scales)
    np.testing.assert_allclose(found.opacities, before.opacities, atol=0.51 / 255)


def test_buffers_of_gltf_are_in_the_text_or_next_to_it(tmp_path: Path) -> None:
    before = sample_gaussians(9, 2)
    expected = read_bytes(tmp_path, "a.glb", written(before, ".glb"))
    assert_equal(read_bytes(tmp_path, "data.gltf", gltf(before)), expected)
    values = json.loads(gltf(before, "my%20buffer.bin"))
    binary = written(before, ".glb")[-values["buffers"][0]["byteLength"] :]
    (tmp_path / "my buffer.bin").write_bytes(binary)
    assert_equal(read_bytes(tmp_path, "file.gltf", json.dumps(values).encode()), expected)
    half = values["bufferViews"][3]["byteOffset"]
    for view in values["bufferViews"][3:]:
        view["buffer"], view["byteOffset"] = 1, view["byteOffset"] - half
    values["buffers"] = [{"uri": "one.bin", "byteLength": half}, {"uri": "two.bin", "byteLength": len(binary) - half}]
    (tmp_path / "one.bin").write_bytes(binary[:half])
    (tmp_path / "two.bin").write_bytes(binary[half:])
    assert_equal(read_bytes(tmp_path, "files.gltf", json.dumps(values).encode()), expected)
    (tmp_path / "two.bin").write_bytes(binary[half:-1])
    with pytest.raises(SceneFormatError, match=r"files\.gltf: .*buffer 1 has"):
        read_gaussians(tmp_path / "files.gltf")
    (tmp_path / "two.bin").unlink()
    with pytest.raises(SceneFormatError, match=r"files\.gltf: .*'two\.bin'"):
        read_gaussians(tmp_path / "files.gltf")
